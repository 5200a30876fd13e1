"""What `localreg calibrate check` and `refine` do."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import typer
from rich.table import Table

from calibration.motion_mounts import MountCheck, apart, check_mounts, refine_mounts
from calibration.setup import configured, recorded
from localreg.body.subject import Subject, read_subject, write_subject
from localreg.commands.console import notes, output, progress_bar
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


def check(file: Path, options: MotionOptions) -> None:
    """Report every mount.

    Raises:
        LocalregError: no motion, or a file that cannot be read.
        typer.Exit: with code 1 if a tracker has slipped.
    """
    subject, build, frames = _prepare(file, options)
    with progress_bar("checking") as bar:
        checks = check_mounts(subject, build, frames, bar)
    shown = output()
    shown.print(_table(checks, f"{file} against {len(frames)} frames of motion"))
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
    """Write a subject with better mounts.

    Raises:
        LocalregError: no motion, or a file that cannot be read or written.
    """
    subject, build, frames = _prepare(file, options)
    with progress_bar("refining") as bar:
        better = refine_mounts(subject, build, frames, progress=bar)
    assert better.calibration is not None  # noqa: S101  (refining always records)
    now = datetime.now(UTC).isoformat(timespec="seconds")
    better = replace(better, calibration=replace(better.calibration, date=now))
    write_subject(better, out)
    table = Table(title="mounts moved", title_justify="left")
    for name in ("", "by [mm]", "by [deg]"):
        table.add_column(name, justify="left" if not name else "right")
    for old, new in zip(subject.mounts, better.mounts, strict=True):
        distance, turn = apart(old, new)
        table.add_row(new.tracker, f"{1e3 * distance:.0f}", f"{np.degrees(turn):.1f}")
    shown = output()
    shown.print(table)
    shown.print(f"subject: {out}", soft_wrap=True)


def _prepare(
    file: Path, options: MotionOptions
) -> tuple[Subject, Callable[[Subject], AnyEstimator], list[TrackerFrame]]:
    given = [options.config, options.recording, options.simulate]
    if sum(choice is not None for choice in given) != 1:
        raise LocalregError("give one of --config NAME|FILE, --recording FILE or --simulate MOTION")
    subject = read_subject(file)
    if len(subject.mounts) < 4:
        raise LocalregError(
            f"{file} wears {len(subject.mounts)} trackers; four at least are needed to judge one "
            "by the others"
        )
    console = notes()
    chosen = choose_database(options.database, console.print)
    allowed = None
    if options.simulate is not None:
        motion = read_sources([options.simulate])[0][0].resampled(chosen.poses.rate)
        # Who performs is the person of the file: simulated trackers sit where it says.
        motion = replace(motion, subject=subject)
        motion = motion.first(round(options.seconds * motion.rate))
        frames = list(simulate_trackers(motion, seed=options.seed))
        allowed = chosen.poses.exclude_motion(motion)
    else:
        with _frames_of(options, subject) as (stream, order):
            frames = _collected(stream, order, options)

    def build(person: Subject) -> AnyEstimator:
        return build_estimator("localreg", person, chosen.poses, allowed)

    return subject, build, frames


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
