"""Forward kinematics and Jacobian compiled for the one pose of a live frame.

The same functions as in `localreg.body.kinematics`, which they are tested against, as
machine code without a call's overhead: 3 us for a body instead of 60. Numba compiles them
once and keeps the code beside the user's other caches. Arrays are double precision and
C-contiguous; outputs are written in place, so that a frame allocates next to nothing.
"""

from math import atan2, cos, sin, sqrt
from typing import NamedTuple, no_type_check

import mujoco
import numpy as np
from jaxtyping import Float, Int
from numba import njit
from numpy import ndarray

from localreg.body.model import build_model, tracker_site
from localreg.body.skeleton import DOF_COUNT
from localreg.body.subject import Subject


class Chain(NamedTuple):
    """A subject's kinematic tree and tracker sites as plain arrays; index 0 is the world.

    Attributes:
        parent: parent of each body; parents come first.
        offset: origin of each body in its parent's frame [m].
        orientation: frame of each body in its parent's, w x y z.
        first_hinge: number of the body's first joint angle.
        hinge_count: how many joint angles it has.
        hinge_axis: axis of every joint angle in its body's frame.
        site_body: the body that carries each tracker.
        site_position: in that body's frame [m].
        site_orientation: in that body's frame, w x y z.
    """

    parent: Int[ndarray, " bodies"]
    offset: Float[ndarray, "bodies 3"]
    orientation: Float[ndarray, "bodies 4"]
    first_hinge: Int[ndarray, " bodies"]
    hinge_count: Int[ndarray, " bodies"]
    hinge_axis: Float[ndarray, "56 3"]
    site_body: Int[ndarray, " J"]
    site_position: Float[ndarray, "J 3"]
    site_orientation: Float[ndarray, "J 4"]


class Placed(NamedTuple):
    """Where a pose puts things in the world; written by `place`.

    Attributes:
        position: origin of every body [m].
        orientation: of every body, w x y z.
        hinge_axis: axis of every joint angle.
        site_position: of every tracker [m].
        site_orientation: of every tracker, w x y z.
    """

    position: Float[ndarray, "bodies 3"]
    orientation: Float[ndarray, "bodies 4"]
    hinge_axis: Float[ndarray, "56 3"]
    site_position: Float[ndarray, "J 3"]
    site_orientation: Float[ndarray, "J 4"]


def chain_of(subject: Subject) -> Chain:
    """The tree of a subject's body, with the trackers it wears."""
    return chain_of_model(build_model(subject), [tracker_site(t) for t in subject.trackers])


def chain_of_model(model: mujoco.MjModel, sites: list[str]) -> Chain:
    """The tree of a compiled model, with some of its sites as trackers.

    Raises:
        ValueError: the model has a joint that is neither the free root nor a hinge at its
            body's origin, or more than three hinges on one body.
    """
    if model.jnt_type[0] != mujoco.mjtJoint.mjJNT_FREE or model.body("root").id != 1:
        raise ValueError("the model must begin with a free root")
    for joint in range(1, model.njnt):
        if (
            model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE
            or joint - model.body_jntadr[model.jnt_bodyid[joint]] > 2
            or np.any(model.jnt_pos[joint] != 0)
        ):
            raise ValueError(f"joint {model.joint(joint).name} is not one this tree can hold")
    ids = [model.site(name).id for name in sites]
    # Joint 0, the root's, is not a hinge.
    has_hinges = (np.arange(model.nbody) > 1) & (model.body_jntnum > 0)
    return Chain(
        parent=model.body_parentid.astype(np.int64),
        offset=np.array(model.body_pos),
        orientation=np.array(model.body_quat),
        first_hinge=np.where(has_hinges, model.body_jntadr - 1, 0).astype(np.int64),
        hinge_count=np.where(has_hinges, model.body_jntnum, 0).astype(np.int64),
        hinge_axis=np.array(model.jnt_axis[1:]),
        site_body=model.site_bodyid[ids].astype(np.int64),
        site_position=np.array(model.site_pos[ids]),
        site_orientation=np.array(model.site_quat[ids]),
    )


