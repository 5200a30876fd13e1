"""`localreg convert`: from one kind of motion file to another, cleaned on the way."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from localreg.commands.reading import OverridesFile, SkeletonMapFile, SourceRate

if TYPE_CHECKING:
    from localreg.motion.motion import Motion

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command(
    epilog="""Examples:

localreg convert 02_05.amc punch.bvh --names mixamo

localreg convert take1.bvh take1.glb --from 1.5 --to 8 --lock-feet

localreg convert walk.amc walk.osim        (with walk.mot and walk.trc beside it)

localreg convert motions/ exports/ --as csv --rate 60"""
)
def convert(
    source: Annotated[
        str,
        typer.Argument(
            metavar="IN", help="A motion file, a folder of them, or sample (the sample set)."
        ),
    ],
    out: Annotated[
        Path,
        typer.Argument(
            metavar="OUT", help="The file to write, its ending says the kind; a folder with --as."
        ),
    ],
    kind: Annotated[
        str | None,
        typer.Option(
            "--as",
            metavar="ENDING",
            help="Write every clip of IN to the folder OUT, as files of this ending.",
            show_default=False,
        ),
    ] = None,
    clip: Annotated[
        str | None,
        typer.Option(help="Which clip, where IN holds several.", show_default=False),
    ] = None,
    names: Annotated[
        Literal["cmu", "mixamo", "vrm"] | None,
        typer.Option(
            help="Joint names of BVH and glTF; mixamo and vrm come with a T pose at rest. "
            "Default: cmu.",
            show_default=False,
        ),
    ] = None,
    start: Annotated[
        float | None, typer.Option("--from", help="Keep frames from here [s].", show_default=False)
    ] = None,
    end: Annotated[
        float | None, typer.Option("--to", help="Keep frames to here [s].", show_default=False)
    ] = None,
    fill_gaps: Annotated[
        bool, typer.Option("--fill-gaps", help="Bridge frames in which the body jumps away.")
    ] = False,
    smooth: Annotated[
        float | None,
        typer.Option(
            metavar="HZ",
            help="Smooth without lag; of this frequency half is kept [Hz].",
            show_default=False,
        ),
    ] = None,
    rate: Annotated[
        float | None, typer.Option(help="Frames a second to write [Hz].", show_default=False)
    ] = None,
    lock_feet: Annotated[
        bool, typer.Option("--lock-feet", help="Hold feet still while they stand; legs follow.")
    ] = False,
    source_rate: SourceRate = None,
    overrides: OverridesFile = None,
    skeleton_map: SkeletonMapFile = None,
) -> None:
    """Convert motion files, and clean them on the way.

    Writes BVH, AMC (with its ASF), glTF (.glb: skeleton, body and animation), C3D (joint centres
    and markers), OpenSim's TRC, MOT and model (.osim, with both beside it), and joint angles
    as CSV or Parquet. Cleaning goes in this order: trim, fill gaps, smooth, change the rate,
    lock feet.
    """
    from localreg.commands.console import output, progress_bar
    from localreg.commands.reading import read
    from localreg.errors import MotionError
    from localreg.motion.formats import writable_suffixes, write_motion
    from localreg.motion.formats.registry import DEFAULT_RATE, format_of

    suffix = out.suffix if kind is None else "." + kind.lstrip(".")
    if suffix.lower() not in writable_suffixes():
        raise typer.BadParameter(
            f"{out} cannot be written; endings are {', '.join(writable_suffixes())}, or name a "
            "folder and --as ENDING",
            param_hint="OUT" if kind is None else "--as",
        )
    for option, value in (("--rate", rate), ("--smooth", smooth)):
        if value is not None and not 0.0 < value < float("inf"):
            raise typer.BadParameter(f"{value} Hz is no frequency", param_hint=option)
    motions, report = read([source], source_rate, overrides, skeleton_map)
    if clip is not None:
        known = [motion.provenance.name for motion in motions]
        motions = [motion for motion in motions if motion.provenance.name == clip]
        if not motions:
            raise MotionError(f"{source} holds no clip {clip}; it has {', '.join(known)}")
    if kind is None and len(motions) > 1:
        raise MotionError(
            f"{source} holds {len(motions)} clips; name one by --clip "
            f"{motions[0].provenance.name}, or write all by --as {suffix.lstrip('.')} to a folder"
        )
    if kind is not None:
        _make_folder(out)
    wishes = _Wishes(start, end, fill_gaps, smooth, rate, lock_feet)
    console = output()
    with progress_bar("converting") as bar:
        for index, motion in enumerate(motions):
            bar(index, len(motions), motion.provenance.name)
            cleaned = _clean(motion, wishes)
            path = out if kind is None else out / (_file_name(motion.provenance.name) + suffix)
            write_motion(cleaned.motion, path, names=names)
            form = format_of(path)
            if form is not None and not form.carries_rate and cleaned.motion.rate != DEFAULT_RATE:
                cleaned.done.append(
                    f"the file has no place for its rate: read it with --source-rate "
                    f"{cleaned.motion.rate:g}"
                )
            console.print(
                "; ".join([
                    f"{path}: {len(cleaned.motion)} frames at {cleaned.motion.rate:g} Hz of "
                    f"{motion.provenance.name}", *cleaned.done,
                ]),
                soft_wrap=True,
            )  # fmt: skip
    for entry in report.skipped:
        console.print(f"skipped {entry.source}: {entry.skipped}", soft_wrap=True)


@dataclass(frozen=True, slots=True)
class _Wishes:
    """What cleaning is asked for."""

    start: float | None
    end: float | None
    fill_gaps: bool
    smooth: float | None
    rate: float | None
    lock_feet: bool


@dataclass
class _Cleaned:
    """A motion, and what was done to it in a few words each."""

    motion: "Motion"
    done: list[str] = field(default_factory=list)


def _clean(motion: "Motion", wishes: _Wishes) -> _Cleaned:
    import numpy as np

    from localreg.live.smooth import smooth
    from localreg.motion.foot_lock import lock_feet
    from localreg.motion.gaps import fill_gaps, find_jumps
    from localreg.motion.trimming import trimmed

    cleaned = _Cleaned(trimmed(motion, wishes.start, wishes.end))
    if wishes.fill_gaps:
        jumps = find_jumps(cleaned.motion)
        cleaned.motion = fill_gaps(cleaned.motion, jumps)
        cleaned.done.append(f"{int(jumps.sum())} frames of jumps filled")
    if wishes.smooth is not None:
        before = cleaned.motion
        equal = np.ones((len(before), before.angles.shape[1]))
        qpos = smooth(before.qpos, equal, before.rate, cutoff=wishes.smooth)
        cleaned.motion = replace(before, qpos=qpos)
        cleaned.done.append(f"smoothed at {wishes.smooth:g} Hz")
    if wishes.rate is not None:
        cleaned.motion = cleaned.motion.resampled(wishes.rate)
    if wishes.lock_feet:
        locked = lock_feet(cleaned.motion)
        cleaned.motion = locked.motion
        share, most = 100.0 * locked.contacts.any(axis=1).mean(), 100.0 * locked.shift.max()
        cleaned.done.append(f"feet held in {share:.0f} % of frames, moved by up to {most:.1f} cm")
        if locked.missed.max() > 0.005:
            cleaned.done.append(f"out of reach by up to {100 * locked.missed.max():.1f} cm")
    return cleaned


def _make_folder(folder: Path) -> None:
    from localreg.errors import MotionError

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise MotionError(f"cannot make {folder}: {reason}; choose another place") from error


def _file_name(name: str) -> str:
    """A clip's name as the name of a file in one folder."""
    return "".join(c if c.isalnum() or c in "-_#" else "_" for c in name.replace("/", "-"))
