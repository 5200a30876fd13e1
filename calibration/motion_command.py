"""What `localreg calibrate check` and `refine` do."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import typer
from rich.table import Table

from calibration.anthropometry import length_of
from calibration.eigen_skeleton import lengths_of, published_prior
from calibration.knowledge import Knowledge, known_file, read_knowledge, write_knowledge
from calibration.motion_mounts import MountCheck, apart, check_mounts, with_readings
from calibration.refinement import BuildEstimator, Stretch
from calibration.refinement import refine as refine_subject
from calibration.result import QUANTILE_90, REPORTED, relative_deviation
from calibration.setup import configured, recorded
from localreg.body.subject import Subject, read_subject, write_subject
from localreg.commands.console import notes, output, progress_bar
from localreg.database.store import PoseDatabase
from localreg.errors import LocalregError
from localreg.evaluation.trackers import simulate_trackers
from localreg.live.database_choice import choose_database
from localreg.motion.sources import read_sources
from localreg.synthesis.estimator import AnyEstimator
from localreg.synthesis.methods import build_estimator
from sensors.pose import TrackerFrame
from sensors.stream import FrameStream

_NO_DATA = 20.0
_END_OF_RECORDING = 3.0


@dataclass(frozen=True, slots=True)
class MotionOptions:
    """Where motion comes from; see the commands' help."""

    config: str | None
    recording: Path | None
    simulate: str | None
    seconds: float
    database: Path | None
    seed: int
    truth: Path | None = None


def check(file: Path, options: MotionOptions) -> None:
    """Report every mount.

    Raises:
        LocalregError: no motion, or a file that cannot be read.
        typer.Exit: with code 1 if a tracker has slipped.
    """
    watched = _watch(file, options)
    longest = watched.longest
    with progress_bar("checking") as bar:
        checks = check_mounts(watched.subject, watched.builder(longest), longest.frames, bar)
    shown = output()
    shown.print(_table(checks, f"{file} against {len(longest.frames)} frames of motion"))
    slipped = [check for check in checks if check.has_slipped]
    for check in slipped:
        shown.print(
            f"tracker {check.tracker} has slipped by about {1e3 * check.distance:.0f} mm and "
            f"{np.degrees(check.turn):.0f} deg: fasten it and calibrate again, or run "
            f"localreg calibrate refine {file}",
            soft_wrap=True,
        )
    if slipped:
        raise typer.Exit(1)
    shown.print("no tracker has slipped as far as motion can tell")


def refine(file: Path, out: Path, options: MotionOptions) -> None:
    """Write a subject with better lengths and mounts.

    Raises:
        LocalregError: no motion, or a file that cannot be read or written.
    """
    watched = _watch(file, options)
    subject, longest = watched.subject, watched.longest
    known = read_knowledge(subject, known_file(file))
    if known is None:
        known = Knowledge.of_record(subject, published_prior())
        notes().print(
            f"no {known_file(file).name} beside it says how lengths and mounts are known together; "
            "going by the deviations on record"
        )
    with progress_bar("checking") as bar:
        checks = check_mounts(subject, watched.builder(longest), longest.frames, bar)
    slipped = [check.tracker for check in checks if check.has_slipped]
    begun = with_readings(subject, watched.builder(longest), longest.frames, slipped)
    with progress_bar("refining") as bar:
        found = refine_subject(
            begun,
            known.without_mounts(set(slipped)),
            watched.stretches,
            watched.build,
            watched.database,
            ignored=slipped,
            progress=bar,
        )
    better = found.subject
    assert better.calibration is not None  # noqa: S101  (refining always records)
    now = datetime.now(UTC).isoformat(timespec="seconds")
    notes_kept = better.calibration.notes + tuple(f"tracker {n} had slipped" for n in slipped)
    better = replace(better, calibration=replace(better.calibration, date=now, notes=notes_kept))
    write_subject(better, out)
    write_knowledge(found.knowledge, better, known_file(out))
    shown = output()
    shown.print(_lengths_table(subject, known, better, found.knowledge))
    shown.print(_mounts_table(subject, known, better, found.knowledge))
    shown.print(f"subject: {out}", soft_wrap=True)


def _lengths_table(old: Subject, known: Knowledge, new: Subject, better: Knowledge) -> Table:
    table = Table(title="lengths [cm], 90 % within", title_justify="left")
    for name in ("", "before", "", "now", ""):
        table.add_column(name, justify="right" if name else "left")
    for name, parts in REPORTED.items():
        row = [name]
        for subject, knowledge in ((old, known), (new, better)):
            groups = lengths_of(subject)
            value = 100.0 * length_of(parts, groups)
            half = QUANTILE_90 * relative_deviation(parts, groups, knowledge.log_lengths)
            row += [f"{value:.1f}", f"{value * half:.1f}"]
        table.add_row(*row)
    return table


