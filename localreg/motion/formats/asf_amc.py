"""Motions in Acclaim's AMC files, as CMU writes them, on the skeleton of an ASF file.

An AMC file holds frame after frame: its number, then a line for the root and each moving
bone with as many values as the skeleton says. It carries no rate.

Reading is done for all frames at once where every frame looks like the first. Any other
file, and any with a fault, is read again line by line, which is slower but knows lines.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BONES, DOF_COUNT, DOF_NAMES
from localreg.errors import MotionError
from localreg.motion.formats.asf import CMU_DOFS, Skeleton, find_asf, format_asf, read_asf
from localreg.motion.formats.axes import (
    CMU_UNIT,
    positions_from_y_up,
    positions_to_y_up,
    quaternions_from_y_up,
    rotations_to_y_up,
)
from localreg.motion.formats.registry import ReadOptions
from localreg.motion.formats.text import (
    LARGEST,
    fault,
    is_sane,
    read_bytes,
    show,
    split_lines,
    whole_number,
)
from localreg.motion.ids import normal_trial, subject_of_trial
from localreg.motion.joint_angles import continuous_zyx
from localreg.motion.motion import Motion, Provenance

_DOF_INDEX: Final = {name: index for index, name in enumerate(DOF_NAMES)}

# The order of the bones in CMU's own AMC files.
_AMC_BONES: Final = (
    "lowerback", "upperback", "thorax", "lowerneck", "upperneck", "head",
    "rclavicle", "rhumerus", "rradius", "rwrist", "rhand", "rfingers", "rthumb",
    "lclavicle", "lhumerus", "lradius", "lwrist", "lhand", "lfingers", "lthumb",
    "rfemur", "rtibia", "rfoot", "rtoes", "lfemur", "ltibia", "lfoot", "ltoes",
)  # fmt: skip

_AMC_COLUMNS: Final = [_DOF_INDEX[bone + dof] for bone in _AMC_BONES for dof in CMU_DOFS[bone]]

# Nine digits keep a millionth of a degree, of a millimetre too within 50 km.
_FRAME: Final = "".join(
    " ".join([name, *["%.9g"] * count]) + "\n"
    for name, count in [("root", 6), *((bone, len(CMU_DOFS[bone])) for bone in _AMC_BONES)]
)

HEAD: Final = "# written by localreg\n:FULLY-SPECIFIED\n:DEGREES\n"
"""All lines of a file before its first frame."""


@dataclass(frozen=True)
class _Table:
    """The numbers of a file: one row a frame, the columns of the bones side by side."""

    bones: tuple[str, ...]
    values: Float[ndarray, "frames columns"]
    numbers: Sequence[int]
    notes: tuple[str, ...] = ()


def read(path: Path, options: ReadOptions) -> list[Motion]:
    """Read an AMC file on the skeleton beside it, see `find_asf`.

    Joint values that the file leaves out are zero; a last frame that is cut short is
    dropped; both are noted in the motion's provenance.

    Raises:
        MotionError: there is no skeleton for it, or the file is faulty; names the line.
    """
    data = read_bytes(path)
    skeleton, person = _skeleton(path, options)
    lines = split_lines(data)
    start, in_radians = _read_header(path, lines)
    counts = {"root": len(skeleton.root_order)}
    counts |= {name: len(dofs) for name, dofs in skeleton.dofs.items() if dofs}
    table = _read_alike(data, lines, start, counts) or _read_lines(path, lines, start, counts)
    radians = (
        skeleton.radians_per_unit if in_radians is None else (1.0, np.pi / 180)[not in_radians]
    )
    qpos, notes = _poses(table, skeleton, radians)
    trial = normal_trial(path.stem)
    provenance = Provenance(
        name=trial,
        subject=subject_of_trial(path.stem) or person,
        trial=trial,
        source=str(path),
        notes=(*skeleton.notes, *table.notes, *notes),
    )
    return [Motion(qpos, options.rate_without_file(), skeleton.subject, provenance)]


def write(motion: Motion, path: Path) -> None:
    """Write a motion as an AMC file, and its skeleton beside it under the same name.

    The rate is lost, for the format has no place for it.
    """
    euler = continuous_zyx(rotations_to_y_up(motion.qpos[:, 3:7]).as_matrix())
    frames = enumerate(zip(motion.qpos, euler, strict=True), start=1)
    text = "".join(frame_text(number, qpos, turn) for number, (qpos, turn) in frames)
    path.with_suffix(".asf").write_text(format_asf(motion.subject), encoding="utf-8")
    path.write_text(HEAD + text, encoding="utf-8")


def frame_text(number: int, qpos: Float[ndarray, "63"], root: Float[ndarray, "3"]) -> str:
    """The lines of one frame.

    Args:
        number: of the frame, from 1.
        qpos: the pose.
        root: the root's turn in a y-up world about z, y, x [rad].
    """
    position = positions_to_y_up(qpos[None, :3])[0] / CMU_UNIT
    turns = np.degrees([*root[::-1], *qpos[7:][_AMC_COLUMNS]])
    return f"{number}\n" + _FRAME % (*position.tolist(), *turns.tolist())


def _skeleton(path: Path, options: ReadOptions) -> tuple[Skeleton, str]:
    """The skeleton to read a file by, and the person's id if the skeleton tells it."""
    if options.subject is not None:
        unit = options.metres_per_unit or CMU_UNIT
        return Skeleton(options.subject, metres_per_unit=unit), ""
    skeleton = read_asf(find_asf(path), options.metres_per_unit)
    return skeleton, skeleton.subject.name


