"""Where a body is seen from: presets that know which way it faces, and following it."""

import math
from dataclasses import replace
from typing import Final, Literal, get_args

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.drawing.offscreen import Camera

Preset = Literal["follow", "front", "back", "left", "right", "top"]
"""A way of looking; `follow` stays three quarters in front of the body and turns with it."""

PRESETS: Final[tuple[Preset, ...]] = get_args(Preset)
"""All presets, in the order of their keys and buttons."""

# The direction of view relative to the direction faced, and its elevation [deg].
_VIEWS: Final[dict[Preset, tuple[float, float]]] = {
    "follow": (180.0 - 42.0, -9.0),
    "front": (180.0, -6.0),
    "back": (0.0, -8.0),
    "left": (-90.0, -6.0),
    "right": (90.0, -6.0),
    "top": (0.0, -89.0),
}

USUAL_HEIGHT: Final = 1.8
"""Of a body whose height nobody tells [m]."""

_AIR: Final = 1.36  # what a picture shows from bottom to top at the body, in its heights
_SPREAD: Final = 1.0  # and from left to right at least, for arms
_MIDDLE: Final = 0.51  # height above the floor that is looked at, in the body's
_USUAL: Final = (0.25, 0.62)  # heights of the root at which the camera stays, in the body's
_HALF_FIELD: Final = math.tan(math.radians(22.5))  # of MuJoCo's free camera, vertically
_MOVES_IN: Final = 0.15  # how soon the camera has followed the body [s]
_TURNS_IN: Final = 1.2  # how soon it has turned after it [s]
_LEANING: Final = 0.35  # a root whose face is steeper than this tells no direction


def heading(qpos: Float[ndarray, "63"]) -> float | None:
    """Which way a body faces over the ground, 0 along world x [rad]; None if it lies."""
    w, x, y, z = qpos[3:7]
    # The root's own z axis points forward.
    forward = np.array([2.0 * (x * z + w * y), 2.0 * (y * z - w * x)])
    if np.hypot(*forward) < _LEANING:
        return None
    return float(np.arctan2(forward[1], forward[0]))


def look_from(
    preset: Preset,
    qpos: Float[ndarray, "63"],
    *,
    aspect: float = 16 / 9,
    height: float = USUAL_HEIGHT,
    facing: float | None = None,
) -> Camera:
    """The camera of a preset, with the whole body in the picture.

    Args:
        preset: from where.
        qpos: the body.
        aspect: width over height of the picture.
        height: of the body when it stands upright [m].
        facing: which way the body faces where the pose does not tell [rad].
    """
    found = heading(qpos)
    direction = found if found is not None else (facing if facing is not None else -math.pi / 2)
    turn, elevation = _VIEWS[preset]
    tall = height * max(_AIR, _SPREAD / aspect)
    distance = 0.5 * tall / _HALF_FIELD
    return Camera(
        _target(qpos, height), direction + math.radians(turn), math.radians(elevation), distance
    )


def followed(
    camera: Camera,
    qpos: Float[ndarray, "63"],
    elapsed: float,
    *,
    turning: bool,
    height: float = USUAL_HEIGHT,
) -> Camera:
    """The camera a little later: it goes after the body, softly.

    Args:
        camera: where it was.
        qpos: the body.
        elapsed: since then [s].
        turning: whether it also turns with the body, as `follow` does.
        height: of the body when it stands upright [m].
    """
    if elapsed <= 0.0:
        return camera
    moved = 1.0 - math.exp(-elapsed / _MOVES_IN)
    here = np.asarray(camera.target)
    x, y, z = here + moved * (np.asarray(_target(qpos, height)) - here)
    azimuth = camera.azimuth
    facing = heading(qpos)
    if turning and facing is not None:
        wanted = facing + math.radians(_VIEWS["follow"][0])
        around = math.remainder(wanted - azimuth, math.tau)
        azimuth += (1.0 - math.exp(-elapsed / _TURNS_IN)) * around
    return replace(camera, target=(float(x), float(y), float(z)), azimuth=azimuth)


def _target(qpos: Float[ndarray, "63"], height: float) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in qpos[:3])
    low, high = (share * height for share in _USUAL)
    # Up and down goes only who leaves the ground or lies on it.
    return x, y, _MIDDLE * height + max(0.0, z - high) + 0.5 * min(0.0, z - low)
