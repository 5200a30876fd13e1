"""Finds floor, origin and forward direction, and writes them into the configuration."""

import sys
import time
from pathlib import Path

from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from sensors.alignment import Alignment, AlignmentConfig, AlignmentError, align
from sensors.commands.monitor import start_all
from sensors.config import read_config
from sensors.placement import Placement
from sensors.pose import TrackerFrame
from sensors.toml_table import replace_table
from sensors.tracker_input import TrackerInput

_POLL = 0.2
_FIRST_FRAME = 15.0


def align_room(
    path: Path,
    settings: AlignmentConfig,
    *,
    seconds: float,
    countdown: float,
    write: bool,
) -> Alignment:
    """Measure a standing person and keep the placement in the file's `[room]`.

    Args:
        path: configuration file.
        settings: how to align.
        seconds: how long to measure [s].
        countdown: time to take position before [s].
        write: change the file; else only show.

    Raises:
        SensorError: if devices do not open, somebody moved, or the file cannot be changed.
    """
    config = read_config(path)
    console = Console(stderr=True)
    trackers = TrackerInput(config.model_copy(update={"room": Placement()}))
    try:
        start_all(trackers.devices, wait=False)
        _count_down(countdown, console)
        frames = _collect(trackers, seconds, console)
    finally:
        trackers.stop()
    alignment = align(frames, trackers.trackers, settings, config.room)
    placement = alignment.placement
    if write:
        rounded = {
            "yaw": round(placement.yaw, 3),
            "translation": [round(v, 4) for v in placement.translation],
        }
        replace_table(path, "room", rounded)
    _show(alignment, path if write else None)
    return alignment


def _count_down(countdown: float, console: Console) -> None:
    if countdown > 0.0:
        console.print("Stand upright and still at the origin, facing forward, arms hanging.")
        with Progress(console=console, transient=True) as progress:
            task = progress.add_task("take position", total=countdown)
            end = time.monotonic() + countdown
            while (left := end - time.monotonic()) > 0.0:
                progress.update(task, completed=countdown - left)
                time.sleep(min(left, 0.1))
        sys.stderr.write("\a")


def _collect(trackers: TrackerInput, seconds: float, console: Console) -> list[TrackerFrame]:
    frames: list[TrackerFrame] = []
    give_up = time.monotonic() + _FIRST_FRAME + seconds
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("stand still", total=seconds)
        while not frames or frames[-1].time - frames[0].time < seconds:
            if time.monotonic() > give_up:
                raise AlignmentError("the trackers are silent; look at localreg sensors monitor")
            assembled = trackers.stream.next(_POLL)
            # What was under way before the countdown ended was not standing yet.
            if assembled is not None and assembled.frame.position_mask.any():
                frames.append(assembled.frame)
                progress.update(task, completed=frames[-1].time - frames[0].time)
    return frames


def _show(alignment: Alignment, written: Path | None) -> None:
    console = Console()
    table = Table("tracker", "height [m]")
    for name, height in alignment.heights.items():
        table.add_row(name, f"{height:.3f}")
    console.print(table)
    x, y, z = alignment.placement.translation
    console.print(
        f"yaw {alignment.placement.yaw:.2f} deg, translation {x:.3f} {y:.3f} {z:.3f} m; nobody "
        f"moved more than {1e3 * alignment.motion:.0f} mm"
    )
    for warning in alignment.warnings:
        console.print(f"note: {warning}")
    if written is not None:
        console.print(f"written to [room] of {written}", soft_wrap=True, markup=False)
