"""Poses of our own recordings (.mcap): what `localreg run` made of the trackers."""

import tempfile
from pathlib import Path
from typing import Any, Final

import numpy as np

from localreg.body.skeleton import QPOS_SIZE
from localreg.body.subject import Subject, read_subject
from localreg.errors import MotionError, SubjectError
from localreg.motion.formats.registry import ReadOptions
from localreg.motion.motion import Motion, Provenance
from sensors.errors import SensorError
from sensors.recording import read_recording

_TAKE: Final = "/take"
_POSES: Final = "/poses"


def read(path: Path, options: ReadOptions) -> list[Motion]:
    """Read the poses that a recording holds.

    Frames without a pose (passed over, or before a body was found) hold the pose before
    them, and are noted. Poses are where the room has them, not where they were published.

    Raises:
        MotionError: it is no recording, or holds no poses.
    """
    subject = options.subject
    rows: dict[int, list[float]] = {}
    times: dict[int, float] = {}
    try:
        for message in read_recording(path, (_TAKE, _POSES)):
            data = message.data
            if message.topic == _TAKE and subject is None:
                subject = _subject(path, data)
            elif message.topic == _POSES:
                index, qpos = int(data["index"]), data["qpos"]
                if len(qpos) == QPOS_SIZE:
                    rows[index], times[index] = qpos, float(data["time"])
    except SensorError as error:
        raise MotionError(str(error)) from error
    except (KeyError, TypeError, ValueError) as error:
        raise MotionError(f"{path} has poses of another layout; record it anew") from error
    if subject is None or len(rows) < 2:
        raise MotionError(
            f"{path} holds trackers and no poses; make some: localreg synthesize {path} --out x.bvh"
        )
    indices = sorted(rows)
    count = indices[-1] - indices[0] + 1
    span = times[indices[-1]] - times[indices[0]]
    rate = options.rate or (round((count - 1) / span, 3) if span > 0.0 else None)
    if rate is None or count > 100 * len(rows):
        raise MotionError(f"{path} has poses whose times make no sense; record it anew")
    table = np.empty((count, QPOS_SIZE))
    places = np.array(indices) - indices[0]
    known = np.array([rows[index] for index in indices], dtype=float)
    table[:] = known[np.searchsorted(places, np.arange(count), side="right") - 1]
    table[:, 3:7] /= np.maximum(np.linalg.norm(table[:, 3:7], axis=1, keepdims=True), 1e-9)
    notes = ()
    if count > len(rows):
        notes = (f"{count - len(rows)} frames without a pose hold the one before",)
    made = Provenance(
        name=path.stem, subject=subject.name, trial=path.stem, source=str(path), notes=notes
    )
    return [Motion(table, rate, subject, made)]


def _subject(path: Path, take: dict[str, Any]) -> Subject:
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "subject.toml"
        file.write_text(str(take["subject"]), encoding="utf-8")
        try:
            return read_subject(file)
        except SubjectError as error:
            raise MotionError(f"{path} has a subject that cannot be read: {error}") from error
