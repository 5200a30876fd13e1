"""Skeletons in Acclaim's ASF files, as CMU writes them.

A length in metres is value * 0.0254 / `length` of the section `:units`. A bone's `axis`
triple turns about x, then y, then z (in the order its letters say) into its axis frame C;
its `dof` list says which angles a motion holds and in what order, R = C Rz Ry Rx C^T.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BONES
from localreg.body.subject import Subject
from localreg.errors import MotionError
from localreg.motion.formats.axes import CMU_UNIT, INCH
from localreg.motion.formats.text import fault, is_sane, read_bytes, show, split_lines
from localreg.motion.ids import normal_subject
from localreg.motion.joint_angles import euler_zyx

ROOT_ORDER: Final = ("tx", "ty", "tz", "rx", "ry", "rz")
"""The root's values in CMU's files."""

CMU_DOFS: Final = {bone.name: tuple("r" + dof for dof in reversed(bone.dofs)) for bone in BONES}
"""The values of every bone in CMU's files: x, y, z where we say z, y, x."""

_TURNS: Final = ("rx", "ry", "rz")


@dataclass(frozen=True)
class Skeleton:
    """What an ASF file says, and what it takes to read motions of it.

    Attributes:
        subject: the person's bones.
        metres_per_unit: length of a unit of the root's position [m].
        radians_per_unit: size of a unit of the angles of motions that do not say it [rad].
        root_order: the root's six values in their order, of `ROOT_ORDER`.
        root_axis: the axes that the root turns about, first to last, for example `"xyz"`.
        dofs: for every bone its values in their order, for example `("rx", "rz")`.
        notes: what had to be assumed.
    """

    subject: Subject
    metres_per_unit: float = CMU_UNIT
    radians_per_unit: float = np.pi / 180.0
    root_order: tuple[str, ...] = ROOT_ORDER
    root_axis: str = "xyz"
    dofs: dict[str, tuple[str, ...]] = field(default_factory=lambda: dict(CMU_DOFS))
    notes: tuple[str, ...] = ()


