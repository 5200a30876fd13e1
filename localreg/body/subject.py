"""A person: bone lengths, rest directions, axis frames, and where the trackers sit.

A `Subject` is what motion files bring along, what calibration estimates and what every
body model is built from. On disk it is a small TOML file that people can read and edit.
"""

import tomllib
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
import tomli_w
from jaxtyping import Float
from numpy import ndarray

from localreg.body.skeleton import (
    BODY_NAMES,
    BONE_NAMES,
    default_axis_frames,
    default_offsets,
    mirror_name,
)
from localreg.errors import SubjectError

FORMAT_VERSION = 1
"""Version written into subject files."""

_MIRROR_INDEX = np.array([BONE_NAMES.index(mirror_name(name)) for name in BONE_NAMES])


@dataclass(frozen=True, slots=True)
class Mount:
    """Where one tracker sits: rigidly on one bone.

    Attributes:
        tracker: name of the tracker, for example `"lhand"`.
        bone: name of the bone (or `"root"`) that carries it.
        position: tracker origin in the bone's frame, from the bone's start [m].
        quaternion: turns tracker axes into bone axes, w x y z, unit length.
    """

    tracker: str
    bone: str
    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if self.bone not in BODY_NAMES:
            raise SubjectError(
                f"tracker {self.tracker!r} is mounted on unknown bone {self.bone!r}; "
                f"bones are {', '.join(BODY_NAMES)}"
            )
        if not np.all(np.isfinite((*self.position, *self.quaternion))):
            raise SubjectError(f"the mount of tracker {self.tracker!r} has a number not finite")
        if abs(np.linalg.norm(self.quaternion) - 1.0) > 1e-3:
            raise SubjectError(
                f"the mount of tracker {self.tracker!r} has quaternion {self.quaternion}, "
                "which is not of unit length"
            )


DEFAULT_TRACKERS: dict[str, str] = {
    "head": "head",
    "torso": "thorax",
    "lhand": "lhand",
    "rhand": "rhand",
    "lankle": "ltibia",
    "rankle": "rtibia",
}
"""The six trackers and the bones at whose far ends they sit, turned as the bones."""


@dataclass(frozen=True, eq=False)
class Subject:
    """Proportions of one person in the canonical skeleton, and the tracker mounts.

    Attributes:
        name: whose proportions these are.
        lengths: length of each of the 30 bones [m].
        directions: unit vectors from start to end of each bone in root axes at rest.
        axis_frames: axis frame C of each bone (see `skeleton`), rotation matrices.
        mounts: the trackers; by default the six of `DEFAULT_TRACKERS`.
    """

    name: str
    lengths: Float[ndarray, "30"]
    directions: Float[ndarray, "30 3"]
    axis_frames: Float[ndarray, "30 3 3"]
    mounts: tuple[Mount, ...] = field(default=())

    def __post_init__(self) -> None:
        if not np.all(np.isfinite(self.lengths)) or np.any(self.lengths < 0):
            raise SubjectError(f"subject {self.name!r} has a bone length that is no length")
        # Written so that NaN, which compares as false, fails too.
        if not np.all(np.abs(np.linalg.norm(self.directions, axis=1) - 1.0) <= 1e-6):
            raise SubjectError(f"subject {self.name!r} has a bone direction not of unit length")
        squares = self.axis_frames @ np.swapaxes(self.axis_frames, 1, 2)
        turns = np.abs(squares - np.eye(3)).max(axis=(1, 2)) <= 1e-4
        turns &= np.linalg.det(self.axis_frames) > 0.0
        if not np.all(turns):
            bone = BONE_NAMES[int(np.argmin(turns))]
            raise SubjectError(
                f"subject {self.name!r} has an axis frame of bone {bone} that is no rotation"
            )
        trackers = [mount.tracker for mount in self.mounts]
        if len(set(trackers)) != len(trackers):
            raise SubjectError(f"subject {self.name!r} mounts a tracker twice: {trackers}")
        if not self.mounts:
            object.__setattr__(self, "mounts", _default_mounts(self.offsets))

    @classmethod
    def from_offsets(
        cls,
        name: str,
        offsets: Float[ndarray, "30 3"],
        axis_frames: Float[ndarray, "30 3 3"] | None = None,
    ) -> Self:
        """A subject with default mounts from start-to-end vectors of the bones [m].

        A bone of no length keeps the canonical skeleton's direction.
        """
        lengths = np.linalg.norm(offsets, axis=1)
        canonical = default_offsets()
        rest = np.where(lengths[:, None] > 1e-9, offsets, canonical)
        directions = rest / np.linalg.norm(rest, axis=1, keepdims=True)
        frames = default_axis_frames() if axis_frames is None else axis_frames
        return cls(name, lengths, directions, frames)

    @property
    def offsets(self) -> Float[ndarray, "30 3"]:
        """Vectors from start to end of the bones, in root axes at rest [m]."""
        return self.lengths[:, None] * self.directions

    @property
    def trackers(self) -> tuple[str, ...]:
        """Names of the trackers in the order of every frame."""
        return tuple(mount.tracker for mount in self.mounts)

    def with_trackers(self, names: tuple[str, ...]) -> Self:
        """The same person wearing only the named trackers, in that order.

        Raises:
            SubjectError: a name is not among the mounts.
        """
        by_name = {mount.tracker: mount for mount in self.mounts}
        unknown = [name for name in names if name not in by_name]
        if unknown or not names:
            raise SubjectError(
                f"no tracker named {', '.join(unknown) or '(none given)'} on subject "
                f"{self.name!r}; it wears {', '.join(by_name)}"
            )
        return replace(self, mounts=tuple(by_name[name] for name in names))

    def mirrored(self) -> Self:
        """The mirror image: left and right exchanged, x reflected, default mounts."""
        reflect = np.array([-1.0, 1.0, 1.0])
        return replace(
            self,
            lengths=self.lengths[_MIRROR_INDEX],
            directions=self.directions[_MIRROR_INDEX] * reflect,
            axis_frames=reflect[:, None] * self.axis_frames[_MIRROR_INDEX] * reflect,
            mounts=(),
        )

    def same_proportions(self, other: "Subject") -> bool:
        """Whether both have the same bones to a tenth of a millimetre."""
        return bool(
            np.allclose(self.offsets, other.offsets, atol=1e-4)
            and np.allclose(self.axis_frames, other.axis_frames, atol=1e-6)
        )


