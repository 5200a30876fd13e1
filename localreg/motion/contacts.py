"""When feet stand on the ground: low and slow at once.

The ground is found for every point by itself, as the level that it keeps to when it is
lowest, so that neither the height of the floor in a file nor the thickness of a sole need
be known. A point that never rests, as in a swim or a flight, has no contact.
"""

from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from localreg.body.skeleton import BODY_NAMES

FOOT_BODIES: Final = ("lfoot", "ltoes", "rfoot", "rtoes")
"""The bones whose far ends touch the ground: balls and tips of both feet."""

FOOT_ENDS: Final = tuple(BODY_NAMES.index(name) for name in FOOT_BODIES)
"""Where those ends are among the 31 bone ends."""

HEIGHT: Final = 0.05
"""Largest height above its own ground level of a point in contact [m]."""

SPEED: Final = 0.4
"""Largest speed of a point in contact [m/s].

In real walks the ball of a standing foot, which rolls off, moves at 0.1 to 0.3 m/s and a
swinging one at 2 to 6 m/s; see `HEIGHT` for what is slow but in the air.
"""

SHORTEST: Final = 0.06
"""Contacts, and gaps between them, that are shorter are taken for mistakes [s]."""

_GROUND_PERCENTILE: Final = 5.0


def foot_contacts(
    bone_ends: Float[ndarray, "frames 31 3"], rate: float
) -> Bool[ndarray, "frames 4"]:
    """Which of `FOOT_BODIES` stand on the ground, frame by frame.

    Args:
        bone_ends: world positions of the 31 bone ends, z up [m].
        rate: frames a second [Hz].

    Returns:
        True where the far end of the bone is in contact; all false for fewer than two
        frames, in which nothing can be seen to stand.
    """
    feet = bone_ends[:, FOOT_ENDS]
    if len(feet) < 2:
        return np.zeros(feet.shape[:2], dtype=bool)
    speed = np.linalg.norm(velocities(feet, rate), axis=-1)
    ground = np.percentile(feet[..., 2], _GROUND_PERCENTILE, axis=0)
    return (speed < SPEED) & (feet[..., 2] < ground + HEIGHT)


def settled_contacts(
    bone_ends: Float[ndarray, "frames 31 3"], rate: float
) -> Bool[ndarray, "frames 4"]:
    """The contacts of `foot_contacts`, gaps in them and then contacts left out if too short.

    Args:
        bone_ends: world positions of the 31 bone ends, z up [m].
        rate: frames a second [Hz].
    """
    settled = foot_contacts(bone_ends, rate)
    for column in settled.T:
        for wanted in (False, True):
            for first, last in runs(column == wanted):
                is_inside = wanted or (first > 0 and last < len(column))
                if is_inside and last - first < SHORTEST * rate:
                    column[first:last] = not wanted
    return settled


def runs(mask: Bool[ndarray, " frames"]) -> list[tuple[int, int]]:
    """First and one past the last frame of every stretch in which a mask is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]


def velocities(
    points: Float[ndarray, "frames *points 3"], rate: float
) -> Float[ndarray, "frames *points 3"]:
    """Velocity of points by central differences, one-sided at both ends [m/s].

    Args:
        points: positions, at least two frames of them [m].
        rate: frames a second [Hz].
    """
    return np.gradient(points, axis=0) * rate
