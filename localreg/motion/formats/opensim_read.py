"""Motions in OpenSim's MOT files: coordinates over time, named as in its full-body models.

A file holds no bone lengths: the body has our usual proportions, unless it is said whose it
is. Coordinates that our skeleton lacks are left out, those that the file lacks are nought.
"""

from pathlib import Path
from typing import Final

import numpy as np

from localreg.body.subject import canonical_subject
from localreg.motion.anatomical import COORDINATES, PELVIS_PLACE, poses
from localreg.motion.formats.registry import ReadOptions
from localreg.motion.formats.text import LARGEST, fault, read_bytes, show, split_lines
from localreg.motion.ids import normal_trial, subject_of_trial
from localreg.motion.motion import Motion, Provenance

_ENOUGH: Final = ("hip_flexion_r", "hip_flexion_l", "knee_angle_r", "knee_angle_l")


def read(path: Path, options: ReadOptions) -> list[Motion]:
    """Read a MOT file of a body's coordinates.

    Raises:
        MotionError: the file is faulty, or its columns are no body's; names the line.
    """
    lines = split_lines(read_bytes(path))
    end = next((i for i, line in enumerate(lines) if line.lower() == b"endheader"), None)
    if end is None:
        raise fault(path, len(lines), "this is no MOT file: its head has no line endheader")
    in_degrees = not any(line.lower().replace(b" ", b"") == b"indegrees=no" for line in lines[:end])
    start = next((i for i in range(end + 1, len(lines)) if lines[i]), len(lines))
    names = [word.decode("utf-8", errors="replace") for word in _at(lines, start).split()]
    if not names or names[0].lower() != "time" or not set(_ENOUGH) <= set(names):
        raise fault(
            path, start + 1, f"the columns must be time and coordinates such as {_ENOUGH[0]}"
        )
    table = _table(path, lines, start + 1, len(names))
    known = [name for name in names if name in COORDINATES]
    values = {}
    for name in known:
        column = table[:, names.index(name)]
        turns = name not in PELVIS_PLACE and in_degrees
        values[name] = np.radians(column) if turns else column
    notes = []
    if strange := [name for name in names[1:] if name not in COORDINATES]:
        shown = ", ".join(strange[:4]) + (", ..." if len(strange) > 4 else "")
        notes.append(f"coordinates that our skeleton lacks are left out: {shown}")
    if options.subject is None:
        notes.append("the file has no bone lengths: usual proportions")
    subject = options.subject or canonical_subject()
    rate = options.rate or _rate(path, start + 2, table[:, 0])
    provenance = Provenance(
        name=normal_trial(path.stem),
        subject=subject_of_trial(path.stem),
        trial=normal_trial(path.stem),
        source=str(path),
        notes=tuple(notes),
    )
    return [Motion(poses(values, subject), rate, subject, provenance)]


def _at(lines: list[bytes], index: int) -> bytes:
    return lines[index] if index < len(lines) else b""


def _table(path: Path, lines: list[bytes], start: int, columns: int) -> np.ndarray:
    rows = []
    for number, line in enumerate(lines[start:], start=start + 1):
        words = line.split()
        if not words:
            continue
        try:
            row = np.array(words, dtype=float)
        except ValueError:
            raise fault(path, number, f"{show(line)} has a word that is no number") from None
        if len(row) != columns or not np.all(np.abs(row) <= LARGEST):
            raise fault(
                path, number, f"expected {columns} finite numbers, found {len(row)}; cut the row"
            )
        rows.append(row)
    if len(rows) < 2:
        raise fault(path, len(lines), "the file holds fewer than two rows; export it again")
    return np.array(rows)


def _rate(path: Path, line: int, times: np.ndarray) -> float:
    """The rate of evenly spaced times [Hz]."""
    steps = np.diff(times)
    step = float(np.median(steps))
    if not step > 1e-6 or np.any(np.abs(steps - step) > 0.25 * step):
        raise fault(path, line, "the times are not evenly spaced; resample the file")
    return round(len(steps) / float(times[-1] - times[0]), 6)
