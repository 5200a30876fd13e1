"""A motion: poses of one subject at a steady rate, and where it came from."""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final, Self

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray
from scipy.spatial.transform import Rotation, RotationSpline, Slerp

from localreg.body.skeleton import BONES, DOF_BONES, DOF_NAMES, QPOS_SIZE, mirror_name
from localreg.body.subject import Subject
from localreg.errors import MotionError
from localreg.motion.joint_angles import nearest_to_rest

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, slots=True)
class Provenance:
    """Where a motion came from.

    Attributes:
        name: short name, unique within one reading, for example `"02_01"`.
        subject: id of the person, for example `"02"`; empty if unknown.
        trial: id of the recording, equal for all copies of it whatever their file or
            format, for example `"02_01"`; empty if unknown.
        activity: what is done, for example `"walk"`; empty if unknown.
        source: the file it was read from.
        mirrored: whether left and right are exchanged.
        notes: what a reader had to assume or mend.
        skeleton: whose joints the file has, if they are not our bones to the letter.
        joint_errors: for such a file, the mean distance between its joints and ours, by the
            bone of ours that begins there [m].
    """

    name: str
    subject: str = ""
    trial: str = ""
    activity: str = ""
    source: str = ""
    mirrored: bool = False
    notes: tuple[str, ...] = ()
    skeleton: str = ""
    joint_errors: tuple[tuple[str, float], ...] = ()

    @property
    def joint_error(self) -> float | None:
        """The mean of `joint_errors` [m]; None where the file has our own bones."""
        errors = [error for _, error in self.joint_errors]
        return sum(errors) / len(errors) if errors else None


@dataclass(frozen=True, eq=False)
class Motion:
    """Poses over time.

    Attributes:
        qpos: one pose a frame: root position [m], root quaternion w x y z, the 56 joint
            angles of `DOF_NAMES` [rad]. World z is up.
        rate: frames a second [Hz]; may be any positive number.
        subject: whose body moves.
        provenance: where it came from.
    """

    qpos: Float[ndarray, "frames 63"]
    rate: float
    subject: Subject
    provenance: Provenance = field(default=Provenance("unnamed"))

    def __post_init__(self) -> None:
        name = self.provenance.name
        if self.qpos.ndim != 2 or self.qpos.shape[1] != QPOS_SIZE:
            raise MotionError(f"motion {name}: poses of shape {self.qpos.shape}, not (frames, 63)")
        if not (np.isfinite(self.rate) and self.rate > 0):
            raise MotionError(f"motion {name}: a rate of {self.rate} Hz is none")
        bad = np.flatnonzero(~np.isfinite(self.qpos).all(axis=1))
        if bad.size:
            raise MotionError(f"motion {name}: frame {bad[0]} has a number that is not finite")
        norms = np.linalg.norm(self.qpos[:, 3:7], axis=1)
        if np.any(np.abs(norms - 1.0) > 1e-6):
            raise MotionError(f"motion {name}: a root quaternion is not of unit length")

    def __len__(self) -> int:
        return len(self.qpos)

    @property
    def seconds(self) -> float:
        """Duration from the first frame to the last [s]."""
        return max(len(self) - 1, 0) / self.rate

    @property
    def angles(self) -> Float[ndarray, "frames 56"]:
        """The joint angles [rad]."""
        return self.qpos[:, 7:]

    def to_dataframe(self) -> "pd.DataFrame":
        """The joint angles as a pandas data frame (extra `tables`).

        One row a frame: `time` [s], the pelvis' turns [deg] and place [m], then for every
        joint flexion, adduction and rotation or their like [deg], as
        `localreg.motion.anatomical` defines them, and 1 or 0 for the ball and the toes of
        each foot, standing or not; `attrs` says what the columns mean, and name, subject,
        activity and rate.

        Raises:
            MotionError: pandas is not installed.
        """
        from localreg.motion.formats.angle_tables import data_frame

        return data_frame(self)

    def first(self, frames: int) -> Self:
        """The first so many frames."""
        return replace(self, qpos=self.qpos[:frames])

    def resampled(self, rate: float) -> Self:
        """The same motion at another rate [Hz].

        Whole-number reductions keep every n-th frame untouched. Otherwise cubic splines
        pass through the frames: of unwrapped joint angles, and on SO(3) for the root.
        """
        step = self.rate / rate
        if abs(step - round(step)) < 1e-6 and round(step) >= 1:
            return replace(self, qpos=self.qpos[:: round(step)], rate=rate)
        if len(self) < 2:
            return replace(self, rate=rate)
        old = np.arange(len(self)) / self.rate
        from scipy.interpolate import make_interp_spline  # takes longer than a start has time for

        # The small allowance keeps the last frame when rounding puts it a hair too late.
        new = np.arange(0.0, self.seconds + 1e-9, 1.0 / rate).clip(max=self.seconds)
        degree = 3 if len(self) > 3 else 1
        vectors = np.hstack([self.qpos[:, :3], np.unwrap(self.angles, axis=0)])
        vectors = make_interp_spline(old, vectors, k=degree)(new)
        root = Rotation.from_quat(self.qpos[:, 3:7], scalar_first=True)
        turn = RotationSpline(old, root) if degree == 3 else Slerp(old, root)
        quaternions = turn(new).as_quat(scalar_first=True)
        qpos = np.hstack([vectors[:, :3], quaternions, vectors[:, 3:]])
        return replace(self, qpos=qpos, rate=rate)

    def nearest_to_rest(self) -> Self:
        """The same motion, its joint angles written as near to nought as they can be."""
        return replace(self, qpos=np.hstack([self.qpos[:, :7], nearest_to_rest(self.angles)]))

    def mirrored(self) -> Self:
        """The mirror image in the world's x = 0 plane: left and right exchanged.

        Bone by bone the rotation vector (x, y, z) in root axes becomes (x, -y, -z) on the
        other side; the same holds for hinge angles because the axis frames of paired
        bones are mirror images of each other.
        """
        qpos = self.qpos.copy()
        qpos[:, 0] *= -1.0
        qpos[:, 5:7] *= -1.0
        qpos[:, 7:] = self.angles[:, MIRROR_DOFS] * MIRROR_SIGNS
        name = self.provenance.name
        provenance = replace(
            self.provenance,
            name=name.removesuffix("-mirrored") if self.provenance.mirrored else name + "-mirrored",
            mirrored=not self.provenance.mirrored,
        )
        return replace(self, qpos=qpos, subject=self.subject.mirrored(), provenance=provenance)


def _mirror_dofs() -> Int[ndarray, "56"]:
    return np.array(
        [
            DOF_NAMES.index(mirror_name(bone) + name[len(bone) :])
            for bone, name in zip(DOF_BONES, DOF_NAMES, strict=True)
        ]
    )


MIRROR_DOFS: Final = _mirror_dofs()
"""For every joint angle the index of the one it trades places with in a mirror."""

MIRROR_SIGNS: Final = np.array([1.0 if dof == "x" else -1.0 for bone in BONES for dof in bone.dofs])
"""Signs that the joint angles take on in a mirror: turns about y and z reverse."""
