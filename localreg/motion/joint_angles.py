"""Joint angles from rotations of bones and back: R = C Rz(z) Ry(y) Rx(x) C^T.

A bone with all three hinges can take every rotation, in two ways: (z, y, x) and
(z + pi, pi - y, x + pi) are the same. A bone with one or two takes the angles that come
nearest, which leaves a residual unless the rotation was made with those hinges.
"""

from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.skeleton import BONES, DOF_COUNT, joint_limits

_AXES: Final = "xyz"
_SWEEPS: Final = 60
_LIMITS: Final = joint_limits()
_CLEARLY_NEARER: Final = 0.1  # by which another way of writing a joint must be nearer [rad]


def _dof_columns() -> tuple[dict[str, int], ...]:
    """For every bone the index of its angle about each of its axes."""
    columns, start = [], 0
    for bone in BONES:
        columns.append({axis: start + place for place, axis in enumerate(bone.dofs)})
        start += len(bone.dofs)
    return tuple(columns)


_COLUMNS: Final = _dof_columns()


def axis_rotations(axis: str, angles: Float[ndarray, "*b"]) -> Float[ndarray, "*b 3 3"]:
    """Rotation matrices about `"x"`, `"y"` or `"z"` by angles [rad]."""
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    matrices = np.zeros((*angles.shape, 3, 3))
    matrices[..., _AXES.index(axis), _AXES.index(axis)] = 1.0
    sine, cosine = np.sin(angles), np.cos(angles)
    matrices[..., first, first] = matrices[..., second, second] = cosine
    matrices[..., first, second] = -sine
    matrices[..., second, first] = sine
    return matrices


def bone_rotation(
    index: int, angles: Float[ndarray, "frames dofs"], axis_frame: Float[ndarray, "3 3"]
) -> Float[ndarray, "frames 3 3"]:
    """The turn of one bone against its parent, in root axes at rest.

    Args:
        index: of the bone.
        angles: of its hinges, in their order [rad].
        axis_frame: its axis frame C.
    """
    turn = np.broadcast_to(axis_frame, (len(angles), 3, 3))
    for column, axis in enumerate(_COLUMNS[index]):
        turn = turn @ axis_rotations(axis, angles[:, column])
    return turn @ axis_frame.T


def bone_angles(
    index: int, rotations: Float[ndarray, "frames 3 3"], axis_frame: Float[ndarray, "3 3"]
) -> tuple[tuple[int, ...], Float[ndarray, "frames dofs"]]:
    """The angles of one bone that turn it as given, or as near to it as its hinges can.

    Args:
        index: of the bone.
        rotations: its turn against its parent, in root axes at rest.
        axis_frame: its axis frame C.

    Returns:
        Places of its angles among all joint angles, and the angles [rad].
    """
    columns = _COLUMNS[index]
    places = tuple(columns.values())
    turns = axis_frame.T @ rotations @ axis_frame
    if len(columns) == 3:
        return places, _three(turns, _LIMITS[list(places)])
    if len(columns) == 2:
        return places, _two(turns, *columns)
    if len(columns) == 1:
        return places, _one(turns, *columns)[:, None]
    return places, np.zeros((len(turns), 0))


def bone_rotations(
    angles: Float[ndarray, "frames 56"], axis_frames: Float[ndarray, "30 3 3"]
) -> Float[ndarray, "frames 30 3 3"]:
    """The turn of every bone against its parent, in root axes at rest."""
    return np.stack(
        [
            bone_rotation(index, angles[:, list(columns.values())], axis_frames[index])
            for index, columns in enumerate(_COLUMNS)
        ],
        axis=1,
    )


def joint_angles(
    rotations: Float[ndarray, "frames 30 3 3"], axis_frames: Float[ndarray, "30 3 3"]
) -> tuple[Float[ndarray, "frames 56"], Float[ndarray, "frames 30"]]:
    """The angles that turn every bone as given, or as near to it as its hinges can.

    Near means least squares over the entries of the rotation matrix. The angles are
    continuous in time; of the two ways of a bone with three hinges, a clip takes the one
    that strays less beyond the anatomical ranges.

    Args:
        rotations: turn of every bone against its parent, in root axes at rest.
        axis_frames: axis frame C of every bone.

    Returns:
        The joint angles in the order of `DOF_NAMES` [rad], and for every bone the angle of
        the rotation that its hinges could not take [rad].
    """
    angles = np.zeros((len(rotations), DOF_COUNT))
    for index, frame in enumerate(axis_frames):
        places, found = bone_angles(index, rotations[:, index], frame)
        angles[:, list(places)] = found
    missed = np.swapaxes(bone_rotations(angles, axis_frames), -1, -2) @ rotations
    return angles, _turn_angles(missed)


def nearest_to_rest(angles: Float[ndarray, "frames 56"]) -> Float[ndarray, "frames 56"]:
    """The same turns, written with the angles that are nearest to nought over all frames.

    Files write some joints a whole turn away, or in the other of the two ways that a bone
    with three hinges has, because their fits began there. Neighbours written differently
    look like strangers, and pull poses towards a joint's other way of being written.
    """
    if not len(angles):
        return angles
    nearest = _centred(angles)
    for columns in _COLUMNS:
        if len(columns) == 3:
            places = [columns[axis] for axis in "zyx"]
            first = nearest[:, places]
            second = _centred(first * [1.0, -1.0, 1.0] + np.pi)
            if np.abs(second).mean() < np.abs(first).mean() - _CLEARLY_NEARER:
                nearest[:, places] = second
    return nearest