def _mounts_table(old: Subject, known: Knowledge, new: Subject, better: Knowledge) -> Table:
    table = Table(title="mounts", title_justify="left")
    for name in ("", "moved by [mm]", "[deg]", "90 % within [mm]", "before", "[deg]", "before"):
        table.add_column(name, justify="right" if name else "left")
    for j, (mount, moved) in enumerate(zip(old.mounts, new.mounts, strict=True)):
        distance, turn = apart(mount, moved)
        places = (better.position_sd[j], known.position_sd[j])
        turns = (better.turn_sd[j], known.turn_sd[j])
        table.add_row(
            mount.tracker,
            f"{1e3 * distance:.0f}",
            f"{np.degrees(turn):.1f}",
            *(f"{1e3 * QUANTILE_90 * sd.max():.0f}" for sd in places),
            *(f"{np.degrees(QUANTILE_90 * sd.max()):.1f}" for sd in turns),
        )
    return table


@dataclass(frozen=True, eq=False)
class _Watched:
    """A subject and what was seen of it."""

    subject: Subject
    database: PoseDatabase
    stretches: list[Stretch]

    @property
    def longest(self) -> Stretch:
        return max(self.stretches, key=lambda stretch: len(stretch.frames))

    def build(self, person: Subject) -> AnyEstimator:
        return build_estimator("localreg", person, self.database)

    def builder(self, stretch: Stretch) -> BuildEstimator:
        """Makes estimators that see the poses allowed for a stretch."""
        return lambda person: build_estimator("localreg", person, self.database, stretch.allowed)


def _watch(file: Path, options: MotionOptions) -> _Watched:
    given = [options.config, options.recording, options.simulate]
    if sum(choice is not None for choice in given) != 1:
        raise LocalregError("give one of --config NAME|FILE, --recording FILE or --simulate MOTION")
    subject = read_subject(file)
    if len(subject.mounts) < 4:
        raise LocalregError(
            f"{file} wears {len(subject.mounts)} trackers; four at least are needed to judge one "
            "by the others"
        )
    if options.truth is not None and options.simulate is None:
        raise LocalregError("--truth says who is simulated; give it together with --simulate")
    database = choose_database(options.database, notes().print).poses
    if options.simulate is not None:
        person = subject if options.truth is None else read_subject(options.truth)
        return _Watched(subject, database, _simulated(options, person, database))
    with _frames_of(options, subject) as (stream, order):
        return _Watched(subject, database, [Stretch(_collected(stream, order, options))])


def _simulated(options: MotionOptions, person: Subject, database: PoseDatabase) -> list[Stretch]:
    """Motions one after another, as a person would perform them, until it is enough."""
    stretches, left = [], options.seconds
    for number, source in enumerate(read_sources([str(options.simulate)])[0]):
        motion = replace(source.resampled(database.rate), subject=person)
        motion = motion.first(max(round(left * motion.rate), 1))
        frames = list(simulate_trackers(motion, seed=options.seed + number))
        stretches.append(Stretch(frames, database.exclude_motion(source)))
        left -= len(motion) / motion.rate
        if left <= 0.0:
            break
    return stretches


@contextmanager
def _frames_of(options: MotionOptions, subject: Subject) -> Iterator[tuple[FrameStream, list[int]]]:
    """Running devices, and where the subject's trackers are in their frames."""
    source = (
        configured(str(options.config), subject)
        if options.recording is None
        else recorded(options.recording, subject)
    )
    with source as running:
        names = [mount.tracker for mount in running.mounts]
        if missing := [name for name in subject.trackers if name not in names]:
            raise LocalregError(
                f"nobody reports tracker {', '.join(missing)} of the subject; there are "
                f"{', '.join(names)}"
            )
        yield running.trackers.stream, [names.index(name) for name in subject.trackers]


def _collected(stream: FrameStream, order: list[int], options: MotionOptions) -> list[TrackerFrame]:
    """Frames for so many seconds of their own time, or until a recording ends."""
    frames: list[TrackerFrame] = []
    heard = time.monotonic()
    with progress_bar("watching") as bar:
        while not frames or frames[-1].time - frames[0].time < options.seconds:
            assembled = stream.next(0.1)
            silent = time.monotonic() - heard
            if assembled is None:
                if options.recording is not None and frames and silent > _END_OF_RECORDING:
                    break
                if silent > _NO_DATA:
                    raise LocalregError(
                        f"no tracker data for {_NO_DATA:g} s; see that the device is on"
                    )
                continue
            heard = time.monotonic()
            f = assembled.frame
            frames.append(
                TrackerFrame(
                    f.time, f.positions[order], f.quaternions[order], f.position_mask[order],
                    f.orientation_mask[order],
                )
            )  # fmt: skip
            share = round(100 * (frames[-1].time - frames[0].time) / options.seconds)
            bar(min(share, 100), 100, "")
    return frames


def _table(checks: list[MountCheck], title: str) -> Table:
    table = Table(title=title, title_justify="left")
    for name in ("", "off by [mm]", "off by [deg]", "deviations", ""):
        table.add_column(name, justify="left" if not name else "right")
    for check in checks:
        table.add_row(
            check.tracker,
            f"{1e3 * check.distance:.0f}",
            f"{np.degrees(check.turn):.0f}",
            f"{check.score:.1f}",
            "slipped" if check.has_slipped else "",
        )
    return table
