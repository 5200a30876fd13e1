"""Poses that a body is sought from where no database says how it may stand."""

from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.skeleton import DOF_COUNT, DOF_NAMES

EASE: Final = np.radians(25.0)
"""How far joint angles may be from the first of these poses, as a standard deviation [rad]."""

# Angles [deg] that differ from the rest pose, in which the arms point sideways.
_STANDING: Final = {"lhumerusrz": 70.0, "rhumerusrz": -70.0, "lradiusrx": 20.0, "rradiusrx": 20.0}
_POSES: Final = (
    _STANDING,
    {},
    {**_STANDING, "lradiusrx": 90.0, "rradiusrx": 90.0},
    {"lhumerusrz": -60.0, "rhumerusrz": 60.0},
    {**_STANDING, "lfemurrx": -80.0, "rfemurrx": -80.0, "ltibiarx": 90.0, "rtibiarx": 90.0},
    {**_STANDING, "lfemurrx": -50.0, "ltibiarx": 60.0},
    {**_STANDING, "rfemurrx": -50.0, "rtibiarx": 60.0},
    {**_STANDING, "lowerbackrx": 30.0, "upperbackrx": 20.0, "thoraxrx": 20.0},
)


def easy_poses() -> Float[ndarray, "S 56"]:
    """Joint angles [rad]; the first is that of easy standing."""
    poses = np.zeros((len(_POSES), DOF_COUNT))
    for row, pose in zip(poses, _POSES, strict=True):
        for name, degrees in pose.items():
            row[DOF_NAMES.index(name)] = np.radians(degrees)
    return poses
