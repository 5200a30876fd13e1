"""What the trackers said while a pose was held: mean, and how well it is known.

The mean over all frames of a hold is what the solver needs; it is as well known as the
trackers' white noise allows, not as the body's sway suggests, for the body sways as a whole
and every tracker sways with it. White noise shows in differences from frame to frame.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.errors import LocalregError
from sensors.pose import TrackerFrame

LEAST_POSITION = 5e-4
"""Least standard deviation of a mean position: skin and straps give [m]."""

LEAST_ORIENTATION = float(np.radians(0.05))
"""Least standard deviation of a mean orientation about each axis [rad]."""


@dataclass(frozen=True, eq=False)
class Hold:
    """One held pose.

    Attributes:
        pose: name of the pose that was asked for.
        positions: mean position of each of the J trackers [m].
        quaternions: mean orientation, w x y z.
        position_covariances: of the mean [m^2].
        orientation_covariances: of the mean, as rotation vectors in tracker axes [rad^2].
        position_mask: True where the position was measured in half of the frames or more.
        orientation_mask: the same for the orientation.
        frames: how many frames went into it.
        sway: largest standard deviation of a tracker's position, noise and all [m].
    """

    pose: str
    positions: Float[ndarray, "J 3"]
    quaternions: Float[ndarray, "J 4"]
    position_covariances: Float[ndarray, "J 3 3"]
    orientation_covariances: Float[ndarray, "J 3 3"]
    position_mask: Bool[ndarray, " J"]
    orientation_mask: Bool[ndarray, " J"]
    frames: int
    sway: float

    def with_order(self, order: Int[ndarray, " J"]) -> "Hold":
        """The same hold with its trackers in another order."""
        return replace(
            self,
            positions=self.positions[order],
            quaternions=self.quaternions[order],
            position_covariances=self.position_covariances[order],
            orientation_covariances=self.orientation_covariances[order],
            position_mask=self.position_mask[order],
            orientation_mask=self.orientation_mask[order],
        )

    @classmethod
    def of_frames(cls, pose: str, frames: Sequence[TrackerFrame]) -> "Hold":
        """The statistics of the frames of a hold.

        Args:
            pose: name of the pose.
            frames: one after another; two at least.

        Raises:
            LocalregError: there are too few.
        """
        if len(frames) < 2:
            raise LocalregError(f"pose {pose} has {len(frames)} frames; hold it for longer")
        J = len(frames[0].position_mask)
        positions, quaternions = np.zeros((J, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (J, 1))
        of_positions = np.tile(np.eye(3) * LEAST_POSITION**2, (J, 1, 1))
        of_orientations = np.tile(np.eye(3) * LEAST_ORIENTATION**2, (J, 1, 1))
        measured = np.array([frame.position_mask for frame in frames])
        turned = np.array([frame.orientation_mask for frame in frames])
        enough = max(2, len(frames) // 2)
        has_position, has_orientation = measured.sum(0) >= enough, turned.sum(0) >= enough
        sway = 0.0
        for j in range(J):
            if has_position[j]:
                p = np.array([f.positions[j] for f in frames])[measured[:, j]]
                positions[j] = p.mean(axis=0)
                of_positions[j] += _noise(p) / len(p)
                sway = max(sway, float(p.std(axis=0).max()))
            if has_orientation[j]:
                q = np.array([f.quaternions[j] for f in frames])[turned[:, j]]
                turns = Rotation.from_quat(q, scalar_first=True)
                mean = turns.mean()
                quaternions[j] = mean.as_quat(scalar_first=True)
                of_orientations[j] += _noise((mean.inv() * turns).as_rotvec()) / len(q)
        return cls(
            pose, positions, quaternions, of_positions, of_orientations,
            has_position, has_orientation, len(frames), sway,
        )  # fmt: skip


def _noise(values: Float[ndarray, "n 3"]) -> Float[ndarray, "3 3"]:
    """Covariance of white noise, from differences between neighbors."""
    steps = np.diff(values, axis=0)
    return steps.T @ steps / (2.0 * len(steps))


def whitener(covariance: Float[ndarray, "3 3"]) -> Float[ndarray, "3 3"]:
    """W with W C W^T = 1."""
    return np.linalg.inv(np.linalg.cholesky(covariance))
