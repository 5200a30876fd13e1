"""Between the files' y-up world and ours, and between their length units and metres.

Files of the Acclaim and BVH families are y up: world = (x, -z, y). The root body keeps
its y-up frame, so that R_world_root = A R_file_root with A a quarter turn about x, and
standing upright is the quaternion (0.7071, 0.7071, 0, 0).
"""

from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

INCH: Final = 0.0254
"""Metres in an inch, the unit that the `length` of ASF files is a multiple of."""

CMU_UNIT: Final = INCH / 0.45
"""Metres in one length unit of CMU's files, about 0.05644."""

_A: Final = Rotation.from_quat([0.5**0.5, 0.5**0.5, 0.0, 0.0], scalar_first=True)


def positions_from_y_up(positions: Float[ndarray, "frames 3"]) -> Float[ndarray, "frames 3"]:
    """World positions of positions in a y-up world."""
    return np.stack([positions[:, 0], -positions[:, 2], positions[:, 1]], axis=1)


def positions_to_y_up(positions: Float[ndarray, "frames 3"]) -> Float[ndarray, "frames 3"]:
    """Positions in a y-up world of world positions."""
    return np.stack([positions[:, 0], positions[:, 2], -positions[:, 1]], axis=1)


def quaternions_from_y_up(turns: Rotation) -> Float[ndarray, "frames 4"]:
    """World quaternions w x y z of the root's rotations in a y-up world.

    The first has w >= 0, and neighbouring frames lie in one hemisphere: no sign jumps.
    """
    quaternions = (_A * turns).as_quat(scalar_first=True)
    if len(quaternions) and quaternions[0, 0] < 0.0:
        quaternions[0] *= -1.0
    flips = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0.0
    quaternions[1:] *= np.where(np.cumsum(flips) % 2 == 1, -1.0, 1.0)[:, None]
    return quaternions


def rotations_to_y_up(quaternions: Float[ndarray, "frames 4"]) -> Rotation:
    """The root's rotations in a y-up world of world quaternions w x y z."""
    return _A.inv() * Rotation.from_quat(quaternions, scalar_first=True)
