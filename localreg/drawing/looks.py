"""Other looks of a body than its capsules: a stick figure, and one of diamonds.

Each look is a geom group of the model, so that a running viewer can change between them.
The shapes of the looks weigh nothing and touch nothing.
"""

from typing import Any, Final, Literal, get_args

import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.skeleton import BONES
from localreg.body.subject import Subject

Look = Literal["capsules", "sticks", "diamonds"]
"""How bodies look."""

LOOKS: Final[tuple[Look, ...]] = get_args(Look)
"""All looks, in the order in which a key goes through them."""

LOOK_GROUPS: Final[dict[Look, int]] = {"capsules": 2, "sticks": 3, "diamonds": 4}
"""In which geom group of the model each look is; capsules are the body model's own."""

_STICK_RADIUS: Final = 0.011
_JOINT_RADIUS: Final = 0.021
_HEAD_RADIUS: Final = 0.085
_SHORTEST: Final = 0.02  # a shorter bone is seen as its joint alone [m]
_WAIST: Final = 0.22  # where a diamond is thickest, as a share of its length
_WAIST_WIDTH: Final = 0.13  # half its width there, as a share of its length
_WIDEST: Final = 0.05  # and no more than this [m]


def show_look(option: mujoco.MjvOption, look: Look) -> None:
    """Let one look of the bodies be seen, and no sites."""
    for name, group in LOOK_GROUPS.items():
        option.geomgroup[group] = name == look
    option.sitegroup[:] = 0


def add_looks(spec: mujoco.MjSpec, subject: Subject, material: str, girth: float = 1.0) -> None:
    """Add sticks and diamonds to the specification of a subject's body.

    Args:
        spec: as `build_spec` made it; changed.
        subject: the same.
        material: name of the material to wear.
        girth: how thick everything is, 1 for as usual.
    """
    for bone, offset in zip(BONES, subject.offsets, strict=True):
        body = spec.body(bone.name)
        for look in ("sticks", "diamonds"):
            # The hips have no joint of their own: a ball there would only be in the way.
            if bone.dofs:
                _add_geom(body, look, material, size=[girth * _JOINT_RADIUS, 0.0, 0.0])
        length = float(np.linalg.norm(offset))
        if bone.name == "head" and length > _SHORTEST:
            middle = 0.6 * offset
            for look in ("sticks", "diamonds"):
                _add_geom(body, look, material, size=[girth * _HEAD_RADIUS, 0.0, 0.0], pos=middle)
        if length < _SHORTEST:
            continue
        _add_geom(
            body,
            "sticks",
            material,
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=[0.0, 0.0, 0.0, *offset],
            size=[girth * _STICK_RADIUS, 0.0, 0.0],
        )
        corners = _diamond(offset, length, girth)
        spec.add_mesh(
            name=f"diamond:{bone.name}",
            uservert=corners.ravel(),
            userface=np.arange(len(corners), dtype=np.int32),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        _add_geom(
            body,
            "diamonds",
            material,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=f"diamond:{bone.name}",
        )


def _add_geom(body: Any, look: Look, material: str, **shape: Any) -> None:
    body.add_geom(
        group=LOOK_GROUPS[look],
        material=material,
        mass=0.0,
        contype=0,
        conaffinity=0,
        **shape,
    )


def _diamond(
    offset: Float[ndarray, "3"], length: float, girth: float
) -> Float[ndarray, "corners 3"]:
    """Two pyramids on one square, face by face so that edges stay sharp; outside counterclockwise.

    Returns:
        The corners of the 8 triangles one after the other.
    """
    along = offset / length
    # Any direction will do that is not the bone's.
    aside = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    aside /= np.linalg.norm(aside)
    across = np.cross(along, aside)
    half = girth * min(_WAIST_WIDTH * length, _WIDEST)
    square = [_WAIST * offset + half * side for side in (aside, across, -aside, -across)]
    corners = []
    for i in range(4):
        a, b = square[i], square[(i + 1) % 4]
        corners += [np.zeros(3), b, a, offset, a, b]
    return np.array(corners)