@njit(cache=True)
@no_type_check
def blank_placed(chain):
    """Room for `place` to write to."""
    bodies, sites = len(chain.parent), len(chain.site_body)
    return Placed(
        np.zeros((bodies, 3)),
        np.zeros((bodies, 4)),
        np.zeros((DOF_COUNT, 3)),
        np.zeros((sites, 3)),
        np.zeros((sites, 4)),
    )


def place_trackers(
    chain: Chain, qpos: Float[ndarray, "63"]
) -> tuple[Float[ndarray, "J 3"], Float[ndarray, "J 4"]]:
    """World poses that the trackers should report: positions [m], quaternions w x y z."""
    placed = blank_placed(chain)
    place(chain, np.ascontiguousarray(qpos, dtype=float), placed)
    return placed.site_position, placed.site_orientation


@njit(cache=True, inline="always")
@no_type_check
def multiply(a, b, out):
    """The quaternion product a b."""
    w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    y = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    z = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]
    out[0], out[1], out[2], out[3] = w, x, y, z


@njit(cache=True, inline="always")
@no_type_check
def conjugate(q, out):
    """The inverse of a unit quaternion."""
    out[0], out[1], out[2], out[3] = q[0], -q[1], -q[2], -q[3]


@njit(cache=True, inline="always")
@no_type_check
def rotate(q, v, out):
    """The vector v turned by the unit quaternion q."""
    x = 2.0 * (q[2] * v[2] - q[3] * v[1])
    y = 2.0 * (q[3] * v[0] - q[1] * v[2])
    z = 2.0 * (q[1] * v[1] - q[2] * v[0])
    v0, v1, v2 = v[0], v[1], v[2]
    out[0] = v0 + q[0] * x + q[2] * z - q[3] * y
    out[1] = v1 + q[0] * y + q[3] * x - q[1] * z
    out[2] = v2 + q[0] * z + q[1] * y - q[2] * x


@njit(cache=True)
@no_type_check
def exponential(v, out):
    """The unit quaternion of a rotation vector [rad]."""
    angle = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    scale = 0.5 - angle * angle / 48.0 if angle < 1e-4 else sin(0.5 * angle) / angle
    out[0] = cos(0.5 * angle)
    out[1], out[2], out[3] = scale * v[0], scale * v[1], scale * v[2]


