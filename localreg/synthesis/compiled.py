"""Levenberg-Marquardt over one pose as machine code: the default solver, live and offline.

It minimizes the energy of `localreg.synthesis.energy`, whose optimistix solver it is tested
to agree with. What makes it fast: the prior is one quadratic form, so only the trackers are
linearized in every step; the Lorentzian enters by iteratively reweighted least squares,
weights 1 / (1 + t) with the true energy deciding what is accepted, which takes fewer steps
than the square-root residual; a tracker's columns are mostly zero and are skipped.
"""

from math import log1p
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray

from localreg.body.chain import (
    blank_placed,
    conjugate,
    difference,
    integrate,
    inverse_left_jacobian,
    logarithm,
    multiply,
    place,
    tracker_jacobian,
)
from localreg.synthesis.linear_algebra import factorize, substitute

_TANGENT = 62
_WEAKEST_DAMPING = 1e-3
_STRONGEST_DAMPING = 1e6


class Control(NamedTuple):
    """How trackers count.

    Attributes:
        sigma_position: what a tracker's position is believed to be off by [m].
        sigma_orientation: the same for orientation [rad].
        lorentzian: c of the Lorentzian for position and orientation of each tracker.
    """

    sigma_position: float
    sigma_orientation: float
    lorentzian: Float[ndarray, "J 2"]


@njit(cache=True)
@no_type_check
def tracker_errors(placed, observation, position, orientation):
    """Write position errors [m] and orientation errors as world rotation vectors [rad]."""
    back, turn = np.empty(4), np.empty(4)
    for j in range(len(position)):
        for i in range(3):
            position[j, i] = placed.site_position[j, i] - observation.positions[j, i]
        conjugate(observation.quaternions[j], back)
        multiply(placed.site_orientation[j], back, turn)
        logarithm(turn, orientation[j])


@njit(cache=True, inline="always")
@no_type_check
def _squared(v):
    return v[0] * v[0] + v[1] * v[1] + v[2] * v[2]


@njit(cache=True, inline="always")
@no_type_check
def _lorentzian(squared, c):
    """The Lorentzian of a whitened squared error; plain squares for infinite c."""
    return c * log1p(squared / (2.0 * c)) if c < np.inf else 0.5 * squared


@njit(cache=True)
@no_type_check
def tracker_energy(position, orientation, observation, control):
    """The Lorentzian control energy of tracker errors."""
    place_sigma, turn_sigma, c = control
    total = 0.0
    for j in range(len(position)):
        if observation.position_mask[j]:
            total += _lorentzian(_squared(position[j]) / place_sigma**2, c[j, 0])
        if observation.orientation_mask[j]:
            total += _lorentzian(_squared(orientation[j]) / turn_sigma**2, c[j, 1])
    return total


@njit(cache=True)
@no_type_check
def _prior_energy(belief, qpos, deviation, pull):
    """Energy of the prior; writes the deviation from it and its gradient."""
    difference(belief.qpos, qpos, deviation)
    total = 0.0
    offset = deviation - belief.mean
    np.dot(belief.information, offset, pull)
    for i in range(_TANGENT):
        total += offset[i] * pull[i]
    limits = belief.limits
    for i in range(_TANGENT - 6):
        angle = qpos[7 + i]
        excess = max(angle - limits.high[i], 0.0) + min(angle - limits.low[i], 0.0)
        far = abs(excess) / limits.sigma
        total += far * far if far < 1.0 else 2.0 * far - 1.0
    return 0.5 * total


@njit(cache=True)
@no_type_check
def _normal_equations(jacobian, errors, observation, control, belief, qpos, deviation, pull, H, g):
    """Write Gauss-Newton Hessian (lower triangle) and gradient of the whole energy."""
    position, orientation = errors
    place_sigma, turn_sigma, c = control
    bend = np.empty((3, 3))
    # The root's deviation is a rotation vector: d(log(a exp(d))) = J_l(log a)^-T d.
    inverse_left_jacobian(deviation[3:6], bend)
    H[:] = belief.information
    g[:] = pull
    for i in range(_TANGENT):
        x, y, z = H[i, 3], H[i, 4], H[i, 5]
        for k in range(3):
            H[i, 3 + k] = x * bend[k, 0] + y * bend[k, 1] + z * bend[k, 2]
    for i in range(_TANGENT):
        x, y, z = H[3, i], H[4, i], H[5, i]
        for k in range(3):
            H[3 + k, i] = x * bend[k, 0] + y * bend[k, 1] + z * bend[k, 2]
    x, y, z = pull[3], pull[4], pull[5]
    for k in range(3):
        g[3 + k] = x * bend[k, 0] + y * bend[k, 1] + z * bend[k, 2]
    limits = belief.limits
    stiffness = 1.0 / limits.sigma**2
    for i in range(_TANGENT - 6):
        angle = qpos[7 + i]
        excess = max(angle - limits.high[i], 0.0) + min(angle - limits.low[i], 0.0)
        if excess != 0.0:
            weight = stiffness / max(1.0, abs(excess) / limits.sigma)
            g[6 + i] += weight * excess
            H[6 + i, 6 + i] += weight
    columns = np.empty(_TANGENT, np.int64)
    for j in range(len(position)):
        rows = jacobian[j]
        count = 0
        for k in range(_TANGENT):
            if k < 6 or rows[3, k] != 0.0 or rows[4, k] != 0.0 or rows[5, k] != 0.0:
                columns[count] = k
                count += 1
        seen, facing = observation.position_mask[j], observation.orientation_mask[j]
        place_weight = _weight(position[j], place_sigma, c[j, 0]) if seen else 0.0
        turn_weight = 0.0
        if facing:
            turn_weight = _weight(orientation[j], turn_sigma, c[j, 1])
            inverse_left_jacobian(orientation[j], bend)
            for n in range(count):
                k = columns[n]
                x, y, z = rows[3, k], rows[4, k], rows[5, k]
                for i in range(3):
                    rows[3 + i, k] = bend[i, 0] * x + bend[i, 1] * y + bend[i, 2] * z
        if seen or facing:
            _add_rows(
                rows, position[j], orientation[j], place_weight, turn_weight,
                columns[:count], H, g,
            )  # fmt: skip


