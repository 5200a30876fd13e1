"""The solver: finds planted poses, never climbs, and says when it fails."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy import ndarray

from localreg.body.kinematics import integrate
from localreg.synthesis.energy import Term, energy
from localreg.synthesis.solver import LevenbergMarquardt, Solution, _residual
from tests.localreg.synthesis.planted import (
    bone_end_error,
    energy_terms,
    observe,
    standing_pose,
    turned_about_vertical,
)

energy_of = eqx.filter_jit(energy)


@eqx.filter_jit
def solve_within(terms: tuple[Term, ...], start: jax.Array, max_steps: int) -> Solution:
    return LevenbergMarquardt().solve(terms, start, max_steps)


def solve(terms: tuple[Term, ...], start: ndarray, max_steps: int = 40) -> Solution:
    return solve_within(terms, jnp.asarray(start), max_steps)


def perturbed(qpos: ndarray, seed: int, far: float) -> ndarray:
    """A pose some way off: about so many meters and radians in every coordinate."""
    step = far * np.random.default_rng(seed).normal(size=62)
    return np.asarray(integrate(jnp.asarray(qpos), jnp.asarray(step)))


@pytest.mark.parametrize("far", [0.01, 0.1, 0.3])
def test_a_planted_pose_is_found(far):
    """With a prior about the truth, from a start that is off."""
    for seed in range(6):
        truth = standing_pose(seed)
        terms = energy_terms(observe(truth), truth[7:], 0.1)
        found = solve(terms, perturbed(truth, seed + 50, far))
        assert found.ok
        assert float(found.energy) < 1e-3
        assert bone_end_error(found.qpos, truth) < 1e-3
        np.testing.assert_allclose(found.qpos[7:], truth[7:], atol=2e-3)
        assert np.linalg.norm(found.qpos[3:7]) == pytest.approx(1.0, abs=1e-12)


def test_a_prior_that_is_off_moves_only_what_trackers_leave_open():
    for seed in range(6):
        truth = standing_pose(seed)
        mean = truth[7:] + 0.05 * np.random.default_rng(seed).normal(size=56)
        found = solve(energy_terms(observe(truth), mean, 0.2), np.concatenate([truth[:7], mean]))
        assert found.ok
        away = np.abs(np.asarray(found.qpos[7:]) - truth[7:])
        assert bone_end_error(found.qpos, truth) < 0.02
        assert away.mean() < 0.05
        poses = observe(np.asarray(found.qpos))
        tracker_error = np.linalg.norm(poses.positions - observe(truth).positions, axis=1)
        assert tracker_error.max() < 0.003


@pytest.mark.parametrize("far", [0.0, 0.1, 1.0, 3.0])
@pytest.mark.parametrize("max_steps", [3, 40])
def test_the_energy_never_ends_above_the_starts(far, max_steps):
    for seed in range(10):
        truth = standing_pose(seed)
        terms = energy_terms(observe(truth), standing_pose(seed + 1)[7:], 0.1)
        start = perturbed(truth, seed + 50, far)
        found = solve(terms, start, max_steps)
        before = float(energy_of(terms, jnp.asarray(start)))
        assert float(found.energy) <= before
        assert float(energy_of(terms, found.qpos)) == pytest.approx(float(found.energy))
        assert int(found.steps) <= max_steps
        if not found.ok:
            np.testing.assert_array_equal(found.qpos, start)


def test_more_steps_come_nearer():
    truth = standing_pose(1)
    terms = energy_terms(observe(truth), truth[7:], 0.1)
    start = perturbed(truth, 51, 0.3)
    energies = [float(solve(terms, start, cap).energy) for cap in (3, 40)]
    assert energies[0] > 2.0 * energies[1]


@pytest.mark.parametrize("where", ["position", "quaternion", "prior", "start"])
@pytest.mark.parametrize("what", [np.nan, np.inf])
def test_what_is_not_finite_fails_and_leaves_the_start(where, what):
    truth = standing_pose(2)
    observation, mean, start = observe(truth), truth[7:].copy(), perturbed(truth, 52, 0.05).copy()
    if where == "position":
        observation = observation._replace(positions=observation.positions.at[2, 1].set(what))
    elif where == "quaternion":
        observation = observation._replace(quaternions=observation.quaternions.at[3, 0].set(what))
    elif where == "prior":
        mean[11] = what
    else:
        start[20] = what
    found = solve(energy_terms(observation, mean, 0.1), start)
    assert not found.ok
    np.testing.assert_array_equal(np.asarray(found.qpos), start)


def test_the_sign_of_a_quaternion_means_nothing():
    truth = standing_pose(3)
    observation = observe(truth)
    start = perturbed(truth, 53, 0.2)
    signs = jnp.array([1.0, -1.0, -1.0, 1.0, -1.0, 1.0])[:, None]
    flipped = observation._replace(quaternions=signs * observation.quaternions)
    one, other = (
        solve(energy_terms(o, truth[7:] + 0.1, 0.1), start) for o in (observation, flipped)
    )
    np.testing.assert_allclose(one.qpos, other.qpos, atol=1e-9)
    assert int(one.steps) == int(other.steps)


@pytest.mark.parametrize("beyond", [-0.1, -1e-9, 0.0, 1e-9, 0.1])
def test_a_body_turned_half_round_is_turned_back(beyond):
    """The rotation logarithm jumps there; the solver must leave the point all the same."""
    for seed in range(4):
        truth = standing_pose(seed)
        terms = energy_terms(observe(truth), truth[7:], 0.1)
        start = turned_about_vertical(truth, np.pi + beyond)
        found = solve(terms, start)
        assert found.ok
        assert float(found.energy) < 0.3 * float(energy_of(terms, jnp.asarray(start)))
        # Trackers so far off pull weakly, and the cap may come first: go on from there.
        found = solve(terms, np.asarray(found.qpos))
        assert bone_end_error(found.qpos, truth) < 0.01


@pytest.mark.parametrize("turn", [0.0, 1e-3, 1.0, 3.0])
def test_the_injected_derivative_is_the_residuals(turn):
    """By the increment from the start, also where the increment has turned the root far."""
    truth, start = standing_pose(4), perturbed(standing_pose(4), 54, 0.1)
    terms = energy_terms(observe(truth), truth[7:], 0.1)
    rng = np.random.default_rng(9)
    step = 0.1 * rng.normal(size=62)
    step[3:6] = turn * np.array([0.48, -0.6, 0.64])
    residual = eqx.filter_jit(_residual)
    tangent = eqx.filter_jit(
        lambda step, direction: jax.jvp(
            lambda s: _residual(terms, jnp.asarray(start), s), (step,), (direction,)
        )[1]
    )
    for seed in range(5):
        direction = np.random.default_rng(seed).normal(size=62)
        ahead, behind = (
            residual(terms, jnp.asarray(start), jnp.asarray(step + h * direction))
            for h in (1e-6, -1e-6)
        )
        ours = tangent(jnp.asarray(step), jnp.asarray(direction))
        expected = (np.asarray(ahead) - np.asarray(behind)) / 2e-6
        np.testing.assert_allclose(ours, expected, atol=1e-6 * np.abs(expected).max())
