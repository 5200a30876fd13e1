"""BVH files as such: a tree of joints with channels, and a table of values over time.

Nothing here knows a particular skeleton. A joint's rotation is the product of the turns
of its rotation channels in their order, for example R = Rz Ry Rx.
"""

import re
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.errors import MotionError
from localreg.motion.formats.text import (
    LARGEST,
    fault,
    is_sane,
    read_bytes,
    show,
    split_lines,
    whole_number,
)
from localreg.motion.joint_angles import axis_rotations

_CHANNELS: Final = {
    f"{axis}{kind}": (kind, axis) for axis in "xyz" for kind in ("position", "rotation")
}
_MOST_CHANNELS: Final = 6
LARGEST_TREE: Final = 2000
"""Joints of the largest skeleton that is read; rigs with faces and clothes have hundreds."""

_FRAMES: Final = re.compile(rb"frames\s*:?\s*(\S+)", re.IGNORECASE)
_FRAME_TIME: Final = re.compile(rb"frame\s*time\s*:?\s*(\S+)", re.IGNORECASE)


@dataclass
class Joint:
    """One joint of the tree.

    Attributes:
        name: as in the file.
        parent: index of its parent; -1 for the root.
        line: where in the file it begins.
        offset: from the parent's origin to its own, in the parent's axes [file units].
        channels: names of its values in lower case, for example `"zrotation"`.
        first: where in a row its values begin.
        end: from its origin to its end site, if it has one [file units].
    """

    name: str
    parent: int
    line: int
    offset: Float[ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    channels: tuple[str, ...] = ()
    first: int = 0
    end: Float[ndarray, "3"] | None = None


@dataclass(frozen=True)
class BvhFile:
    """A BVH file.

    Attributes:
        path: where it was read.
        joints: all joints, parents before children.
        values: one row a frame, positions in file units, angles in degrees.
        rate: frames a second [Hz].
        notes: what had to be assumed or mended.
    """

    path: Path
    joints: tuple[Joint, ...]
    values: Float[ndarray, "frames channels"]
    rate: float
    notes: tuple[str, ...] = ()

    def rotations(self, joint: Joint) -> Float[ndarray, "frames 3 3"]:
        """Turn of a joint against its parent in every frame."""
        turn = np.broadcast_to(np.eye(3), (len(self.values), 3, 3))
        for column, channel in enumerate(joint.channels, start=joint.first):
            kind, axis = _CHANNELS[channel]
            if kind == "rotation":
                turn = turn @ axis_rotations(axis, np.radians(self.values[:, column]))
        return turn

    def positions(self, joint: Joint) -> Float[ndarray, "frames 3"]:
        """Place of a joint in its parent in every frame [file units].

        Position channels take the place of the offset along their axes.
        """
        places = np.tile(joint.offset, (len(self.values), 1))
        for column, channel in enumerate(joint.channels, start=joint.first):
            kind, axis = _CHANNELS[channel]
            if kind == "position":
                places[:, "xyz".index(axis)] = self.values[:, column]
        return places


def read_bvh_file(path: Path, rate: float | None = None) -> BvhFile:
    """Read a BVH file.

    A last frame that is cut short is dropped, and a number of frames other than the file
    claims is accepted; both are noted.

    Args:
        path: the file.
        rate: frames a second, whatever the file says [Hz].

    Raises:
        MotionError: the file cannot be read as BVH, holds no frames or numbers that are
            not finite; names the line.
    """
    lines = split_lines(read_bytes(path))
    reader = _TreeReader(path, lines)
    joints = reader.read()
    notes: list[str] = []
    claimed, start = _header(path, lines, reader.line, _FRAMES, "Frames: (a number)")
    time, start = _header(path, lines, start, _FRAME_TIME, "Frame Time: (seconds)")
    if rate is None:
        rate = _rate(path, start, time)
    values = _table(path, lines, start, sum(len(joint.channels) for joint in joints), notes)
    if whole_number(claimed) != len(values):
        notes.append(f"the file claims {show(claimed)} frames and holds {len(values)}")
    return BvhFile(path, tuple(joints), values, rate, tuple(notes))


class _TreeReader:
    """Reads the hierarchy word by word, and knows the line of each."""

    def __init__(self, path: Path, lines: list[bytes]) -> None:
        self.path, self.lines, self.line = path, lines, 0
        self.words: deque[bytes] = deque()

    def read(self) -> list[Joint]:
        self.expect(b"HIERARCHY")
        joints: list[Joint] = []
        open_joints: list[int] = []
        channels = 0
        while True:
            word = self.next()
            key = word.upper()
            if key == b"MOTION" and not open_joints:
                break
            if key in (b"ROOT", b"JOINT"):
                if (key == b"ROOT") != (not open_joints) or (key == b"ROOT" and joints):
                    raise self.fault(f"{show(word)} is out of place; there is one ROOT, at the top")
                if len(joints) == LARGEST_TREE:
                    raise self.fault(f"more than {LARGEST_TREE} joints; this is no body's file")
                joint = Joint(self.name(), open_joints[-1] if open_joints else -1, self.line)
                self.expect(b"{")
                open_joints.append(len(joints))
                joints.append(joint)
            elif not open_joints:
                raise self.fault(f"expected ROOT or MOTION, found {show(word)}")
            elif key == b"OFFSET":
                joints[open_joints[-1]].offset = self.vector()
            elif key == b"CHANNELS":
                joint = joints[open_joints[-1]]
                joint.channels, joint.first = self.channels(), channels
                channels += len(joint.channels)
            elif key == b"END":
                self.expect(b"SITE")
                self.expect(b"{")
                self.expect(b"OFFSET")
                joints[open_joints[-1]].end = self.vector()
                self.expect(b"}")
            elif key == b"}":
                open_joints.pop()
            elif key == b"MOTION":
                raise self.fault("the hierarchy before MOTION lacks a }; close every joint")
            else:
                raise self.fault(f"{show(word)} is not known in a hierarchy; correct it")
        if not joints:
            raise self.fault("the hierarchy has no ROOT; this is not a usable BVH file")
        return joints

    def fault(self, message: str) -> MotionError:
        return fault(self.path, self.line, message)

    def next(self) -> bytes:
        while not self.words:
            if self.line == len(self.lines):
                raise self.fault("the file ends inside the hierarchy; download it again")
            line = self.lines[self.line].replace(b"{", b" { ").replace(b"}", b" } ")
            self.words = deque(line.split())
            self.line += 1
        return self.words.popleft()

    def expect(self, wanted: bytes) -> None:
        word = self.next()
        if word.upper() != wanted:
            raise self.fault(f"expected {wanted.decode()}, found {show(word)}")

    def name(self) -> str:
        words = []
        while self.words and self.words[0] != b"{":
            words.append(self.words.popleft())
        if not words:
            raise self.fault("a joint without a name; give it one")
        return b" ".join(words).decode("utf-8", errors="replace")

    def vector(self) -> Float[ndarray, "3"]:
        return np.array([self.number() for _ in range(3)])

    def number(self) -> float:
        word = self.next()
        value = _float(word)
        if value is None or not is_sane(value):
            raise self.fault(f"{show(word)} is not a number; correct it")
        return value

    def channels(self) -> tuple[str, ...]:
        word = self.next()
        count = whole_number(word)
        if count is None:
            raise self.fault(f"expected a number of channels, found {show(word)}")
        names = []
        for _ in range(count):
            word = self.next()
            name = word.decode("utf-8", errors="replace").lower()
            # Orders such as z x z name a turn twice, but never twice in a row.
            again = name in names and (name.endswith("position") or name == names[-1])
            if name not in _CHANNELS or again or len(names) == _MOST_CHANNELS:
                raise self.fault(
                    f"channel {show(word)} is unknown or given twice; there are Xposition, "
                    "Yposition, Zposition, Xrotation, Yrotation, Zrotation"
                )
            names.append(name)
        return tuple(names)


def _float(word: bytes) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None


def _header(
    path: Path, lines: list[bytes], start: int, pattern: re.Pattern[bytes], wanted: str
) -> tuple[bytes, int]:
    """The value of a line of the motion's head, and the number of that line."""
    for index in range(start, len(lines)):
        if not lines[index]:
            continue
        match = pattern.fullmatch(lines[index])
        if match is None:
            raise fault(path, index + 1, f"expected {wanted!r}, found {show(lines[index])}")
        return match[1], index + 1
    raise fault(path, len(lines), f"the file ends where {wanted!r} should be; download it again")


def _rate(path: Path, line: int, word: bytes) -> float:
    """The rate that a frame time means [Hz].

    A frame time is often printed with few digits: 0.0083333 means 120 Hz. It is taken for
    a whole number of Hz if just one lies within a unit of its last digit.
    """
    time = _float(word)
    if time is None or not 1e-6 <= time <= 1e6:
        raise fault(path, line, f"a frame time of {show(word)} seconds; state the rate instead")
    digits = len(word.lower().split(b"e")[0].partition(b".")[2])
    unit = 10.0**-digits if b"e" not in word.lower() else 0.0
    if unit < time:
        low, high = 1.0 / (time + unit), 1.0 / (time - unit)
        whole = round(1.0 / time)
        if low <= whole <= high and high - low < 1.0:
            return float(whole)
    return 1.0 / time


def _table(
    path: Path, lines: list[bytes], start: int, columns: int, notes: list[str]
) -> Float[ndarray, "frames channels"]:
    """The values of all frames, one line a frame."""
    rows: list[ndarray] = []
    last = max(index for index, line in enumerate(lines) if line)
    for index in range(start, len(lines)):
        words = lines[index].split()
        if not words:
            continue
        try:
            row = [float(word) for word in words]
        except ValueError:
            row = []
            bad = next(word for word in words if _float(word) is None)
            if index != last or len(words) > columns or bad is not words[-1]:
                raise fault(
                    path, index + 1, f"{show(bad)} is not a number; correct it or cut the frame"
                ) from None
        if len(row) == columns:
            rows.append(np.array(row))
        elif index == last and len(row) < columns:
            notes.append(f"frame {len(rows) + 1} is cut short and was dropped")
        else:
            raise fault(
                path,
                index + 1,
                f"a frame has {columns} values, this one {len(row)}; correct it or cut the frame",
            )
    if not rows:
        raise fault(path, len(lines), "the file holds no complete frame; download it again")
    values = np.array(rows)
    bad_rows = np.flatnonzero(~(np.abs(values) <= LARGEST).all(axis=1))
    if bad_rows.size:
        filled = [index for index in range(start, len(lines)) if lines[index]]
        line = filled[int(bad_rows[0])] + 1
        raise fault(
            path, line, "this frame has a value that is not finite or absurd; cut the frame"
        )
    return values
