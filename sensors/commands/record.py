"""Records devices, and plays recordings back."""

import math
import time
from collections import Counter
from pathlib import Path

import numpy as np
import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from sensors.commands.monitor import start_all
from sensors.config import SensorsConfig
from sensors.devices.registry import open_device
from sensors.errors import ConnectionFailedError, RecordingError
from sensors.recording import schemas
from sensors.recording.reader import read_recording
from sensors.recording.recorder import Recorder
from sensors.recording.replay import read_configuration, replay_frames
from sensors.tracker_input import TrackerInput

_DISCOVERY = 2.0
_POLL = 0.2


def record(config: SensorsConfig, path: Path, seconds: float, wait: bool) -> None:
    """Record until the time is over or Ctrl-C.

    Args:
        config: what to record; devices without stations are asked for theirs first.
        path: file to make.
        seconds: how long [s]; 0 for until interrupted.
        wait: wait for devices that are not there, instead of saying so and ending.

    Raises:
        ConnectionFailedError: if a device cannot be opened, or reports no station.
        RecordingError: if the file cannot be made.
        typer.Exit: with code 1, if it could not be written to the end.
    """
    config = _with_stations(config, wait)
    console = Console(stderr=True)
    with Recorder(path) as recorder:
        trackers = TrackerInput(config, recorder=recorder)
        try:
            start_all(trackers.devices, wait)
            _run(trackers, recorder, seconds, console)
        except KeyboardInterrupt:
            pass
        finally:
            trackers.stop()
    c, frames = recorder.counters, trackers.assembler.counters.frames
    if recorder.error:
        # The recorder has said why.
        raise typer.Exit(1)
    lost = f", {c.lost} messages lost" if c.lost else ""
    Console().print(f"{path}: {frames} frames, {c.bytes / 1e6:.1f} MB{lost}", soft_wrap=True)


def _run(trackers: TrackerInput, recorder: Recorder, seconds: float, console: Console) -> None:
    begun = time.monotonic()
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("recording", total=seconds or None)
        while (elapsed := time.monotonic() - begun) < (seconds or math.inf):
            assembled = trackers.stream.next(_POLL)
            if assembled is not None and assembled.index % 20 == 0:
                size = recorder.counters.bytes / 1e6
                words = f"recording frame {assembled.index}, {size:.1f} MB"
                progress.update(task, completed=elapsed, description=words)
            if recorder.error:
                return


def _with_stations(config: SensorsConfig, wait: bool) -> SensorsConfig:
    """Devices without stations get all that report within two seconds."""
    devices = []
    for c in config.devices:
        if not c.stations and c.kind != "replay":
            device = open_device(c)
            try:
                start_all([device], wait)
                time.sleep(_DISCOVERY)
            finally:
                device.stop()
            names = sorted(device.counters.seen)
            if not names:
                raise ConnectionFailedError(
                    f"{c.address} reports no station; {device.last_error or 'is it tracking?'}"
                )
            stations = {_tracker_name(n): int(n) if n.isdecimal() else n for n in names}
            c = c.model_copy(update={"stations": stations})
        devices.append(c)
    return config.model_copy(update={"devices": tuple(devices)})


def _tracker_name(station: str) -> str:
    return f"station{station}" if station.isdecimal() else station


def check(path: Path) -> None:
    """Make the frames of a recording again from its raw bytes and compare them.

    Raises:
        RecordingError: if one bit differs.
    """
    configuration = read_configuration(path)
    console = Console()
    with Console(stderr=True).status("making the frames again"):
        topics: Counter[str] = Counter(m.topic for m in read_recording(path))
        count, seconds = _compare(path)
    console.print(f"{path}: trackers {', '.join(configuration.trackers)}", soft_wrap=True)
    for topic, n in sorted(topics.items()):
        console.print(f"  {topic}: {n} messages")
    if count:
        console.print(f"{count} frames over {seconds:.1f} s, made again bit for bit")
    else:
        console.print("no frames were recorded")


def _compare(path: Path) -> tuple[int, float]:
    """How many frames are the same, and the time they span [s]."""
    made = replay_frames(path)
    count, first, last = 0, 0.0, 0.0
    for message in read_recording(path, (schemas.FRAMES,)):
        recorded, assembled = message.data, next(made, None)
        if assembled is None:
            raise RecordingError(f"{path}: frame {recorded['index']} could not be made again")
        frame = assembled.frame
        same = (
            recorded["time"] == frame.time
            and recorded["index"] == assembled.index
            and np.array_equal(recorded["positions"], frame.positions)
            and np.array_equal(recorded["quaternions"], frame.quaternions)
            and np.array_equal(recorded["position_mask"], frame.position_mask)
        )
        if not same:
            raise RecordingError(
                f"{path}: frame {recorded['index']} came out differently; was it recorded by "
                "another version?"
            )
        first, last, count = (frame.time if count == 0 else first), frame.time, count + 1
    return count, last - first
