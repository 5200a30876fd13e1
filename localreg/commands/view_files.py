"""Files as footage: motion files, the sample set, and takes of `localreg run`."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from localreg.commands.reading import read
from localreg.errors import LocalregError, MotionError
from localreg.motion.motion import Motion, Provenance
from localreg.view.footage import Footage
from sensors.pose import TrackerFrame

RECORDING: Final = ".mcap"
"""Ending of recordings."""


def read_footage(source: str, clip: str | None = None, source_rate: float | None = None) -> Footage:
    """What a file shows.

    Args:
        source: a motion file, `sample`, or a take of `localreg run`.
        clip: which clip, where there are several.
        source_rate: frames a second of files that carry none [Hz].

    Raises:
        LocalregError: it cannot be read, or shows no body.
    """
    if Path(source).suffix.lower() == RECORDING:
        return read_take(Path(source))
    motions, report = read([source], source_rate, None)
    if not motions:
        reasons = "; ".join(entry.skipped for entry in report.skipped)
        raise MotionError(f"{source} holds no motion{': ' if reasons else ''}{reasons}")
    return Footage(_chosen(motions, source, clip)).on_floor()


def read_take(path: Path) -> Footage:
    """A take as it was seen live: every pose with what the trackers said, before re-centring.

    Raises:
        LocalregError: it holds no poses.
        SensorError: it is no recording.
    """
    from localreg.live.take import POSES, Take
    from sensors.recording import read_recording
    from sensors.recording.schemas import FRAMES

    take = Take.read(path)
    if not take.indices:
        raise LocalregError(
            f"{path} holds no poses: nobody was found in it; localreg synthesize can make some "
            "of its trackers"
        )
    frames: dict[int, TrackerFrame] = {}
    poses: dict[int, dict[str, Any]] = {}
    for message in read_recording(path, (FRAMES, POSES)):
        if message.topic == FRAMES:
            frames[message.data["index"]] = _tracker_frame(message.data)
        else:
            poses[message.data["index"]] = message.data
    indices = range(take.indices[0], take.indices[-1] + 1)
    rows, newest = [], poses[take.indices[0]]
    for index in indices:
        # Where a frame never came, the last pose stayed.
        rows.append(poses.get(index, {**newest, "held": True, "start": False}))
        newest = rows[-1]
    rate = float(take.database["rate"])
    nobody = _nothing_measured(len(take.subject.trackers))
    motion = Motion(
        np.array([row["qpos"] for row in rows], dtype=float),
        rate,
        take.subject,
        Provenance(path.stem, source=str(path)),
    )
    return Footage(
        motion,
        frames=[frames.get(index, nobody) for index in indices],
        confidence=np.array([_number(row["confidence"]) for row in rows]),
        held=np.array([row["held"] for row in rows], dtype=bool),
        starts=np.array([row["start"] for row in rows], dtype=bool),
    )


def _chosen(motions: list[Motion], source: str, clip: str | None) -> Motion:
    names = [motion.provenance.name for motion in motions]
    if clip is None:
        if len(motions) == 1:
            return motions[0]
        raise MotionError(f"{source} holds {len(motions)} clips; name one by --clip {names[0]}")
    if clip not in names:
        raise MotionError(f"{source} holds no clip {clip}; it has {', '.join(names)}")
    return motions[names.index(clip)]


def _tracker_frame(data: dict[str, Any]) -> TrackerFrame:
    return TrackerFrame(
        data["time"],
        np.array(data["positions"], dtype=float).reshape(-1, 3),
        np.array(data["quaternions"], dtype=float).reshape(-1, 4),
        np.array(data["position_mask"], dtype=bool),
        np.array(data["orientation_mask"], dtype=bool),
    )


def _nothing_measured(trackers: int) -> TrackerFrame:
    nothing = np.zeros(trackers, dtype=bool)
    return TrackerFrame(
        0.0,
        np.zeros((trackers, 3)),
        np.tile([1.0, 0.0, 0.0, 0.0], (trackers, 1)),
        nothing,
        nothing,
    )


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)
