"""Both solvers: they find planted poses, never climb, and say when they fail."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy import ndarray

from localreg.body.kinematics import integrate
from localreg.synthesis.belief import Belief
from localreg.synthesis.energy import energy
from localreg.synthesis.reference_solver import _residual
from localreg.synthesis.solver import Problem, Solution, Solver
from tests.localreg.synthesis.exact_solvers import CAP, COMPILED, REFERENCE
from tests.localreg.synthesis.planted import (
    belief_about,
    bone_end_error,
    observe,
    planted,
    standing_pose,
    terms_of,
    turned_about_vertical,
)

energy_of = eqx.filter_jit(energy)
moved = jax.jit(integrate)


@pytest.fixture(params=[COMPILED, REFERENCE], ids=["compiled", "optimistix"])
def solver(request: pytest.FixtureRequest) -> Solver:
    return request.param


def energy_at(problem: Problem, qpos: ndarray) -> float:
    """As the energy terms have it, whichever the solver."""
    return float(energy_of(terms_of(problem), jnp.asarray(qpos)))


def solve(solver: Solver, problem: Problem, start: ndarray, max_steps: int = CAP) -> Solution:
    given = start.copy()
    found = solver.solve(problem, start, max_steps)
    np.testing.assert_array_equal(start, given)
    return found


def perturbed(qpos: ndarray, seed: int, far: float) -> ndarray:
    """A pose some way off: about so many meters and radians in every coordinate."""
    return np.array(moved(qpos, far * np.random.default_rng(seed).normal(size=62)))


@pytest.mark.parametrize("far", [0.01, 0.1, 0.3])
def test_a_planted_pose_is_found(solver, far):
    """With a prior about the truth, from a start that is off."""
    for seed in range(6):
        truth = standing_pose(seed)
        problem = planted(observe(truth), belief_about(truth[7:], 0.1))
        found = solve(solver, problem, perturbed(truth, seed + 50, far))
        assert found.ok
        assert found.energy < 1e-3
        assert bone_end_error(found.qpos, truth) < 1e-3
        np.testing.assert_allclose(found.qpos[7:], truth[7:], atol=2e-3)
        assert np.linalg.norm(found.qpos[3:7]) == pytest.approx(1.0, abs=1e-12)
        np.testing.assert_allclose(found.position_errors, 0.0, atol=2e-3)
        np.testing.assert_allclose(found.orientation_errors, 0.0, atol=5e-3)


def test_a_prior_that_is_off_moves_only_what_trackers_leave_open(solver):
    for seed in range(6):
        truth = standing_pose(seed)
        mean = truth[7:] + 0.05 * np.random.default_rng(seed).normal(size=56)
        problem = planted(observe(truth), belief_about(mean, 0.2))
        found = solve(solver, problem, np.concatenate([truth[:7], mean]))
        assert found.ok
        away = np.abs(found.qpos[7:] - truth[7:])
        assert bone_end_error(found.qpos, truth) < 0.02
        assert away.mean() < 0.05
        assert np.linalg.norm(found.position_errors, axis=1).max() < 0.003


@pytest.mark.parametrize("far", [0.0, 0.1, 1.0, 3.0])
@pytest.mark.parametrize(
    ("solver", "max_steps"),
    [(COMPILED, 3), (COMPILED, CAP), (REFERENCE, CAP)],
    ids=["compiled, three steps", "compiled", "optimistix"],
)
def test_the_energy_never_ends_above_the_starts(solver, far, max_steps):
    for seed in range(10):
        truth = standing_pose(seed)
        problem = planted(observe(truth), belief_about(standing_pose(seed + 1)[7:], 0.1))
        start = perturbed(truth, seed + 50, far)
        found = solve(solver, problem, start, max_steps)
        assert found.energy <= energy_at(problem, start) * (1.0 + 1e-12)
        assert energy_at(problem, found.qpos) == pytest.approx(found.energy, rel=1e-9, abs=1e-12)
        assert found.steps <= max_steps
        assert found.ok


def test_no_steps_leave_the_start():
    truth = standing_pose(7)
    problem = planted(observe(truth), belief_about(truth[7:], 0.1))
    start = perturbed(truth, 57, 0.1)
    found = solve(COMPILED, problem, start, 0)
    np.testing.assert_array_equal(found.qpos, start)
    assert found.energy == pytest.approx(energy_at(problem, start))


def test_more_steps_come_nearer():
    truth = standing_pose(1)
    problem = planted(observe(truth), belief_about(truth[7:], 0.1))
    start = perturbed(truth, 51, 0.3)
    energies = [solve(COMPILED, problem, start, cap).energy for cap in (3, 40)]
    assert energies[0] > 2.0 * energies[1]


@pytest.mark.parametrize("where", ["position", "quaternion", "prior", "information", "start"])
@pytest.mark.parametrize("what", [np.nan, np.inf])
def test_what_is_not_finite_fails_and_leaves_the_start(solver, where, what):
    truth = standing_pose(2)
    observation, belief = observe(truth), belief_about(truth[7:], 0.1)
    start = perturbed(truth, 52, 0.05)
    broken = {
        "position": observation.positions[2],
        "quaternion": observation.quaternions[3],
        "prior": belief.qpos[18:],
        "information": belief.information[30],
        "start": start[20:],
    }[where]
    broken[1] = what
    found = solve(solver, planted(observation, belief), start)
    assert not found.ok
    np.testing.assert_array_equal(found.qpos, start)


@pytest.mark.parametrize("away", [10.0, 1e9, 1e150])
def test_a_tracker_out_of_this_world_is_an_outlier(away):
    truth = standing_pose(2)
    observation = observe(truth)
    observation.positions[2, 1] += away
    problem = planted(observation, belief_about(truth[7:], 0.1))
    found = solve(COMPILED, problem, perturbed(truth, 52, 0.05))
    assert found.ok
    assert bone_end_error(found.qpos, truth) < 0.03


def test_the_sign_of_a_quaternion_means_nothing(solver):
    truth = standing_pose(3)
    observation = observe(truth)
    start = perturbed(truth, 53, 0.2)
    signs = np.array([1.0, -1.0, -1.0, 1.0, -1.0, 1.0])[:, None]
    flipped = observation._replace(quaternions=signs * observation.quaternions)
    one, other = (
        solve(solver, planted(o, belief_about(truth[7:] + 0.1, 0.1)), start)
        for o in (observation, flipped)
    )
    np.testing.assert_allclose(one.qpos, other.qpos, atol=1e-9)
    assert one.steps == other.steps


def test_masked_trackers_count_for_nothing_whatever_they_say(solver):
    truth = standing_pose(5)
    seen = np.arange(6) != 2
    observation = observe(truth, seen, np.roll(seen, 2))
    garbage = observation._replace(
        positions=np.where(seen[:, None], observation.positions, 1e9),
        quaternions=np.where(np.roll(seen, 2)[:, None], observation.quaternions, [0.6, 0, 0.8, 0]),
    )
    start = perturbed(truth, 55, 0.2)
    one, other = (
        solve(solver, planted(o, belief_about(truth[7:] + 0.1, 0.1)), start)
        for o in (observation, garbage)
    )
    np.testing.assert_array_equal(one.qpos, other.qpos)
    np.testing.assert_array_equal(one.hessian, other.hessian)


@pytest.mark.parametrize("beyond", [-0.1, -1e-9, 0.0, 1e-9, 0.1])
def test_a_body_turned_half_round_is_turned_back(solver, beyond):
    """The rotation logarithm jumps there; the solver must leave the point all the same."""
    for seed in range(4):
        truth = standing_pose(seed)
        problem = planted(observe(truth), belief_about(truth[7:], 0.1))
        start = turned_about_vertical(truth, np.pi + beyond)
        found = solve(solver, problem, start)
        assert found.ok
        assert found.energy < 0.3 * energy_at(problem, start)
        # Trackers so far off pull weakly, and the cap may come first: go on from there.
        found = solve(solver, problem, found.qpos)
        assert bone_end_error(found.qpos, truth) < 0.01


@pytest.mark.parametrize("beyond", [-1e-3, -1e-9, 0.0, 1e-9, 1e-3])
def test_a_start_half_a_turn_from_what_the_prior_expects_is_left(solver, beyond):
    """The root's deviation jumps there, too; trackers are right and strong."""
    truth = standing_pose(6)
    information = 25.0 * np.eye(62)
    belief = Belief(truth, np.zeros(62), information)
    start = turned_about_vertical(truth, np.pi + beyond)
    problem = planted(observe(truth), belief)
    found = solve(solver, problem, start)
    assert found.ok
    found = solve(solver, problem, found.qpos)
    assert bone_end_error(found.qpos, truth) < 0.01


@pytest.mark.parametrize("turn", [0.0, 1e-3, 1.0, 3.0])
def test_the_injected_derivative_is_the_residuals(turn):
    """By the increment from the start, also where the increment has turned the root far."""
    truth, start = standing_pose(4), perturbed(standing_pose(4), 54, 0.1)
    terms = terms_of(planted(observe(truth), belief_about(truth[7:], 0.1)))
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