@njit(cache=True)
@no_type_check
def logarithm(q, out):
    """The rotation vector of a unit quaternion, at most pi long [rad]."""
    sign = 1.0 if q[0] >= 0.0 else -1.0
    length = sqrt(q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    scale = 2.0 if length < 1e-10 else 2.0 * atan2(length, sign * q[0]) / length
    out[0], out[1], out[2] = scale * sign * q[1], scale * sign * q[2], scale * sign * q[3]


@njit(cache=True)
@no_type_check
def inverse_left_jacobian(v, out):
    """The inverse left Jacobian of SO(3) at a rotation vector; finite at pi, too."""
    x, y, z = v[0], v[1], v[2]
    squared = x * x + y * y + z * z
    if squared < 1e-6:
        c = 1.0 / 12.0 + squared / 720.0
    else:
        half = 0.5 * sqrt(squared)
        c = (1.0 - half * cos(half) / sin(half)) / squared
    out[0, 0] = 1.0 - c * (y * y + z * z)
    out[0, 1] = 0.5 * z + c * x * y
    out[0, 2] = -0.5 * y + c * x * z
    out[1, 0] = -0.5 * z + c * x * y
    out[1, 1] = 1.0 - c * (x * x + z * z)
    out[1, 2] = 0.5 * x + c * y * z
    out[2, 0] = 0.5 * y + c * x * z
    out[2, 1] = -0.5 * x + c * y * z
    out[2, 2] = 1.0 - c * (x * x + y * y)


@njit(cache=True)
@no_type_check
def integrate(qpos, step, out):
    """The pose moved by a tangent step; see `localreg.body.kinematics.integrate`."""
    turn = np.empty(4)
    exponential(step[3:6], turn)
    multiply(qpos[3:7], turn, out[3:7])
    norm = sqrt(out[3] ** 2 + out[4] ** 2 + out[5] ** 2 + out[6] ** 2)
    for i in range(3):
        out[i] = qpos[i] + step[i]
    for i in range(3, 7):
        out[i] /= norm
    for i in range(7, len(qpos)):
        out[i] = qpos[i] + step[i - 1]


@njit(cache=True)
@no_type_check
def difference(start, end, out):
    """The tangent step from one pose to another."""
    back, turn = np.empty(4), np.empty(4)
    conjugate(start[3:7], back)
    multiply(back, end[3:7], turn)
    logarithm(turn, out[3:6])
    for i in range(3):
        out[i] = end[i] - start[i]
    for i in range(6, len(out)):
        out[i] = end[i + 1] - start[i + 1]


@njit(cache=True)
@no_type_check
def place(chain, qpos, placed):
    """Write where a pose puts bodies, hinges and trackers."""
    position, orientation, axis = placed.position, placed.orientation, placed.hinge_axis
    turn = np.empty(4)
    position[0] = 0.0
    orientation[0] = 0.0
    orientation[0, 0] = 1.0
    position[1] = qpos[:3]
    orientation[1] = qpos[3:7]
    for body in range(2, len(chain.parent)):
        parent = chain.parent[body]
        q = orientation[body]
        rotate(orientation[parent], chain.offset[body], position[body])
        for i in range(3):
            position[body, i] += position[parent, i]
        multiply(orientation[parent], chain.orientation[body], q)
        first = chain.first_hinge[body]
        for hinge in range(first, first + chain.hinge_count[body]):
            local = chain.hinge_axis[hinge]
            rotate(q, local, axis[hinge])
            half = 0.5 * qpos[7 + hinge]
            s = sin(half)
            turn[0] = cos(half)
            turn[1], turn[2], turn[3] = s * local[0], s * local[1], s * local[2]
            multiply(q, turn, q)
    for site in range(len(chain.site_body)):
        body = chain.site_body[site]
        rotate(orientation[body], chain.site_position[site], placed.site_position[site])
        for i in range(3):
            placed.site_position[site, i] += position[body, i]
        multiply(orientation[body], chain.site_orientation[site], placed.site_orientation[site])


@njit(cache=True)
@no_type_check
def tracker_jacobian(chain, placed, out):
    """Write velocity and angular velocity of every tracker by the 62 tangent coordinates.

    `out` has shape (J, 6, 62); the pose is the one that was placed last.
    """
    out[:] = 0.0
    root = np.empty((3, 3))
    unit = np.zeros(3)
    for k in range(3):
        unit[:] = 0.0
        unit[k] = 1.0
        rotate(placed.orientation[1], unit, root[k])
    for site in range(len(chain.site_body)):
        rows = out[site]
        at = placed.site_position[site]
        for k in range(3):
            rows[k, k] = 1.0
            _turn_column(root[k], at, placed.position[1], rows, 3 + k)
        body = chain.site_body[site]
        while body > 1:
            first = chain.first_hinge[body]
            for hinge in range(first, first + chain.hinge_count[body]):
                _turn_column(placed.hinge_axis[hinge], at, placed.position[body], rows, 6 + hinge)
            body = chain.parent[body]


@njit(cache=True, inline="always")
@no_type_check
def _turn_column(axis, at, pivot, rows, column):
    x, y, z = at[0] - pivot[0], at[1] - pivot[1], at[2] - pivot[2]
    rows[0, column] = axis[1] * z - axis[2] * y
    rows[1, column] = axis[2] * x - axis[0] * z
    rows[2, column] = axis[0] * y - axis[1] * x
    rows[3, column] = axis[0]
    rows[4, column] = axis[1]
    rows[5, column] = axis[2]
