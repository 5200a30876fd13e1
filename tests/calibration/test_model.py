"""The least-squares problem: derivatives against automatic ones, kinematics against MuJoCo."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from calibration import fit as fitting
from calibration.anthropometry import group_of_bone
from calibration.eigen_skeleton import average_subject
from calibration.fit import FitSettings, Session, default_mounts
from calibration.model import (
    Beliefs,
    CalibrationModel,
    Problem,
    dense,
    residual,
)
from calibration.poses import EIGHT_POSES
from calibration.solver import ScoreTest, information_of, linearize_at, posterior
from localreg.evaluation.body_points import BodyPoints
from tests.calibration.people import PRIOR, TRACKERS, somebody


@pytest.fixture(scope="module")
def problem():
    holds = somebody(1)[2]
    session = Session.of(TRACKERS, holds, EIGHT_POSES)
    average = average_subject(PRIOR)
    worn = replace(average, mounts=default_mounts(average, TRACKERS))
    settings = FitSettings()
    beliefs = Beliefs(
        jnp.asarray(PRIOR.mean),
        jnp.asarray(np.linalg.cholesky(PRIOR.covariance)),
        jnp.asarray(settings.mount_sigma),
        jnp.asarray(settings.pose_sigma),
        jnp.asarray(settings.plant_sigma),
    )
    start = fitting.first_guess(session, worn)
    return Problem(CalibrationModel.of(worn), fitting.stacked(session), beliefs, start)


@pytest.fixture(scope="module")
def unknowns(problem):
    size = problem.model.shared_size + 8 * problem.model.local_size
    return jnp.asarray(np.random.default_rng(3).normal(scale=0.7, size=size))


def test_the_jacobian_is_the_derivative(problem, unknowns):
    J = np.asarray(dense(linearize_at(problem, unknowns)))
    value = eqx.filter_jit(residual)
    rng = np.random.default_rng(4)
    shared = problem.model.shared_size
    for part in (
        slice(0, 18),
        slice(18, 36),
        slice(36, 54),
        slice(54, shared),
        slice(shared, None),
    ):
        direction = np.zeros(len(unknowns))
        direction[part] = rng.normal(size=len(direction[part]))
        step = 1e-5 * jnp.asarray(direction)
        exact = (value(problem, unknowns + step) - value(problem, unknowns - step)) / 2e-5
        scale = float(jnp.abs(exact).max())
        np.testing.assert_allclose(J @ direction, exact, atol=1e-6 * scale)


def test_predicted_trackers_are_those_of_mujoco(problem, unknowns):
    model, start = problem.model, problem.start
    shared = unknowns[: model.shared_size]
    outputs = model.outputs(shared, problem.beliefs, start)
    local = unknowns[model.shared_size :].reshape(8, -1)[2]
    sigma = problem.beliefs.pose_sigma
    qpos = model.pose(local, problem.holds.targets[2], start.roots[2], sigma)
    person = average_subject(PRIOR)
    groups = np.asarray(outputs.lengths)[group_of_bone()]
    mounts = tuple(
        replace(m, position=tuple(p.tolist()), quaternion=tuple(q.tolist()))
        for m, p, q in zip(
            TRACKERS, np.asarray(outputs.positions), np.asarray(outputs.quaternions), strict=True
        )
    )
    person = replace(person, lengths=groups, mounts=mounts)
    truth = BodyPoints(person).tracker_poses(np.asarray(qpos)[None])
    ours = model.body(outputs).tracker_poses(qpos)
    np.testing.assert_allclose(ours.positions, truth.positions[0], atol=1e-9)
    same = np.abs(np.sum(np.asarray(ours.quaternions) * truth.quaternions[0], axis=1))
    np.testing.assert_allclose(same, 1.0, atol=1e-9)


def test_the_posterior_is_the_inverse_of_the_whole_hessian(problem, unknowns):
    linear = linearize_at(problem, unknowns)
    J = np.asarray(dense(linear))
    whole = np.linalg.inv(J.T @ J)
    after = posterior(linear)
    s, l = problem.model.shared_size, problem.model.local_size  # noqa: E741
    scale = np.sqrt(np.diag(whole))
    np.testing.assert_allclose(
        after.shared / np.outer(scale[:s], scale[:s]),
        whole[:s, :s] / np.outer(scale[:s], scale[:s]),
        atol=1e-5,
    )
    own = slice(s + 3 * l, s + 4 * l)
    np.testing.assert_allclose(np.diag(after.local[3]), np.diag(whole)[own], rtol=1e-5)
    cross = whole[own, :s] / np.outer(scale[own], scale[:s])
    np.testing.assert_allclose(after.cross[3] / np.outer(scale[own], scale[:s]), cross, atol=1e-5)
    covariance = np.linalg.inv(information_of(linear))
    np.testing.assert_allclose(np.diag(covariance), np.diag(whole)[:s], rtol=1e-4)


def test_a_score_test_is_exact_where_the_problem_is_linear(problem, unknowns):
    linear = linearize_at(problem, unknowns)
    J = np.asarray(dense(linear))
    r = np.concatenate([linear.shared_residual, np.asarray(linear.residuals).ravel()])
    columns = np.random.default_rng(0).normal(size=(*linear.residuals.shape, 2))
    C = np.concatenate([np.zeros((len(linear.shared_residual), 2)), columns.reshape(-1, 2)])

    def least(matrix):
        x, *_ = np.linalg.lstsq(matrix, -r, rcond=None)
        left = r + matrix @ x
        return 0.5 * left @ left, x

    (before, _), (after, x) = least(J), least(np.hstack([J, C]))
    # The residual of the linear problem itself, as at the end of a fit.
    _, step = least(J)
    r_end = r + J @ step
    s, N = len(linear.shared_residual), len(linear.residuals)
    ended = linear._replace(
        shared_residual=jnp.asarray(r_end[:s]),
        residuals=jnp.asarray(r_end[s:].reshape(N, -1)),
    )
    gain, values = ScoreTest(ended).gain(columns)
    assert gain == pytest.approx(before - after, rel=1e-5)
    np.testing.assert_allclose(values, x[-2:], rtol=1e-4)
