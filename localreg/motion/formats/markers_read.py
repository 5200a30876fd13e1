"""Motions from files of points, C3D and TRC: joint centres or markers."""

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from localreg.errors import MotionError
from localreg.motion.anatomical import FORWARD_UP_RIGHT
from localreg.motion.formats.c3d_file import read_c3d
from localreg.motion.formats.foreign import settle
from localreg.motion.formats.registry import ReadOptions
from localreg.motion.formats.text import LARGEST, fault, read_bytes, show
from localreg.motion.marker_sets import PointTable, joints_of
from localreg.motion.motion import Motion
from localreg.motion.retarget import guess_up

_UNITS: Final = {"mm": 0.001, "cm": 0.01, "dm": 0.1, "m": 1.0, "in": 0.0254, "inch": 0.0254}
_HEAD_LINES: Final = 5


def read(path: Path, options: ReadOptions) -> list[Motion]:
    """Read a C3D or TRC file with a whole body's joint centres or Plug-in Gait markers.

    Raises:
        MotionError: the file is faulty, or its points are no body's; says which lack.
    """
    table, unit = _read_trc(path) if path.suffix.lower() == ".trc" else _read_c3d(path)
    metres = options.metres_per_unit or unit
    rate = options.rate or table.rate
    try:
        motion, found = joints_of(PointTable(table.names, metres * table.places, rate))
        if path.suffix.lower() == ".trc" and (options.up or guess_up(motion, found)) == "y":
            # OpenSim's ground: x forward, z right, where other y-up files have x left.
            motion = motion.turned(FORWARD_UP_RIGHT.T)
    except MotionError as error:
        raise MotionError(f"{path}: {error}") from error
    return [settle(path, replace(options, metres_per_unit=1.0), motion, found)]


def _read_trc(path: Path) -> tuple[PointTable, float]:
    """The points of a TRC file in its unit, and metres in that."""
    lines = [line.rstrip(b"\r") for line in read_bytes(path).split(b"\n")]
    if len(lines) <= _HEAD_LINES or not lines[0].startswith(b"PathFileType"):
        raise fault(path, 1, "this is no TRC file: it does not begin with PathFileType")
    keys, values = lines[1].split(), lines[2].split()
    fields = dict(zip(keys, values, strict=False))
    unit = _UNITS.get(fields.get(b"Units", b"mm").decode("utf-8", errors="replace").lower())
    if unit is None:
        raise fault(path, 3, f"the unit {show(fields[b'Units'])} is unknown; use mm, cm or m")
    rate = _float(fields.get(b"DataRate", b""))
    if rate is None or not 1e-3 < rate < 1e6:
        raise fault(path, 3, "DataRate is no number of frames a second; correct it")
    names = [name.decode("utf-8", errors="replace") for name in lines[3].split(b"\t")[2:]]
    names = [name.strip() for name in names if name.strip()]
    if not names:
        raise fault(path, 4, "no marker is named; name them after Frame# and Time")
    rows = []
    for number, line in enumerate(lines[_HEAD_LINES:], start=_HEAD_LINES + 1):
        if not line.strip():
            continue
        cells = line.split(b"\t") if b"\t" in line else line.split()
        cells = [cell.strip() for cell in cells[2 : 2 + 3 * len(names)]]
        row = [np.nan if not cell else _float(cell) for cell in cells]
        if None in row:
            bad = cells[row.index(None)]
            raise fault(path, number, f"{show(bad)} is not a number; correct it or cut the frame")
        if len(row) < 3 * len(names):
            row += [np.nan] * (3 * len(names) - len(row))
        rows.append(np.array(row, dtype=float))
    if not rows:
        raise fault(path, len(lines), "the file holds no frame; export it again")
    return PointTable(tuple(names), _seen(np.array(rows).reshape(len(rows), -1, 3)), rate), unit


def _read_c3d(path: Path) -> tuple[PointTable, float]:
    """The points of a C3D file in its unit, and metres in that."""
    file = read_c3d(path)
    unit = _UNITS.get(file.unit.lower(), _UNITS["mm"])
    if not file.labels:
        raise MotionError(f"{path} names none of its points; label them")
    return PointTable(file.labels, _seen(file.places), file.rate), unit


def _seen(places: np.ndarray) -> np.ndarray:
    """Places with NaN where a point was not seen: not finite, absurd, or at the origin."""
    bad = ~(np.abs(places) <= LARGEST).all(axis=2) | (places == 0.0).all(axis=2)
    return np.where(bad[:, :, None], np.nan, places)


def _float(word: bytes) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None