def canonical_subject() -> Subject:
    """The canonical skeleton with the six default trackers."""
    return Subject.from_offsets("canonical", default_offsets())


def _default_mounts(offsets: Float[ndarray, "30 3"]) -> tuple[Mount, ...]:
    ends = dict(zip(BONE_NAMES, offsets.tolist(), strict=True))
    return tuple(Mount(name, bone, tuple(ends[bone])) for name, bone in DEFAULT_TRACKERS.items())


def write_subject(subject: Subject, path: Path) -> None:
    """Write a subject as TOML: lengths by name [m], directions, axis frames, mounts.

    Raises:
        SubjectError: the file cannot be written.
    """
    document = {
        "version": FORMAT_VERSION,
        "name": subject.name,
        "units": "metres, quaternions w x y z, bone frames as in the canonical skeleton",
        "bones": {
            name: {
                "length": float(length),
                "direction": direction.tolist(),
                "axis_frame": frame.tolist(),
            }
            for name, length, direction, frame in zip(
                BONE_NAMES, subject.lengths, subject.directions, subject.axis_frames, strict=True
            )
        },
        "mounts": [
            {
                "tracker": mount.tracker,
                "bone": mount.bone,
                "position": list(mount.position),
                "quaternion": list(mount.quaternion),
            }
            for mount in subject.mounts
        ],
    }
    try:
        path.write_text(tomli_w.dumps(document), encoding="utf-8")
    except OSError as error:
        raise SubjectError(f"cannot write subject file {path}: {error.strerror}") from error


def read_subject(path: Path) -> Subject:
    """Read a subject file; bones and mounts it leaves out keep their defaults.

    Raises:
        SubjectError: the file is not readable as a subject; names the file and the entry.
    """
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SubjectError(f"cannot read subject file {path}: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SubjectError(f"{path} is not a subject file: {error}") from error
    if document.get("version") != FORMAT_VERSION:
        raise SubjectError(
            f"{path} has version {document.get('version')!r}; this program reads {FORMAT_VERSION}"
        )
    try:
        return _subject_from_document(document)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise SubjectError(f"{path} is not a valid subject: {error}") from error
    except SubjectError as error:
        raise SubjectError(f"{path}: {error}") from error


def _subject_from_document(document: dict[str, Any]) -> Subject:
    bones = document.get("bones", {})
    unknown = set(bones) - set(BONE_NAMES)
    if unknown:
        raise SubjectError(f"unknown bones {', '.join(sorted(unknown))}")
    default = canonical_subject()
    lengths, directions = default.lengths.copy(), default.directions.copy()
    frames = default.axis_frames.copy()
    for index, name in enumerate(BONE_NAMES):
        bone = bones.get(name, {})
        lengths[index] = bone.get("length", lengths[index])
        directions[index] = bone.get("direction", directions[index])
        frames[index] = bone.get("axis_frame", frames[index])
    mounts = tuple(
        Mount(
            str(mount["tracker"]),
            str(mount["bone"]),
            _floats(mount["position"], 3),
            _floats(mount.get("quaternion", (1.0, 0.0, 0.0, 0.0)), 4),
        )
        for mount in document.get("mounts", [])
    )
    return Subject(str(document.get("name", "unnamed")), lengths, directions, frames, mounts)


def _floats(values: Any, count: int) -> Any:
    numbers = tuple(float(value) for value in values)
    if len(numbers) != count:
        raise ValueError(f"expected {count} numbers, got {len(numbers)}")
    return numbers
