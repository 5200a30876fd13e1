"""Sources of motions: the sample set, a file, or a folder searched recursively.

Everything is read in a fixed order, every clip gets a name of its own, and a report says
of every file what became of it and which rule gave its rate. A bad file in a folder is
left out with its reason; a bad file that was asked for by name is an error.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Final

from localreg.errors import LocalregError, MotionError
from localreg.motion.formats import ReadOptions, read_motion, readable_suffixes
from localreg.motion.formats.asf import skeleton_of
from localreg.motion.formats.registry import rate_rule
from localreg.motion.formats.sample import read_sample
from localreg.motion.ids import normal_subject, normal_trial
from localreg.motion.index import activity_of
from localreg.motion.motion import Motion
from localreg.motion.overrides import Overrides, Settings
from localreg.motion.reading_pool import in_order

SAMPLE: Final = "sample"
"""The source that names the sample set; a folder of that name is `./sample`."""

Progress = Callable[[int, int, str], None]
"""Told how many files are done, of how many, and which one comes next (empty at the end)."""


@dataclass(frozen=True, slots=True)
class Entry:
    """What became of one file, of one clip of the sample set, or of files that are no motions.

    Attributes:
        source: the file.
        name: the clip's name, unique within one reading; empty if it was skipped.
        skipped: why it was left out; empty if it was used.
        frames: how many frames were used.
        seconds: how long they last [s].
        rate: frames a second [Hz].
        rate_rule: which rule gave the rate.
        subject: id of the person; empty if unknown.
        trial: id of the recording; empty if unknown.
        activity: what is done; empty if unknown.
        notes: what the reader had to assume or mend.
        skeleton: whose joints the file has, if they are not our bones to the letter.
        joint_error: for such a file, the mean distance between its joints and ours [m].
        joint_errors: the same by the bone of ours that begins at the joint [m].
        is_motion: whether it is a motion file at all, used or not.
    """

    source: str
    name: str = ""
    skipped: str = ""
    frames: int = 0
    seconds: float = 0.0
    rate: float = 0.0
    rate_rule: str = ""
    subject: str = ""
    trial: str = ""
    activity: str = ""
    notes: tuple[str, ...] = ()
    skeleton: str = ""
    joint_error: float | None = None
    joint_errors: tuple[tuple[str, float], ...] = ()
    is_motion: bool = True


@dataclass
class Report:
    """The table of what was read, one entry a clip or a skipped file.

    Attributes:
        entries: of motion files, in the order in which they were read.
        others: of files in the sources' folders that are no motions.
    """

    entries: list[Entry] = field(default_factory=list)
    others: list[Entry] = field(default_factory=list)

    @property
    def used(self) -> list[Entry]:
        """The entries of clips that were used."""
        return [entry for entry in self.entries if not entry.skipped]

    @property
    def skipped(self) -> list[Entry]:
        """The entries of files that were left out."""
        return [entry for entry in self.entries if entry.skipped]

    @property
    def frames(self) -> int:
        """Frames of all clips together."""
        return sum(entry.frames for entry in self.entries)

    @property
    def seconds(self) -> float:
        """Duration of all clips together [s]."""
        return sum(entry.seconds for entry in self.entries)


@dataclass(frozen=True)
class _File:
    """A file to read: under which name, and whether it was asked for by name."""

    path: Path
    root: Path
    name: str
    is_asked_for: bool


def read_sources(
    sources: Sequence[str | Path],
    *,
    source_rate: float | None = None,
    overrides: Overrides | None = None,
    skeleton_map: Path | None = None,
    progress: Progress | None = None,
) -> tuple[list[Motion], Report]:
    """All motions of some sources, and the report on them.

    Args:
        sources: each `"sample"`, a file, or a folder; what occurs twice is read once.
        source_rate: rate of files that carry none [Hz]; 120 by default.
        overrides: what is laid down for some files.
        skeleton_map: says which joints are which bones, where it fits a file.
        progress: is told before every file and at the end.

    Raises:
        MotionError: a source does not exist, a file asked for by name is faulty, or there
            is no usable motion in all of them.
    """
    motions, report = [], Report()
    for motion, entry in iterate_sources(
        sources,
        source_rate=source_rate,
        overrides=overrides,
        skeleton_map=skeleton_map,
        progress=progress,
    ):
        (report.entries if entry.is_motion else report.others).append(entry)
        if motion is not None:
            motions.append(motion)
    if not motions:
        raise no_motion(sources, report)
    return motions, report


def no_motion(sources: Sequence[str | Path], report: Report) -> MotionError:
    """The error that there is no usable motion in all of some sources."""
    reasons = "".join(f"; {e.source}: {e.skipped}" for e in report.skipped[:3])
    return MotionError(
        f"no usable motion in {', '.join(map(str, sources)) or 'no source at all'}; name the "
        f"sample set (sample) or files ending in {', '.join(readable_suffixes())}{reasons}"
    )


def iterate_sources(
    sources: Sequence[str | Path],
    *,
    source_rate: float | None = None,
    overrides: Overrides | None = None,
    skeleton_map: Path | None = None,
    progress: Progress | None = None,
    jobs: int = 1,
    prepare: Callable[[Motion], Motion] | None = None,
) -> Iterator[tuple[Motion | None, Entry]]:
    """One after another the motions of some sources, each with its entry for the report.

    The motion is None where the entry says why it was left out. Arguments and errors are
    those of `read_sources`, except that finding nothing is no error; and:

    Args:
        sources: see there.
        source_rate: see there.
        overrides: see there.
        skeleton_map: see there.
        progress: see there.
        jobs: processes that files are read by.
        prepare: what is made of every motion, where it was read; a function that other
            processes can import.
    """
    sample = read_sample() if any(str(source) == SAMPLE for source in sources) else []
    names = {motion.provenance.name for motion in sample}
    files = _name_files(_find_files(sources), names)
    tell = progress or (lambda done, total, what: None)
    total = len(files) + (1 if sample else 0)
    done = 0
    if sample:
        tell(done, total, SAMPLE)
        for motion in sample:
            yield motion if prepare is None else prepare(motion), _entry(motion, "file")
        done += 1
    read = partial(
        _read_whole,
        source_rate=source_rate,
        overrides=overrides or Overrides(),
        skeleton_map=skeleton_map,
        prepare=prepare,
    )
    for number, found in enumerate(in_order(read, files, min(jobs, len(files)))):
        tell(done + number, total, str(files[number].path))
        yield from found
    done += len(files)
    tell(done, total, "")
    for entry in _others(sources, [file.path for file in files]):
        yield None, entry


def _find_files(sources: Iterable[str | Path]) -> list[_File]:
    """The files of all sources in a fixed order, each once; names are not yet unique."""
    found: dict[Path, _File] = {}
    for source in sources:
        if str(source) == SAMPLE:
            continue
        path = Path(source).expanduser()
        if path.is_dir():
            paths, root = sorted(p for p in path.rglob("*") if _is_motion(p)), path
        elif path.is_file():
            paths, root = [path], path.parent
        else:
            raise MotionError(
                f"there is no file or folder {path}; a source is {SAMPLE!r}, a file or a folder"
            )
        for file in paths:
            entry = _File(file, root, normal_trial(file.stem), path.is_file())
            known = found.setdefault(file.resolve(), entry)
            if entry.is_asked_for and not known.is_asked_for:
                found[file.resolve()] = entry
    return list(found.values())


def _is_motion(path: Path) -> bool:
    return path.suffix.lower() in readable_suffixes() and path.is_file()


def _name_files(files: list[_File], taken: set[str]) -> list[_File]:
    """The files with names of their own: where stems are equal, with folders and ending."""
    taken = set(taken)
    stems = Counter(file.name for file in files)
    named = []
    for file in files:
        name = file.name
        if stems[name] > 1 or name in taken:
            name = file.path.relative_to(file.root).as_posix()
        if name in taken:
            name = file.path.resolve().as_posix()
        taken.add(name)
        named.append(replace(file, name=name))
    return named


def _read_whole(
    file: _File,
    source_rate: float | None,
    overrides: Overrides,
    skeleton_map: Path | None,
    prepare: Callable[[Motion], Motion] | None,
) -> list[tuple[Motion | None, Entry]]:
    """What a file holds, prepared; in whichever process."""
    return [
        (motion if motion is None or prepare is None else prepare(motion), entry)
        for motion, entry in _read_file(file, source_rate, overrides, skeleton_map)
    ]


def _read_file(
    file: _File,
    source_rate: float | None,
    overrides: Overrides,
    skeleton_map: Path | None = None,
) -> Iterator[tuple[Motion | None, Entry]]:
    settings = overrides.settings(file.path)
    source = str(file.path)
    if settings.skip is not None:
        yield None, Entry(source, skipped=f"override: {settings.skip or 'skip'}")
        return
    options = ReadOptions(
        settings.rate,
        source_rate,
        settings.metres_per_unit,
        up=settings.up,
        skeleton_map=settings.skeleton_map or skeleton_map,
    )
    rule = rate_rule(file.path, options)
    try:
        motions = read_motion(file.path, options)
        ready = []
        for number, motion in enumerate(motions, start=1):
            name = file.name if len(motions) == 1 else f"{file.name}#{number}"
            ready.append(_settle(motion, name, file, settings))
    except LocalregError as error:
        if file.is_asked_for:
            raise
        yield None, Entry(source, skipped=str(error))
        return
    for motion in ready:
        yield motion, _entry(motion, rule)


def _settle(motion: Motion, name: str, file: _File, settings: Settings) -> Motion:
    """The motion under its final name, with what the overrides lay down for it."""
    old = motion.provenance
    notes = list(old.notes)
    first, last = settings.drop_first or 0, settings.drop_last or 0
    qpos = motion.qpos[first : len(motion) - last].copy()
    if not len(qpos):
        raise MotionError(f"{file.path}: the overrides drop all of its {len(motion)} frames")
    if first or last:
        notes.append(f"override: dropped {first} frames at the head, {last} at the tail")
    if settings.ignored:
        qpos[:, [7 + index for index in settings.ignored]] = 0.0
        notes.append(f"override: {len(settings.ignored)} joint angles set to zero")
    trial = old.trial if settings.trial is None else normal_trial(settings.trial)
    activity = settings.activity
    if activity is None:
        activity = old.activity or activity_of(file.path, trial, file.root, motion.subject.name)
    provenance = replace(
        old,
        name=name,
        subject=old.subject if settings.subject is None else normal_subject(settings.subject),
        trial=trial,
        activity=activity,
        notes=tuple(notes),
    )
    return replace(motion, qpos=qpos, provenance=provenance)


def _entry(motion: Motion, rule: str) -> Entry:
    made = motion.provenance
    return Entry(
        source=made.source,
        name=made.name,
        frames=len(motion),
        seconds=motion.seconds,
        rate=motion.rate,
        rate_rule=rule,
        subject=made.subject,
        trial=made.trial,
        activity=made.activity,
        notes=made.notes,
        skeleton=made.skeleton,
        joint_error=made.joint_error,
        joint_errors=made.joint_errors,
    )


def _others(sources: Sequence[str | Path], motions: Sequence[Path]) -> Iterator[Entry]:
    """Entries for the files in folders that hold no motion: skeletons, then kinds by ending."""
    folders = [Path(source).expanduser() for source in sources if str(source) != SAMPLE]
    found = {
        path.resolve(): path
        for folder in folders
        if folder.is_dir()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not _is_motion(path)
    }
    used = {asf.resolve() for path in motions if (asf := skeleton_of(path)) is not None}
    kinds: dict[str, list[Path]] = {}
    for resolved, path in found.items():
        if path.suffix.lower() != ".asf":
            kinds.setdefault(path.suffix.lower(), []).append(path)
        elif resolved not in used:
            yield Entry(str(path), skipped="a skeleton that no motion uses", is_motion=False)
    if count := sum(resolved in used for resolved in found):
        yield Entry(
            f"{count} skeletons (.asf)", skipped="read with the motions of theirs", is_motion=False
        )
    for kind, paths in sorted(kinds.items()):
        named = str(paths[0]) if len(paths) == 1 else f"{len(paths)} files, as {paths[0]}"
        yield Entry(named, skipped=f"{kind or 'no ending'}: not a motion file", is_motion=False)
