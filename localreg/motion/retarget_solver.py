"""Poses that bring bone ends and orientations to their targets, frame after frame.

Damped least squares (Levenberg-Marquardt) over the pose's 62 tangent coordinates, with
the compiled kinematics of `localreg.body.chain`. Each frame starts from the pose before
it or from its analytic guess, whichever is nearer.
"""

from math import sqrt
from typing import Final, no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray

from localreg.body.chain import (
    Chain,
    blank_placed,
    conjugate,
    integrate,
    logarithm,
    multiply,
    place,
    tracker_jacobian,
)
from localreg.body.skeleton import BONES, DOF_COUNT
from localreg.body.subject import Subject

_STEPS: Final = 12
_SMALL: Final = 1e-5  # a step of so little is the last [m, rad]


def bone_chain(subject: Subject) -> Chain:
    """A subject's kinematic tree with a site at the root and at every bone's end."""
    count = len(BONES)
    index = {"root": 1} | {bone.name: i + 2 for i, bone in enumerate(BONES)}
    offset = np.zeros((count + 2, 3))
    parent = np.zeros(count + 2, dtype=np.int64)
    first, hinges = np.zeros(count + 2, dtype=np.int64), np.zeros(count + 2, dtype=np.int64)
    axes = np.zeros((DOF_COUNT, 3))
    taken = 0
    for number, bone in enumerate(BONES):
        body = number + 2
        parent[body] = index[bone.parent]
        if bone.parent != "root":
            offset[body] = subject.offsets[index[bone.parent] - 2]
        first[body], hinges[body] = taken if bone.dofs else 0, len(bone.dofs)
        for dof in bone.dofs:
            axes[taken] = subject.axis_frames[number][:, "xyz".index(dof)]
            taken += 1
    unturned = np.tile([1.0, 0.0, 0.0, 0.0], (count + 2, 1))
    return Chain(
        parent=parent,
        offset=offset,
        orientation=unturned,
        first_hinge=first,
        hinge_count=hinges,
        hinge_axis=axes,
        site_body=np.arange(1, count + 2),
        site_position=np.vstack([np.zeros((1, 3)), subject.offsets]),
        site_orientation=unturned[1:].copy(),
    )


def solve_poses(
    subject: Subject,
    guesses: Float[ndarray, "frames 63"],
    points: Float[ndarray, "frames 31 3"],
    orientations: Float[ndarray, "frames 31 4"],
    point_trust: Float[ndarray, "31"],
    orientation_trust: Float[ndarray, "31"],
) -> Float[ndarray, "frames 63"]:
    """The poses that fit all frames best.

    Args:
        subject: whose bones.
        guesses: a pose near the solution of every frame.
        points: where the root's origin and the bones' ends should be [m]; NaN for no matter.
        orientations: of the root and the bones, w x y z.
        point_trust: in each of the points [1/m].
        orientation_trust: in each of the orientations [1/rad].
    """
    chain = bone_chain(subject)
    out = np.empty_like(guesses)
    _solve(
        chain,
        blank_placed(chain),
        np.ascontiguousarray(guesses),
        np.ascontiguousarray(points),
        np.ascontiguousarray(orientations),
        point_trust,
        orientation_trust,
        out,
    )
    return out


def joint_points(
    subject: Subject, qpos: Float[ndarray, "frames 63"]
) -> tuple[Float[ndarray, "frames 31 3"], Float[ndarray, "frames 31 4"]]:
    """Where poses put the root's origin and the ends of all bones [m], and how bones turn."""
    chain = bone_chain(subject)
    points, turns = np.empty((len(qpos), 31, 3)), np.empty((len(qpos), 31, 4))
    _place_all(chain, blank_placed(chain), np.ascontiguousarray(qpos), points, turns)
    return points, turns


@njit(cache=True)
@no_type_check
def _place_all(chain, placed, qpos, points, turns):
    for frame in range(len(qpos)):
        place(chain, qpos[frame], placed)
        points[frame] = placed.site_position
        turns[frame] = placed.site_orientation