def euler_zyx(rotations: Float[ndarray, "*b 3 3"]) -> Float[ndarray, "*b 3"]:
    """Angles (z, y, x) with R = Rz Ry Rx and |y| <= pi/2 [rad]."""
    r = rotations
    z = np.arctan2(r[..., 1, 0], r[..., 0, 0])
    sine, cosine = np.sin(z), np.cos(z)
    # From Rz^T R = Ry Rx: where y is a quarter turn z is arbitrary, and x still fits it.
    y = np.arctan2(-r[..., 2, 0], cosine * r[..., 0, 0] + sine * r[..., 1, 0])
    x = np.arctan2(
        sine * r[..., 0, 2] - cosine * r[..., 1, 2], cosine * r[..., 1, 1] - sine * r[..., 0, 1]
    )
    return np.stack([z, y, x], axis=-1)


def continuous_zyx(rotations: Float[ndarray, "frames 3 3"]) -> Float[ndarray, "frames 3"]:
    """Angles (z, y, x) with R = Rz Ry Rx, continuous in time; |y| <= pi/2 at first [rad]."""
    return _follow(euler_zyx(rotations))


def _follow(first: Float[ndarray, "frames 3"]) -> Float[ndarray, "frames 3"]:
    """In every frame the way, and the whole turns, that come nearest to the frame before."""
    second = first * [1.0, -1.0, 1.0] + np.pi
    ways = np.stack([first, second], axis=1)
    # Changing the way between two frames costs as much whichever of the two one is on,
    # because the ways differ by an isometry; so one pass of comparisons decides.
    stay = _distance(ways[1:, 0], ways[:-1, 0])
    swap = _distance(ways[1:, 1], ways[:-1, 0])
    way = np.concatenate([[0], np.cumsum(swap < stay) % 2])[: len(first)]
    chosen = ways[np.arange(len(first)), way]
    return np.unwrap(chosen, axis=0) if len(chosen) else chosen


def _distance(
    a: Float[ndarray, "frames 3"], b: Float[ndarray, "frames 3"]
) -> Float[ndarray, " frames"]:
    return np.sum(np.abs(_wrapped(a - b)), axis=1)


def _wrapped(angles: Float[ndarray, "*b"]) -> Float[ndarray, "*b"]:
    return (angles + np.pi) % (2.0 * np.pi) - np.pi


def _three(
    turns: Float[ndarray, "frames 3 3"], limits: Float[ndarray, "3 2"]
) -> Float[ndarray, "frames 3"]:
    first = continuous_zyx(turns)
    ways = [_centred(way) for way in (first, first * [1.0, -1.0, 1.0] + np.pi)]
    excess = [
        float(np.sum(np.maximum(limits[:, 0] - way, 0.0) + np.maximum(way - limits[:, 1], 0.0)))
        for way in ways
    ]
    return ways[int(excess[1] < excess[0])]


def _two(turns: Float[ndarray, "frames 3 3"], outer: str, inner: str) -> Float[ndarray, "frames 2"]:
    """Two hinges, outer then inner: exact where they suffice, else refined by turns."""
    axis = _AXES.index(inner)
    moved = turns[:, :, axis]  # the inner hinge leaves its own axis where the outer puts it
    rest = np.eye(3)[axis]
    pole = _AXES.index(outer)
    u, v = (pole + 1) % 3, (pole + 2) % 3
    a = np.arctan2(
        moved[:, v] * rest[u] - moved[:, u] * rest[v], moved[:, u] * rest[u] + moved[:, v] * rest[v]
    )
    b = np.zeros_like(a)
    for _ in range(_SWEEPS):
        b = _one(axis_rotations(outer, -a) @ turns, inner)
        new = _one(turns @ axis_rotations(inner, -b), outer)
        done = bool(np.all(np.abs(_wrapped(new - a)) < 1e-12))
        a = new
        if done:
            break
    return np.stack([_centred(np.unwrap(a)), _centred(np.unwrap(b))], axis=1)


def _one(turns: Float[ndarray, "frames 3 3"], axis: str) -> Float[ndarray, " frames"]:
    """The angle about one axis whose rotation is nearest to the given one."""
    u, v = (_AXES.index(axis) + 1) % 3, (_AXES.index(axis) + 2) % 3
    return np.unwrap(np.arctan2(turns[:, v, u] - turns[:, u, v], turns[:, u, u] + turns[:, v, v]))


def _centred(angles: Float[ndarray, "frames *d"]) -> Float[ndarray, "frames *d"]:
    """The same angles moved by the whole turns that bring their middle nearest to nought."""
    if not len(angles):
        return angles
    turns = np.round(np.median(angles, axis=0) / (2.0 * np.pi))
    return angles - 2.0 * np.pi * turns


def _turn_angles(rotations: Float[ndarray, "*b 3 3"]) -> Float[ndarray, "*b"]:
    """The angle of every rotation, exact near nought as well."""
    skew = np.stack(
        [
            rotations[..., 2, 1] - rotations[..., 1, 2],
            rotations[..., 0, 2] - rotations[..., 2, 0],
            rotations[..., 1, 0] - rotations[..., 0, 1],
        ],
        axis=-1,
    )
    trace = np.trace(rotations, axis1=-2, axis2=-1)
    return np.arctan2(np.linalg.norm(skew, axis=-1), trace - 1.0)
