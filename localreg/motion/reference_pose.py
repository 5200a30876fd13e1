"""Frames at the head of a clip that are no motion: a rest pose, and the blend out of it.

Converters put the skeleton's rest pose before the motion; some blend out of it. It is told
by joints that are hardly turned and by a leap that the motion itself never makes.
"""

from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

_REST: Final = np.radians(20.0)
_LEAP: Final = 2.5  # against the fastest step of the motion itself
_LONGEST: Final = 10
_BLEND: Final = 4.0  # against the usual step of the frames that follow
_AFTER: Final = 30


def reference_frames(turn: float, places: Float[ndarray, "frames joints 3"]) -> int:
    """How many frames to leave out at the head of a clip.

    Args:
        turn: by how much the first frame's most turned joint is turned out of rest [rad].
        places: where the joints are, the root first.
    """
    if turn > _REST or len(places) < _LONGEST + _AFTER:
        return 0
    steps = np.linalg.norm(np.diff(places - places[:, :1], axis=0), axis=2).max(axis=1)
    if steps[0] <= _LEAP * steps[_LONGEST:].max():
        return 0
    usual = float(np.mean(steps[_LONGEST : _LONGEST + _AFTER]))
    return int(np.flatnonzero(steps[:_LONGEST] > _BLEND * usual)[-1]) + 1