@njit(cache=True)
@no_type_check
def _solve(chain, placed, guesses, points, turns, point_trust, turn_trust, out):
    sites = len(chain.site_body)
    size = guesses.shape[1] - 1
    jacobian = np.zeros((sites, 6, size))
    columns, counts = _columns(chain, size)
    errors = np.zeros((sites, 6))
    A, factor = np.zeros((size, size)), np.zeros((size, size))
    g, step = np.zeros(size), np.zeros(size)
    q, trial = guesses[0].copy(), guesses[0].copy()
    for frame in range(len(guesses)):
        p, r = points[frame], turns[frame]
        if frame > 0:
            q[:] = out[frame - 1]
        cost = _cost(chain, placed, q, p, r, point_trust, turn_trust, errors)
        guess = _cost(chain, placed, guesses[frame], p, r, point_trust, turn_trust, errors)
        if guess < 0.25 * cost or frame == 0:
            q[:] = guesses[frame]
            cost = guess
        damping = 1e-4
        for _ in range(_STEPS):
            cost = _cost(chain, placed, q, p, r, point_trust, turn_trust, errors)
            tracker_jacobian(chain, placed, jacobian)
            _normal(jacobian, errors, p, point_trust, turn_trust, columns, counts, A, g)
            better = False
            length = 0.0
            for _ in range(6):
                if _step(A, g, damping, factor, step):
                    integrate(q, step, trial)
                    new = _cost(chain, placed, trial, p, r, point_trust, turn_trust, errors)
                    if new <= cost:
                        better = True
                        break
                damping = max(damping, 1e-4) * 10.0
            if not better:
                break
            length = 0.0
            for i in range(size):
                length = max(length, abs(step[i]))
            gain = cost - new
            q[:] = trial
            damping = max(0.1 * damping, 1e-6)
            if length < _SMALL or gain < 1e-6 * (1.0 + new):
                break
        out[frame] = q


@njit(cache=True)
@no_type_check
def _columns(chain, size):
    """Which tangent coordinates move each site."""
    sites = len(chain.site_body)
    columns = np.zeros((sites, size), dtype=np.int64)
    counts = np.zeros(sites, dtype=np.int64)
    for site in range(sites):
        for k in range(6):
            columns[site, k] = k
        count = 6
        body = chain.site_body[site]
        while body > 1:
            for hinge in range(chain.hinge_count[body]):
                columns[site, count] = 6 + chain.first_hinge[body] + hinge
                count += 1
            body = chain.parent[body]
        counts[site] = count
    return columns, counts


@njit(cache=True)
@no_type_check
def _cost(chain, placed, q, points, turns, point_trust, turn_trust, errors):
    """Half the sum of squared errors; writes them, and where the pose puts things."""
    place(chain, q, placed)
    total = 0.0
    back, apart = np.empty(4), np.empty(4)
    for site in range(len(chain.site_body)):
        if np.isnan(points[site, 0]):
            errors[site, :3] = 0.0
        else:
            for k in range(3):
                errors[site, k] = points[site, k] - placed.site_position[site, k]
                total += 0.5 * (point_trust[site] * errors[site, k]) ** 2
        conjugate(placed.site_orientation[site], back)
        multiply(turns[site], back, apart)
        logarithm(apart, errors[site, 3:])
        for k in range(3, 6):
            total += 0.5 * (turn_trust[site] * errors[site, k]) ** 2
    return total


@njit(cache=True)
@no_type_check
def _normal(jacobian, errors, points, point_trust, turn_trust, columns, counts, A, g):
    """The normal equations; the rotation logarithm's own derivative is taken for one."""
    A[:] = 0.0
    g[:] = 0.0
    for site in range(len(errors)):
        rows = jacobian[site]
        w, v = point_trust[site] ** 2, turn_trust[site] ** 2
        if np.isnan(points[site, 0]):
            w = 0.0
        for a in range(counts[site]):
            i = columns[site, a]
            x0, x1, x2 = w * rows[0, i], w * rows[1, i], w * rows[2, i]
            x3, x4, x5 = v * rows[3, i], v * rows[4, i], v * rows[5, i]
            e = errors[site]
            g[i] += x0 * e[0] + x1 * e[1] + x2 * e[2] + x3 * e[3] + x4 * e[4] + x5 * e[5]
            for b in range(counts[site]):
                j = columns[site, b]
                if j <= i:
                    A[i, j] += (
                        x0 * rows[0, j] + x1 * rows[1, j] + x2 * rows[2, j]
                        + x3 * rows[3, j] + x4 * rows[4, j] + x5 * rows[5, j]
                    )  # fmt: skip


@njit(cache=True)
@no_type_check
def _step(A, g, damping, L, x):
    """Solve (A + damping (diag A + 1)) x = g by Cholesky; whether it could be done."""
    n = len(g)
    for i in range(n):
        for j in range(i + 1):
            s = A[i, j]
            if i == j:
                s += damping * (A[i, i] + 1.0)
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                if not s > 0.0:
                    return False
                L[i, i] = sqrt(s)
            else:
                L[i, j] = s / L[j, j]
    for i in range(n):
        s = g[i]
        for k in range(i):
            s -= L[i, k] * x[k]
        x[i] = s / L[i, i]
    for i in range(n - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, n):
            s -= L[k, i] * x[k]
        x[i] = s / L[i, i]
    return True
