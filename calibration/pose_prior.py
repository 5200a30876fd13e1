"""What poses are likely near a pose: a Gaussian through its neighbors in a database."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from localreg.body.skeleton import DOF_COUNT
from localreg.database.store import PoseDatabase

_CHUNK: Final = 1 << 15


@dataclass(frozen=True, eq=False)
class PosePriors:
    """One Gaussian of joint angles for each of N poses.

    Attributes:
        means: [rad].
        covariances: [rad^2].
    """

    means: Float[ndarray, "N 56"]
    covariances: Float[ndarray, "N 56 56"]

    @classmethod
    def near(
        cls,
        angles: Float[ndarray, "N 56"],
        database: PoseDatabase,
        allowed: Bool[ndarray, " poses"] | None,
        *,
        neighbors: int,
        floor: float,
    ) -> "PosePriors":
        """The neighbors' mean and covariance, wider where a pose is unlike its own neighbors.

        Args:
            angles: the poses as they seem to be [rad].
            database: real poses.
            allowed: which of them may be used; all if None.
            neighbors: how many make a Gaussian.
            floor: least standard deviation in every direction [rad].
        """
        rows = nearest(angles, database, allowed, neighbors)
        means, covariances = np.zeros(angles.shape), np.zeros((len(angles), DOF_COUNT, DOF_COUNT))
        for i, near in enumerate(rows):
            poses = np.asarray(database.angles[near], dtype=float)
            means[i] = poses.mean(axis=0)
            away = poses - means[i]
            covariance = away.T @ away / len(poses) + floor**2 * np.eye(DOF_COUNT)
            d = angles[i] - means[i]
            # A pose that is many deviations off is of a kind that the database does not know.
            odd = max(float(d @ np.linalg.solve(covariance, d)) / DOF_COUNT, 1.0)
            covariances[i] = odd * covariance
        return cls(means, covariances)


def nearest(
    angles: Float[ndarray, "N 56"],
    database: PoseDatabase,
    allowed: Bool[ndarray, " poses"] | None,
    count: int,
) -> Int[ndarray, "N k"]:
    """The poses of a database that are nearest in joint angles, in no order.

    Args:
        angles: [rad].
        database: real poses.
        allowed: which of them may be used; all if None.
        count: how many, or all that there are.
    """
    usable = np.arange(len(database)) if allowed is None else np.flatnonzero(allowed)
    count = min(count, len(usable))
    wanted = angles.astype(np.float32)
    best = np.zeros((len(angles), 0), dtype=usable.dtype)
    far = np.zeros((len(angles), 0), dtype=np.float32)
    for first in range(0, len(usable), _CHUNK):
        rows = usable[first : first + _CHUNK]
        poses = np.asarray(database.angles[rows])
        squares = np.sum(poses**2, axis=1) - 2.0 * wanted @ poses.T
        far = np.concatenate([far, squares], axis=1)
        best = np.concatenate([best, np.broadcast_to(rows, squares.shape)], axis=1)
        if far.shape[1] > count:
            kept = np.argpartition(far, count - 1, axis=1)[:, :count]
            far = np.take_along_axis(far, kept, axis=1)
            best = np.take_along_axis(best, kept, axis=1)
    return best