def _read_header(path: Path, lines: list[bytes]) -> tuple[int, bool | None]:
    """Index of the first frame's first line, and whether angles are said to be radians."""
    in_radians = None
    for index, line in enumerate(lines):
        word = line.split(maxsplit=1)[0].upper() if line else b""
        if word in (b":DEGREES", b":RADIANS"):
            in_radians = word == b":RADIANS"
        elif word and not word.startswith((b":", b"#")):
            if whole_number(word) is None:
                raise fault(path, index + 1, f"expected a frame number, found {show(line)}")
            return index, in_radians
    raise MotionError(f"{path} holds no frames; record or download it again")


def _read_alike(
    data: bytes, lines: list[bytes], start: int, counts: dict[str, int]
) -> _Table | None:
    """The table of a file whose frames all look like the first, else None."""
    bones, places, period = [], [], 1
    for line in lines[start + 1 :]:
        words = line.split()
        if len(words) == 1:
            break
        name = words[0].decode("latin-1") if words else ""
        if counts.get(name) != len(words) - 1 or name in bones:
            return None
        bones.append(name)
        places.append(period)
        period += len(words)
    tokens = data.split()[sum(len(line.split()) for line in lines[:start]) :]
    frames, rest = divmod(len(tokens), period)
    if rest or not bones:
        return None
    columns = []
    numbers = [number for t in tokens[::period] if (number := whole_number(t)) is not None]
    if len(numbers) != frames:
        return None
    try:
        for bone, place in zip(bones, places, strict=True):
            if tokens[place::period].count(bone.encode()) != frames:
                return None
            for column in range(place + 1, place + 1 + counts[bone]):
                columns.append(list(map(float, tokens[column::period])))
    except ValueError:
        return None
    values = np.array(columns, dtype=np.float64).T
    return _Table(tuple(bones), values, numbers) if np.all(np.abs(values) <= LARGEST) else None


def _read_lines(path: Path, lines: list[bytes], start: int, counts: dict[str, int]) -> _Table:
    """The table of any file, line by line; knows where a fault is."""
    reader = _LineReader(path, counts)
    last = max(index for index, line in enumerate(lines) if _words(line))
    for index in range(start, len(lines)):
        words = _words(lines[index])
        if words:
            reader.take(index + 1, words, is_last=index == last)
    return reader.finish(last + 1)


def _words(line: bytes) -> list[bytes]:
    return line.split(b"#")[0].split()