@njit(cache=True, inline="always")
@no_type_check
def _weight(error, sigma, c):
    """What a squared error counts by the Lorentzian's reweighting."""
    t = _squared(error) / (2.0 * c * sigma**2)
    return 1.0 / (sigma**2 * (1.0 + t))


@njit(cache=True)
@no_type_check
def _add_rows(rows, position, orientation, place_weight, turn_weight, columns, H, g):
    """Add one tracker's six rows; errors of no weight are not measured."""
    for n in range(len(columns)):
        a = columns[n]
        x, y, z = place_weight * rows[0, a], place_weight * rows[1, a], place_weight * rows[2, a]
        u, v, w = turn_weight * rows[3, a], turn_weight * rows[4, a], turn_weight * rows[5, a]
        g[a] += x * position[0] + y * position[1] + z * position[2]
        g[a] += u * orientation[0] + v * orientation[1] + w * orientation[2]
        for m in range(n + 1):
            b = columns[m]
            H[a, b] += (
                x * rows[0, b] + y * rows[1, b] + z * rows[2, b]
                + u * rows[3, b] + v * rows[4, b] + w * rows[5, b]
            )  # fmt: skip


@njit(cache=True)
@no_type_check
def energy_at(chain, observation, control, belief, qpos, placed, errors, deviation, pull):
    """The energy of a pose; writes all that a linearization needs."""
    place(chain, qpos, placed)
    tracker_errors(placed, observation, errors[0], errors[1])
    return tracker_energy(errors[0], errors[1], observation, control) + _prior_energy(
        belief, qpos, deviation, pull
    )


@njit(cache=True)
@no_type_check
def minimize(
    chain, observation, control, belief, max_steps, tolerance, qpos, H, errors, orientations
):
    """Minimize the energy from a start.

    Args:
        chain: the body.
        observation: what the trackers say.
        control: how they count.
        belief: the prior.
        max_steps: cap of attempted steps.
        tolerance: expected decrease of the energy that is not worth a step.
        qpos: pose to start from; written: the result.
        H: written: the Hessian there (whole matrix).
        errors: written: position and orientation errors there.
        orientations: written: where the trackers face there.

    Returns:
        The energy, and the attempted steps.
    """
    placed, trial = blank_placed(chain), np.empty_like(qpos)
    deviation, pull = np.empty(_TANGENT), np.empty(_TANGENT)
    g, step, L = np.empty(_TANGENT), np.empty(_TANGENT), np.zeros((_TANGENT, _TANGENT))
    jacobian = np.empty((len(chain.site_body), 6, _TANGENT))
    energy = energy_at(chain, observation, control, belief, qpos, placed, errors, deviation, pull)
    tracker_jacobian(chain, placed, jacobian)
    _normal_equations(jacobian, errors, observation, control, belief, qpos, deviation, pull, H, g)
    damping, steps, last, converged = 0.0, 0, 0.0, False
    while not converged and steps < max_steps and damping < _STRONGEST_DAMPING:
        steps += 1
        if not factorize(H, damping, L):
            damping = max(10.0 * damping, _WEAKEST_DAMPING)
            continue
        substitute(L, -g, step)
        # Also false where something is not finite.
        if not -0.5 * np.dot(g, step) > tolerance:
            break
        integrate(qpos, step, trial)
        lower = energy_at(
            chain, observation, control, belief, trial, placed, errors, deviation, pull
        )
        if not lower < energy:
            energy_at(chain, observation, control, belief, qpos, placed, errors, deviation, pull)
            damping = max(10.0 * damping, _WEAKEST_DAMPING)
            continue
        # The next decrease would be about the same share of this one as this is of the last.
        decrease = energy - lower
        converged = damping == 0.0 and decrease * decrease < tolerance * last
        qpos[:], energy, last = trial, lower, decrease
        damping = 0.1 * damping if damping > _WEAKEST_DAMPING else 0.0
        tracker_jacobian(chain, placed, jacobian)
        _normal_equations(
            jacobian, errors, observation, control, belief, qpos, deviation, pull, H, g
        )
    for a in range(_TANGENT):
        for b in range(a):
            H[b, a] = H[a, b]
    orientations[:] = placed.site_orientation
    return energy, steps
