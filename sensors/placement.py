"""Where one world sits in another: a turn about the vertical, then a shift."""

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from sensors import rotation
from sensors.settings import Settings


class Placement(Settings):
    """A world in a larger one, both z up.

    As `[room]` of a configuration file: the trackers' world in the room, as written by
    `localreg sensors align`. As `placement` of a device: the device's world in that of all
    devices, for set-ups with more than one tracking system.

    Attributes:
        yaw: turn about the vertical, counterclockwise seen from above [deg].
        translation: where the inner origin comes to lie, x y z [m].
    """

    yaw: float = Field(default=0.0, ge=-360.0, le=360.0)
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @cached_property
    def transform(self) -> "RoomTransform":
        """The same, ready to be applied to poses."""
        return RoomTransform(math.radians(self.yaw), self.translation)


@dataclass(frozen=True, slots=True)
class RoomTransform:
    """Where the tracker's world sits in the room: a turn about the vertical, then a shift.

    Attributes:
        yaw: angle about z, counterclockwise seen from above [rad].
        translation: the tracker's origin in the room, x y z [m].
    """

    yaw: float = 0.0
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    # The turn as matrices from the right, for this runs for every sample: rows of positions
    # times one, rows of quaternions times the other.
    _turn: NDArray[np.float64] = field(init=False, repr=False, compare=False)
    _turn_quaternion: NDArray[np.float64] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        q = np.array([math.cos(0.5 * self.yaw), 0.0, 0.0, math.sin(0.5 * self.yaw)])
        object.__setattr__(self, "_turn", rotation.rotate(q, np.eye(3)))
        object.__setattr__(self, "_turn_quaternion", rotation.multiply(q, np.eye(4)))

    def apply(
        self, p: NDArray[np.float64], q: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Tracker world to room: positions (..., 3) [m], quaternions (..., 4)."""
        return p @ self._turn + np.array(self.translation), q @ self._turn_quaternion

    def invert(
        self, p: NDArray[np.float64], q: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Room to tracker world: positions (..., 3) [m], quaternions (..., 4)."""
        # Both matrices are orthogonal.
        return (p - np.array(self.translation)) @ self._turn.T, q @ self._turn_quaternion.T