class _LineReader:
    """Puts lines together to frames."""

    def __init__(self, path: Path, counts: dict[str, int]) -> None:
        self.path, self.counts = path, counts
        self.numbers: list[int] = []
        self.frames: list[dict[str, list[float]]] = []
        self.first_lines: list[int] = []
        self.cut_short = False

    def take(self, line: int, words: list[bytes], *, is_last: bool) -> None:
        """Take the next line; the last one of a file may be cut short anywhere."""
        number = whole_number(words[0])
        if len(words) == 1 and number is not None:
            self._check_complete(line)
            self.numbers.append(number)
            self.frames.append({})
            self.first_lines.append(line)
            return
        name = words[0].decode("utf-8", errors="replace")
        if name not in self.counts:
            if is_last and len(words) == 1 and any(n.startswith(name) for n in self.counts):
                self.cut_short = True
                return
            raise fault(
                self.path,
                line,
                f"bone {show(words[0])} does not move in the skeleton; use the ASF that belongs "
                "to this file",
            )
        if name in self.frames[-1]:
            raise fault(self.path, line, f"{name} occurs twice in this frame; remove one")
        values = []
        for word in words[1:]:
            try:
                values.append(float(word))
            except ValueError:
                if is_last and word is words[-1]:
                    break
                raise fault(
                    self.path, line, f"{show(word)} is not a number; correct it or cut the frame"
                ) from None
            if not is_sane(values[-1]):
                raise fault(
                    self.path,
                    line,
                    f"{name} has a value that is not finite or absurd; cut the frame",
                )
        if is_last and len(values) < self.counts[name]:
            self.cut_short = True
        elif len(words) - 1 != self.counts[name]:
            raise fault(
                self.path,
                line,
                f"{name} has {len(words) - 1} values, the skeleton says {self.counts[name]}; use "
                "the ASF that belongs to this file",
            )
        else:
            self.frames[-1][name] = values

    def finish(self, last: int) -> _Table:
        """The table of all that was taken."""
        notes = []
        is_empty = not self.frames[-1]
        if self.cut_short or is_empty or set(self.frames[-1]) < set(self.frames[0]):
            notes.append(f"frame {self.numbers[-1]} is cut short and was dropped")
            del self.frames[-1], self.numbers[-1], self.first_lines[-1]
        else:
            self._check_complete(last)
        if not self.frames or not self.frames[0]:
            raise fault(self.path, last, "the file holds no complete frame; download it again")
        bones = tuple(self.frames[0])
        rows = [[v for bone in bones for v in frame[bone]] for frame in self.frames]
        return _Table(bones, np.array(rows), self.numbers, tuple(notes))

    def _check_complete(self, line: int) -> None:
        """Check that the frame before a line has the bones of the first."""
        if not self.frames:
            return
        different = set(self.frames[0]) ^ set(self.frames[-1])
        if different or not self.frames[-1]:
            names = ", ".join(sorted(different)) or "everything"
            raise fault(
                self.path,
                line,
                f"frame {self.numbers[-1]} and the first one differ in having {names}; "
                "mend or cut the frame",
            )


def _poses(
    table: _Table, skeleton: Skeleton, radians: float
) -> tuple[Float[ndarray, "frames 63"], list[str]]:
    """Poses of the numbers of a file, and notes on what they lack."""
    notes = []
    frames = len(table.values)
    qpos = np.zeros((frames, 7 + DOF_COUNT))
    qpos[:, 3] = 1.0
    column = 0
    for bone in table.bones:
        names = skeleton.root_order if bone == "root" else skeleton.dofs[bone]
        values = table.values[:, column : column + len(names)]
        column += len(names)
        if bone == "root":
            by_name = dict(zip(names, values.T, strict=True))
            position = np.stack([by_name["tx"], by_name["ty"], by_name["tz"]], axis=1)
            turns = np.stack([by_name["r" + axis] for axis in skeleton.root_axis], axis=1)
            rotation = Rotation.from_euler(skeleton.root_axis, turns * radians)
            qpos[:, :3] = positions_from_y_up(position * skeleton.metres_per_unit)
            qpos[:, 3:7] = quaternions_from_y_up(rotation)
            continue
        for dof, value in zip(names, values.T, strict=True):
            qpos[:, 7 + _DOF_INDEX[bone + dof]] = value * radians
    present = {
        (bone + dof) for bone in table.bones if bone != "root" for dof in skeleton.dofs[bone]
    }
    missing = [
        bone.name for bone in BONES if any(bone.name + "r" + d not in present for d in bone.dofs)
    ]
    if "root" not in table.bones:
        notes.append("the file moves no root; it rests at the origin")
        qpos[:, 3:7] = [0.5**0.5, 0.5**0.5, 0.0, 0.0]
    if missing:
        notes.append(f"no values for {', '.join(missing)}; they are zero")
    steps = np.flatnonzero(np.diff(np.asarray(table.numbers)) != 1)
    if len(steps):
        before, after = table.numbers[steps[0]], table.numbers[steps[0] + 1]
        notes.append(f"frame numbers are out of sequence, first {before} to {after}; order kept")
    return qpos, notes
