"""C3D files as such: named points over time, in any of the format's three number formats.

Written by hand, because the files come from anywhere: the usual library believes their
heads, and a damaged one makes it ask for all memory. Source: the C3D file format user
guide (Motion Lab Systems, 2021). Everything is checked against the file's length first.

A file is blocks of 512 bytes. The first is the head; then come the parameters, of which
POINT:LABELS, POINT:UNITS, POINT:RATE and POINT:SCALE matter here; then the frames, each
with its points (x, y, z, residual) and, mixed in, analog samples. Numbers are 16-bit
integers to be scaled, or 32-bit floats where POINT:SCALE is negative.
"""

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.errors import MotionError
from localreg.motion.formats.text import read_bytes

_BLOCK: Final = 512
_MARK: Final = 0x50
_PROCESSORS: Final = {84: "intel", 85: "dec", 86: "mips"}
_MOST_FRAMES_IN_HEAD: Final = 65535


@dataclass(frozen=True, eq=False)
class C3dFile:
    """The points of a file.

    Attributes:
        labels: names of the points, as many as are named.
        unit: the word for their unit; empty if the file has none.
        rate: frames a second [Hz].
        places: of the named points; NaN where the file marks a point as not seen.
    """

    labels: tuple[str, ...]
    unit: str
    rate: float
    places: Float[ndarray, "frames points 3"]


@dataclass(frozen=True)
class _Parameter:
    """A parameter's type (-1 characters, 1 bytes, 2 integers, 4 floats), shape and bytes."""

    kind: int
    shape: tuple[int, ...]
    data: bytes


class _Numbers:
    """Reads numbers as one of the three processors wrote them."""

    def __init__(self, processor: str) -> None:
        self.processor = processor
        self.order = ">" if processor == "mips" else "<"

    def words(self, data: bytes) -> ndarray:
        return np.frombuffer(data, self.order + "i2")

    def floats(self, data: bytes) -> ndarray:
        if self.processor != "dec":
            with np.errstate(invalid="ignore"):  # damaged numbers are found where they are used
                return np.frombuffer(data, self.order + "f4").astype(float)
        # A VAX float has its halves exchanged and an exponent greater by two.
        halves = np.frombuffer(data, "<u2").reshape(-1, 2)[:, ::-1]
        with np.errstate(invalid="ignore"):
            plain = np.ascontiguousarray(halves).view("<f4").ravel().astype(float) / 4.0
        return np.where((halves[:, 1] & 0x7F80) == 0, 0.0, plain)


def read_c3d(path: Path) -> C3dFile:
    """Read the points of a C3D file.

    Raises:
        MotionError: the file is no C3D, or is cut short or damaged; says where.
    """
    data = read_bytes(path)
    if len(data) < 2 * _BLOCK or data[1] != _MARK or data[0] == 0:
        raise MotionError(f"{path} is no C3D file: it lacks the mark of one")
    start = _BLOCK * (data[0] - 1)
    if start + 4 > len(data):
        raise MotionError(f"{path} is cut short before its parameters; export it again")
    processor = _PROCESSORS.get(data[start + 3])
    if processor is None:
        raise MotionError(f"{path}: processor {data[start + 3]} is unknown; export it again")
    numbers = _Numbers(processor)
    try:
        point = _parameters(data, start + 4, numbers)
        return _points(path, data, numbers, point)
    except (ValueError, struct.error, IndexError, OverflowError) as error:
        raise MotionError(f"{path} is damaged in its parameters; export it again") from error


