"""Where other systems' axes point, and the way from them to the world (z up)."""

from collections.abc import Callable
from typing import Literal

from sensors.protocols.is900.axes import flip_position, flip_quaternion
from sensors.rotation import Array

Axes = Literal["z-up", "y-up", "north-east-down"]
"""Right-handed conventions: the world's own; x right and y up (world = x, -z, y), as most
optical and virtual reality systems have it; x north, y east, z down, as the IS-900."""

_Map = Callable[[Array], Array]


def to_world(axes: Axes) -> tuple[_Map, _Map]:
    """Functions that take positions (..., 3) and quaternions w x y z (..., 4) to the world."""
    return {
        "z-up": (_same, _same),
        "y-up": (_position_y_up, _quaternion_y_up),
        "north-east-down": (flip_position, flip_quaternion),
    }[axes]


def _same(a: Array) -> Array:
    return a


def _position_y_up(p: Array) -> Array:
    return p[..., [0, 2, 1]] * [1.0, -1.0, 1.0]


def _quaternion_y_up(q: Array) -> Array:
    return q[..., [0, 1, 3, 2]] * [1.0, 1.0, -1.0, 1.0]
