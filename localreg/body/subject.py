"""A person: bone lengths, rest directions, axis frames, and where the trackers sit.

A `Subject` is what motion files bring along, what calibration estimates and what every
body model is built from. On disk it is a small TOML file that people can read and edit.
"""

import tomllib
from collections.abc import Mapping
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


@dataclass(frozen=True, slots=True)
class CalibrationRecord:
    """How a subject was calibrated, and how well its numbers are known.

    Attributes:
        date: when, as ISO 8601 text.
        method: how, for example `"eight poses"`.
        poses: names of the poses that counted.
        pose_error: estimated error of a joint about each axis while a pose was held [rad].
        chi_square: sum of squared standardized residuals per degree of freedom; near 1 when
            model and measurements agree.
        lengths_from: what the penalty on lengths was learned from.
        length_sd: standard deviation of each bone's length, by bone [m].
        position_sd: of each mount's position on each axis, by tracker [m].
        orientation_sd: of each mount's orientation about each axis, by tracker [rad].
        observable: bones whose length the trackers themselves told, rather than the
            proportions that people usually have.
        notes: what was found amiss.
    """

    date: str
    method: str = ""
    poses: tuple[str, ...] = ()
    pose_error: float = float("nan")
    chi_square: float = float("nan")
    lengths_from: str = ""
    length_sd: Mapping[str, float] = field(default_factory=dict)
    position_sd: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    orientation_sd: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)
    observable: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Subject:
    """Proportions of one person in the canonical skeleton, and the tracker mounts.

    Attributes:
        name: whose proportions these are.
        lengths: length of each of the 30 bones [m].
        directions: unit vectors from start to end of each bone in root axes at rest.
        axis_frames: axis frame C of each bone (see `skeleton`), rotation matrices.
        mounts: the trackers; by default the six of `DEFAULT_TRACKERS`.
        calibration: how well all this is known, if it was calibrated.
    """

    name: str
    lengths: Float[ndarray, "30"]
    directions: Float[ndarray, "30 3"]
    axis_frames: Float[ndarray, "30 3 3"]
    mounts: tuple[Mount, ...] = field(default=())
    calibration: CalibrationRecord | None = None

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
            calibration=None,
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
    document: dict[str, Any] = {
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
    if subject.calibration is not None:
        _add_calibration(document, subject.calibration)
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
    name, record = str(document.get("name", "unnamed")), _calibration_from_document(document)
    return Subject(name, lengths, directions, frames, mounts, record)


def _add_calibration(document: dict[str, Any], record: CalibrationRecord) -> None:
    """Deviations beside the numbers they belong to, the rest in a table of its own."""
    for bone, deviation in record.length_sd.items():
        document["bones"][bone]["length_sd"] = deviation
    for mount in document["mounts"]:
        if mount["tracker"] in record.position_sd:
            mount["position_sd"] = list(record.position_sd[mount["tracker"]])
        if mount["tracker"] in record.orientation_sd:
            degrees = np.degrees(record.orientation_sd[mount["tracker"]])
            mount["orientation_sd_deg"] = degrees.tolist()
    document["calibration"] = {
        "date": record.date,
        "method": record.method,
        "poses": list(record.poses),
        "pose_error_deg": float(np.degrees(record.pose_error)),
        "chi_square": record.chi_square,
        "lengths_from": record.lengths_from,
        "observable": list(record.observable),
        "notes": list(record.notes),
    }


def _calibration_from_document(document: dict[str, Any]) -> CalibrationRecord | None:
    table = document.get("calibration")
    if table is None:
        return None
    mounts = document.get("mounts", [])
    return CalibrationRecord(
        date=str(table["date"]),
        method=str(table.get("method", "")),
        poses=tuple(map(str, table.get("poses", ()))),
        pose_error=float(np.radians(table.get("pose_error_deg", np.nan))),
        chi_square=float(table.get("chi_square", np.nan)),
        lengths_from=str(table.get("lengths_from", "")),
        length_sd={
            name: float(bone["length_sd"])
            for name, bone in document.get("bones", {}).items()
            if "length_sd" in bone
        },
        position_sd={
            str(m["tracker"]): _floats(m["position_sd"], 3) for m in mounts if "position_sd" in m
        },
        orientation_sd={
            str(m["tracker"]): tuple(np.radians(_floats(m["orientation_sd_deg"], 3)).tolist())
            for m in mounts
            if "orientation_sd_deg" in m
        },
        observable=tuple(map(str, table.get("observable", ()))),
        notes=tuple(map(str, table.get("notes", ()))),
    )


def _floats(values: Any, count: int) -> Any:
    numbers = tuple(float(value) for value in values)
    if len(numbers) != count:
        raise ValueError(f"expected {count} numbers, got {len(numbers)}")
    return numbers