@dataclass
class _Bone:
    """A bone as its section says; lines tell where, for errors."""

    line: int
    name: str = ""
    direction: Float[ndarray, "3"] | None = None
    length: float | None = None
    axis: Float[ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    axis_order: str = "xyz"
    dofs: tuple[str, ...] = ()


@dataclass
class _Sections:
    """All that is read before it is put together."""

    length: float = 1.0
    angle: float = np.pi / 180.0
    root_order: tuple[str, ...] = ROOT_ORDER
    root_axis: str = "xyz"
    bones: dict[str, _Bone] = field(default_factory=dict)
    parents: dict[str, tuple[str, int]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def read_asf(path: Path, metres_per_unit: float | None = None) -> Skeleton:
    """Read a skeleton of CMU's topology.

    Args:
        path: the ASF file.
        metres_per_unit: length of its unit [m], instead of what the file says.

    Raises:
        MotionError: the file cannot be read, or its bones are not the canonical ones;
            names the file, the line and the bone.
    """
    sections = _Sections()
    lines = _Lines(path, split_lines(read_bytes(path)))
    section = ""
    for number, words in lines:
        if words[0].startswith(":"):
            section = words[0].lower()
        elif section == ":units":
            _read_unit(lines, number, words, sections)
        elif section == ":root":
            _read_root(lines, number, words, sections)
        elif section == ":bonedata" and words[0].lower() == "begin":
            _read_bone(lines, number, sections)
        elif section == ":hierarchy" and words[0].lower() not in ("begin", "end"):
            for child in words[1:]:
                sections.parents[child] = (words[0], number)
    return _assemble(path, len(lines.lines), sections, metres_per_unit)


class _Lines:
    """Numbered lines in words, without comments and blank lines."""

    def __init__(self, path: Path, lines: list[bytes]) -> None:
        self.path, self.lines, self.position = path, lines, 0

    def __iter__(self) -> Iterator[tuple[int, list[str]]]:
        while self.position < len(self.lines):
            line = self.lines[self.position].split(b"#")[0].decode("utf-8", errors="replace")
            self.position += 1
            if words := line.split():
                yield self.position, words

    def number(self, line: int, word: str) -> float:
        try:
            value = float(word)
        except ValueError:
            value = float("nan")
        if not is_sane(value):
            raise fault(self.path, line, f"{show(word.encode())} is not a number; correct it")
        return value

    def numbers(self, line: int, words: list[str], count: int) -> Float[ndarray, " n"]:
        if len(words) < count:
            raise fault(self.path, line, f"expected {count} numbers, found {len(words)}; add them")
        return np.array([self.number(line, word) for word in words[:count]])


def _read_unit(lines: _Lines, number: int, words: list[str], sections: _Sections) -> None:
    key, value = words[0].lower(), words[1] if len(words) > 1 else ""
    if key == "length":
        sections.length = lines.number(number, value)
        if sections.length < 1e-6:
            raise fault(lines.path, number, "a length unit must be positive; CMU's is 0.45")
    elif key == "angle":
        if value.lower() not in ("deg", "rad"):
            raise fault(lines.path, number, f"angles are deg or rad, not {show(value.encode())}")
        sections.angle = np.pi / 180.0 if value.lower() == "deg" else 1.0


def _read_root(lines: _Lines, number: int, words: list[str], sections: _Sections) -> None:
    key = words[0].lower()
    if key == "order":
        order = tuple(word.lower() for word in words[1:])
        if sorted(order) != sorted(ROOT_ORDER):
            raise fault(
                lines.path, number, "the root's order must name TX TY TZ RX RY RZ once each"
            )
        sections.root_order = order
    elif key == "axis":
        sections.root_axis = _axis_order(lines, number, words[1] if len(words) > 1 else "")
    elif key in ("position", "orientation") and np.any(lines.numbers(number, words[1:], 3)):
        sections.notes.append(f"the skeleton's rest {key} of the root is left out")


def _read_bone(lines: _Lines, begin: int, sections: _Sections) -> None:
    bone = _Bone(begin)
    for number, words in lines:
        key, values = words[0].lower(), words[1:]
        if key == "end":
            break
        if key.startswith(":") or key == "begin":
            raise fault(lines.path, number, "the bone before is not closed; add a line `end`")
        if key == "name" and values:
            bone.name, bone.line = values[0], number
        elif key == "direction":
            bone.direction = lines.numbers(number, values, 3)
        elif key == "length":
            bone.length = float(lines.numbers(number, values, 1)[0])
            if bone.length < 0.0:
                raise fault(lines.path, number, "a bone cannot be shorter than nothing")
        elif key == "axis":
            bone.axis = lines.numbers(number, values, 3)
            bone.axis_order = _axis_order(lines, number, values[3] if len(values) > 3 else "XYZ")
        elif key == "dof":
            bone.dofs = tuple(value.lower() for value in values)
            _check_dofs(lines, number, bone)
    else:
        raise fault(lines.path, begin, "this bone is not closed; the file seems cut short")
    if bone.name in sections.bones:
        raise fault(lines.path, bone.line, f"bone {bone.name} occurs twice; remove one")
    sections.bones[bone.name] = bone


def _axis_order(lines: _Lines, number: int, word: str) -> str:
    if sorted(word.lower()) != ["x", "y", "z"]:
        raise fault(lines.path, number, f"an axis order is XYZ or alike, not {show(word.encode())}")
    return word.lower()


def _check_dofs(lines: _Lines, number: int, bone: _Bone) -> None:
    allowed = CMU_DOFS.get(bone.name)
    strange = [dof for dof in bone.dofs if dof not in (allowed or _TURNS)]
    if strange or len(set(bone.dofs)) != len(bone.dofs):
        raise fault(
            lines.path,
            number,
            f"bone {bone.name} moves by {' '.join(bone.dofs)}, but the canonical skeleton's by "
            f"{' '.join(allowed or ()) or 'nothing'}; other skeletons must be retargeted",
        )


def _assemble(
    path: Path, last: int, sections: _Sections, metres_per_unit: float | None
) -> Skeleton:
    known = {bone.name for bone in BONES}
    for name, bone in sections.bones.items():
        if name not in known:
            raise fault(path, bone.line, f"bone {show(name.encode())} is not one of CMU's skeleton")
    metres = INCH / sections.length if metres_per_unit is None else metres_per_unit
    offsets, frames = np.zeros((len(BONES), 3)), np.zeros((len(BONES), 3, 3))
    for index, canonical in enumerate(BONES):
        bone = sections.bones.get(canonical.name)
        if bone is None:
            raise fault(path, last, f"bone {canonical.name} is missing from :bonedata; add it")
        if bone.direction is None or bone.length is None:
            raise fault(path, bone.line, f"bone {bone.name} needs a direction and a length")
        parent, line = sections.parents.get(bone.name, ("", last))
        if parent != canonical.parent:
            raise fault(
                path,
                line,
                f"bone {bone.name} hangs on {parent or 'nothing'}, in CMU's skeleton on "
                f"{canonical.parent}; other skeletons must be retargeted",
            )
        size = float(np.linalg.norm(bone.direction))
        if size < 1e-9 and bone.length > 0.0:
            raise fault(path, bone.line, f"bone {bone.name} has a direction of no length")
        offsets[index] = bone.direction / max(size, 1e-9) * bone.length * metres
        frames[index] = Rotation.from_euler(bone.axis_order, bone.axis * sections.angle).as_matrix()
    return Skeleton(
        subject=Subject.from_offsets(normal_subject(path.stem), offsets, frames),
        metres_per_unit=metres,
        radians_per_unit=sections.angle,
        root_order=sections.root_order,
        root_axis=sections.root_axis,
        dofs={name: bone.dofs for name, bone in sections.bones.items()},
        notes=tuple(sections.notes),
    )


def find_asf(motion: Path) -> Path:
    """The skeleton file that a motion file goes with.

    It is the one beside it of the same name, else the one named as the subject that the
    motion's name begins with, else the only one in the folder.

    Raises:
        MotionError: there is none, or several of which none goes by name.
    """
    files = [f for f in sorted(motion.parent.iterdir()) if f.suffix.lower() == ".asf"]
    by_name = {file.stem.lower(): file for file in files}
    stem = motion.stem.lower()
    for name in (stem, stem.rsplit("_", 1)[0]):
        if name in by_name:
            return by_name[name]
    by_subject = {normal_subject(file.stem): file for file in files}
    subject = normal_subject(stem.rsplit("_", 1)[0])
    if subject in by_subject:
        return by_subject[subject]
    if len(files) == 1:
        return files[0]
    listed = ", ".join(file.name for file in files) or "none at all"
    raise MotionError(
        f"{motion} needs the ASF skeleton of its subject beside it, and its folder has {listed}; "
        f"put {motion.stem}.asf there"
    )


def skeleton_of(motion: Path) -> Path | None:
    """The skeleton file that an AMC file is read with; None for other files, or if it lacks one."""
    if motion.suffix.lower() != ".amc":
        return None
    try:
        return find_asf(motion)
    except MotionError:
        return None


def format_asf(subject: Subject) -> str:
    """A subject as the text of an ASF file, in CMU's units."""
    lines = [
        "# written by localreg",
        ":version 1.10",
        f":name {subject.name.replace(' ', '_') or 'unnamed'}",
        ":units",
        "  mass 1.0",
        "  length 0.45",
        "  angle deg",
        ":documentation",
        "  one length unit is 0.0254 / 0.45 metres, y is up",
        ":root",
        "  order TX TY TZ RX RY RZ",
        "  axis XYZ",
        "  position 0 0 0",
        "  orientation 0 0 0",
        ":bonedata",
    ]
    axes = np.degrees(euler_zyx(subject.axis_frames)[:, ::-1])
    for index, bone in enumerate(BONES):
        lines += [
            "  begin",
            f"    id {index + 1}",
            f"    name {bone.name}",
            f"    direction {_numbers(subject.directions[index])}",
            f"    length {float(subject.lengths[index]) / CMU_UNIT:.12g}",
            f"    axis {_numbers(axes[index])} XYZ",
        ]
        if bone.dofs:
            lines.append(f"    dof {' '.join(CMU_DOFS[bone.name])}")
            limits = [f"({low} {high})" for low, high in reversed(bone.limits_deg)]
            lines.append("    limits " + "\n           ".join(limits))
        lines.append("  end")
    lines += [":hierarchy", "  begin"]
    for parent in ("root", *(bone.name for bone in BONES)):
        children = [bone.name for bone in BONES if bone.parent == parent]
        if children:
            lines.append(f"    {' '.join([parent, *children])}")
    return "\n".join([*lines, "  end", ""])


def _numbers(values: Float[ndarray, "3"]) -> str:
    return " ".join(f"{value:.12g}" for value in values)
