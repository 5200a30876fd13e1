"""What a tracker says, and what all of them say at one instant.

World convention, here and everywhere inside the project: metres, seconds, right-handed,
z up, quaternions w x y z, active rotations (a quaternion turns tracker axes into world
axes). Device modules convert to it; nothing downstream converts again.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class PoseSample:
    """One pose report of one tracker.

    Attributes:
        tracker: name of the tracker in the configuration, for example `"head"`.
        time: capture instant on the host's monotonic clock [s].
        position: world position, shape (3,) [m].
        quaternion: world orientation w x y z, shape (4,), unit length.
        quality: 1.0 perfect, 0.0 useless, as far as the device tells.
    """

    tracker: str
    time: float
    position: NDArray[np.float64]
    quaternion: NDArray[np.float64]
    quality: float = 1.0


class TrackerFrame(NamedTuple):
    """All J trackers at one instant, always of the same shape.

    A named tuple of arrays, hence a JAX pytree without this package knowing JAX.
    Entries of masked trackers are finite but mean nothing.

    Attributes:
        time: the instant on the host's monotonic clock [s].
        positions: shape (J, 3) [m].
        quaternions: w x y z, shape (J, 4), unit length.
        position_mask: True where the position was measured, shape (J,).
        orientation_mask: True where the orientation was measured, shape (J,).
    """

    time: float
    positions: NDArray[np.float64]
    quaternions: NDArray[np.float64]
    position_mask: NDArray[np.bool_]
    orientation_mask: NDArray[np.bool_]