def _points(path: Path, data: bytes, numbers: _Numbers, point: dict[str, _Parameter]) -> C3dFile:
    head = np.frombuffer(data[:_BLOCK], numbers.order + "u2")
    count, analog, first, last = (int(head[i]) for i in (1, 2, 3, 4))
    block = int(head[8])
    scale = float(numbers.floats(data[12:16])[0])
    rate = float(numbers.floats(data[20:24])[0])
    if "SCALE" in point:
        scale = _float(point["SCALE"], numbers)
    if "RATE" in point:
        rate = _float(point["RATE"], numbers)
    if "DATA_START" in point:
        block = _word(point["DATA_START"], numbers) or block
    frames = last - first + 1
    claimed = frames
    if "FRAMES" in point and last == _MOST_FRAMES_IN_HEAD:
        claimed = max(frames, _word(point["FRAMES"], numbers) & 0xFFFF)
    if count == 0 or claimed < 1 or block == 0:
        raise MotionError(f"{path} holds no frames of points; export markers or joint centers")
    if not 1e-3 < rate < 1e6:
        raise MotionError(f"{path}: POINT:RATE is no number of frames a second; export it again")
    width = 4 if scale < 0.0 else 2
    size = width * (4 * count + analog)
    body = data[_BLOCK * (block - 1) :]
    there = len(body) // size
    # Long takes have more frames than the head can count: then the file's length tells.
    frames = there if last == _MOST_FRAMES_IN_HEAD and claimed <= there else claimed
    if frames > there:
        raise MotionError(
            f"{path} is cut short: it has {there} of {frames} frames; export it again"
        )
    table = np.frombuffer(body[: frames * size], np.uint8).reshape(frames, size)
    raw = np.ascontiguousarray(table[:, : 4 * count * width]).tobytes()
    values = numbers.floats(raw) if width == 4 else numbers.words(raw).astype(float)
    values = values.reshape(frames, count, 4)
    places = values[:, :, :3] * (1.0 if width == 4 else scale)
    with np.errstate(invalid="ignore"):
        unseen = ~(values[:, :, 3] >= 0.0)
    labels = _labels(point)[:count]
    places = np.where(unseen[:, :, None], np.nan, places)[:, : len(labels)]
    units = _texts(point["UNITS"]) if "UNITS" in point else []
    return C3dFile(tuple(labels), units[0] if units else "", rate, places)


def _parameters(data: bytes, start: int, numbers: _Numbers) -> dict[str, _Parameter]:
    """The parameters of the group POINT by name."""
    groups: dict[int, str] = {}
    found: dict[int, dict[str, _Parameter]] = {}
    place = start
    while place + 2 <= len(data):
        length, group = struct.unpack_from("bb", data, place)
        if length == 0 or group == 0:
            break
        place += 2
        name = data[place : place + abs(length)].decode("latin-1").strip().upper()
        place += abs(length)
        step = int(numbers.words(data[place : place + 2])[0])
        if group < 0:
            groups[-group] = name
        else:
            found.setdefault(group, {})[name] = _parameter(data, place + 2)
        if step < 2:
            break
        place += step
    number = next((number for number, name in groups.items() if name == "POINT"), None)
    return {} if number is None else found.get(number, {})


def _parameter(data: bytes, place: int) -> _Parameter:
    kind, dimensions = struct.unpack_from("bB", data, place)
    shape = struct.unpack_from(f"{dimensions}B", data, place + 2)
    size = abs(kind)
    for length in shape:
        size *= length
        if size > len(data):
            raise ValueError("a parameter is longer than the file")
    begin = place + 2 + dimensions
    content = data[begin : begin + size]
    if len(content) < size:
        raise ValueError("a parameter is longer than the file")
    return _Parameter(kind, shape, content)


def _labels(point: dict[str, _Parameter]) -> list[str]:
    """POINT:LABELS and its continuations LABELS2, LABELS3, ..."""
    labels: list[str] = []
    for number in range(1, 258):
        name = "LABELS" if number == 1 else f"LABELS{number}"
        if name not in point:
            break
        labels += _texts(point[name])
    return labels


def _texts(parameter: _Parameter) -> list[str]:
    if parameter.kind != -1 or not parameter.shape or parameter.shape[0] == 0:
        return []
    width = parameter.shape[0]
    data = parameter.data
    return [data[i : i + width].decode("latin-1").strip() for i in range(0, len(data), width)]


def _float(parameter: _Parameter, numbers: _Numbers) -> float:
    if parameter.kind == 2:
        return float(numbers.words(parameter.data)[0])
    return float(numbers.floats(parameter.data)[0])


def _word(parameter: _Parameter, numbers: _Numbers) -> int:
    if parameter.kind == 4:
        return int(numbers.floats(parameter.data)[0])
    return int(numbers.words(parameter.data)[0])
