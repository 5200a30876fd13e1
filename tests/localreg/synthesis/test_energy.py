"""Every term's derivative by finite differences, and what the terms are worth."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.kinematics import Kinematics, integrate
from localreg.evaluation.body_points import BodyPoints
from localreg.synthesis.energy import (
    Gaussian,
    LimitTerm,
    Linearized,
    PriorTerm,
    RootTerm,
    StepTerm,
    Term,
    TrackerTerm,
    energy,
    linearize,
    robust_scale,
    robustify,
)
from localreg.synthesis.observation import Observation
from tests.localreg.body.random_body import random_poses, random_subject

TRACKERS = 7
SUBJECT = random_subject(1, trackers=TRACKERS)
BODY, KINEMATICS = BodyPoints(SUBJECT), Kinematics.from_subject(SUBJECT)
errors = eqx.filter_jit(TrackerTerm.errors)


@eqx.filter_jit
def linearized(term: Term, qpos: jax.Array) -> Linearized:
    return term.linearize(qpos)


@eqx.filter_jit
def differentiated(term: Term, qpos: jax.Array) -> jax.Array:
    """Central differences of the residual by the 62 tangent coordinates."""
    steps = 1e-6 * jnp.eye(62)

    def residual(step: jax.Array) -> jax.Array:
        return term.linearize(integrate(qpos, step)).residual

    # One at a time: a batch would have to be compiled by itself.
    ahead, behind = jax.lax.map(residual, steps), jax.lax.map(residual, -steps)
    return ((ahead - behind) / 2e-6).T


def assert_derivative(term: Term, qpos: ndarray) -> None:
    ours = np.asarray(linearized(term, jnp.asarray(qpos)).jacobian)
    theirs = np.asarray(differentiated(term, jnp.asarray(qpos)))
    np.testing.assert_allclose(ours, theirs, atol=1e-6 * max(1.0, np.abs(theirs).max()))


def observe(qpos: ndarray, off: float, seed: int = 0, off_turn: float | None = None) -> Observation:
    """What trackers say in a pose, each off by about so many meters and radians."""
    rng = np.random.default_rng(seed)
    truth = BODY.tracker_poses(np.asarray(qpos)[None])
    turn = (off if off_turn is None else off_turn) * rng.normal(size=(TRACKERS, 3))
    turned = Rotation.from_rotvec(turn) * Rotation.from_quat(
        truth.quaternions[0], scalar_first=True
    )
    return Observation(
        jnp.asarray(truth.positions[0] + off * rng.normal(size=(TRACKERS, 3))),
        jnp.asarray(turned.as_quat(scalar_first=True)),
        jnp.ones(TRACKERS, dtype=bool),
        jnp.ones(TRACKERS, dtype=bool),
    )


def tracker_term(observation: Observation, c: float = 1.0) -> TrackerTerm:
    return TrackerTerm(
        KINEMATICS,
        observation,
        jnp.asarray(0.005),
        jnp.asarray(np.radians(1.0)),
        jnp.full((TRACKERS, 2), float(c)),
    )


def random_whitening(seed: int, size: int) -> jax.Array:
    root = np.random.default_rng(seed).normal(size=(size, size)) + 3.0 * np.eye(size)
    return Gaussian.from_covariance(jnp.zeros(size), jnp.asarray(root @ root.T)).whitening


POSES = random_poses(5, 4)


@pytest.mark.parametrize("c", [1.0, 9.0, np.inf])
@pytest.mark.parametrize("off", [1e-5, 0.003, 0.3])
def test_the_derivative_of_the_tracker_term(off, c):
    for seed, qpos in enumerate(POSES[:2]):
        assert_derivative(tracker_term(observe(qpos, off, seed), c), qpos)


def test_the_derivative_of_the_tracker_term_with_masks():
    observation = observe(POSES[0], 0.05)._replace(
        position_mask=jnp.arange(TRACKERS) % 2 == 0, orientation_mask=jnp.arange(TRACKERS) % 3 == 0
    )
    assert_derivative(tracker_term(observation), POSES[0])


def test_the_derivative_of_the_prior_term():
    gaussian = Gaussian(jnp.asarray(POSES[1, 7:]), random_whitening(1, 56))
    assert_derivative(PriorTerm(gaussian), POSES[0])


@pytest.mark.parametrize("turn", [0.0, 1e-7, 1e-3, 1.0, 3.0, np.pi - 1e-3])
@pytest.mark.parametrize("kind", ["step", "root"])
def test_the_derivative_of_terms_on_the_root(kind, turn):
    """At any turn from the expected root up to half a turn, where it jumps."""
    expected, axis = jnp.asarray(POSES[2]), np.array([0.48, -0.6, 0.64])
    step = np.concatenate([[0.1, -0.2, 0.3], turn * axis, 0.1 * np.ones(56)])
    qpos = np.asarray(integrate(expected, jnp.asarray(step)))
    terms: dict[str, Term] = {
        "step": StepTerm(expected, Gaussian(jnp.asarray(0.1 * step), random_whitening(2, 62))),
        "root": RootTerm(expected, jnp.asarray(0.1), jnp.asarray(0.3)),
    }
    assert_derivative(terms[kind], qpos)


def test_the_derivative_of_the_limit_term():
    low, high = jnp.full(56, -0.3), jnp.linspace(-0.2, 1.0, 56)
    term = LimitTerm(low, high, jnp.asarray(0.05))
    for qpos in POSES:
        assert_derivative(term, qpos)
    angles = POSES[0, 7:]
    residual = linearized(term, jnp.asarray(POSES[0])).residual
    outside = np.maximum(angles - high, 0.0) + np.minimum(angles - low, 0.0)
    far = np.abs(outside) / 0.05
    assert np.any((far > 0.0) & (far < 1.0))
    assert np.any(far > 2.0)
    huber = np.where(far < 1.0, far**2, 2.0 * far - 1.0)
    np.testing.assert_allclose(np.square(residual), huber, atol=1e-12)
    np.testing.assert_array_equal(np.sign(residual), np.sign(outside))
    inside = np.concatenate([POSES[0, :7], np.full(56, -0.25)])
    assert not np.any(linearized(term, jnp.asarray(inside)).residual)
    assert not np.any(linearized(term, jnp.asarray(inside)).jacobian)


def test_a_gaussian_is_worth_its_mahalanobis_distance():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(56, 56)) + 3.0 * np.eye(56)
    mean, covariance = rng.normal(size=56), root @ root.T
    whole = PriorTerm(Gaussian.from_covariance(jnp.asarray(mean), jnp.asarray(covariance)))
    away = POSES[0, 7:] - mean
    expected = 0.5 * away @ np.linalg.solve(covariance, away)
    assert energy((whole,), jnp.asarray(POSES[0])) == pytest.approx(expected, rel=1e-9)
    sigma = rng.uniform(0.1, 1.0, 56)
    single = PriorTerm(Gaussian.from_deviations(jnp.asarray(mean), jnp.asarray(sigma)))
    expected = 0.5 * np.sum((away / sigma) ** 2)
    assert energy((single,), jnp.asarray(POSES[0])) == pytest.approx(expected, rel=1e-9)


def test_terms_are_stacked():
    gaussian = Gaussian(jnp.asarray(POSES[1, 7:]), random_whitening(1, 56))
    terms = (PriorTerm(gaussian), RootTerm(jnp.asarray(POSES[2]), jnp.ones(()), jnp.ones(())))
    stacked = linearize(terms, jnp.asarray(POSES[0]))
    parts = [term.linearize(jnp.asarray(POSES[0])) for term in terms]
    np.testing.assert_array_equal(stacked.residual, np.concatenate([p.residual for p in parts]))
    np.testing.assert_array_equal(stacked.jacobian, np.concatenate([p.jacobian for p in parts]))


@pytest.mark.parametrize("kind", ["positions", "quaternions"])
def test_masked_trackers_contribute_nothing_whatever_they_say(kind):
    rng = np.random.default_rng(4)
    clean = observe(POSES[0], 0.01)
    if kind == "positions":
        clean = clean._replace(position_mask=jnp.arange(TRACKERS) != 2)
        garbage = clean._replace(positions=clean.positions.at[2].set([1e9, -3.0, 1e-9]))
        rows = slice(6, 9)
    else:
        clean = clean._replace(orientation_mask=jnp.arange(TRACKERS) != 2)
        garbage = clean._replace(quaternions=clean.quaternions.at[2].set(100 * rng.normal(size=4)))
        rows = slice(3 * TRACKERS + 6, 3 * TRACKERS + 9)
    qpos = jnp.asarray(POSES[0])
    expected, got = (linearized(tracker_term(o), qpos) for o in (clean, garbage))
    np.testing.assert_array_equal(got.residual, expected.residual)
    np.testing.assert_array_equal(got.jacobian, expected.jacobian)
    assert not np.any(got.residual[rows])
    assert not np.any(got.jacobian[rows])
    assert np.any(np.asarray(got.residual))


@given(st.floats(0.0, 1e12))
@settings(max_examples=200, deadline=None)
def test_the_robust_scale_makes_squares_the_lorentzian(t):
    scale, _ = robust_scale(jnp.asarray(t))
    assert float(scale) ** 2 * t == pytest.approx(np.log1p(t), rel=1e-12, abs=1e-300)


@given(st.lists(st.floats(-50.0, 50.0), min_size=3, max_size=3), st.floats(0.1, 100.0))
@settings(max_examples=50, deadline=None)
def test_a_robust_residual_is_worth_the_lorentzian(error, c):
    e = jnp.asarray([error])
    f, _ = robustify(e, jnp.zeros((1, 3, 62)), jnp.full(1, c))
    expected = c * np.log1p(np.dot(error, error) / (2.0 * c))
    assert 0.5 * float(jnp.sum(f * f)) == pytest.approx(expected, rel=1e-10, abs=1e-300)


def test_the_robust_scale_is_smooth_where_its_series_ends():
    """Value, slope and curvature do not jump at 1e-3, and the slope is the value's."""
    around = 1e-3 * (1.0 + np.array([-2e-9, -1e-9, 1e-9, 2e-9]))
    value, slope = (np.asarray(part) for part in robust_scale(jnp.asarray(around)))
    assert abs(value[2] - value[1]) < 1e-12
    assert abs(slope[2] - slope[1]) < 1e-9
    t = jnp.asarray(np.concatenate([np.linspace(2e-4, 2.9e-3, 55), np.logspace(-2, 6, 33)]))
    ahead, behind = robust_scale(t * (1 + 1e-5))[0], robust_scale(t * (1 - 1e-5))[0]
    _, slope = robust_scale(t)
    np.testing.assert_allclose((ahead - behind) / (2e-5 * t), slope, rtol=1e-4)
    curvature = jax.vmap(jax.grad(lambda t: robust_scale(t)[1]))(t[:55])
    assert np.all(np.diff(curvature) < 0.0)
    assert np.max(np.abs(np.diff(curvature))) < 2e-4


@pytest.mark.parametrize("transform", ["plain", "jit", "vmap"])
def test_nothing_is_nan_at_exactly_no_error(transform):
    def value_and_derivatives(t: jax.Array) -> tuple[jax.Array, ...]:
        value, slope = robust_scale(t)
        first = jax.grad(lambda t: robust_scale(t)[0])(t)
        second = jax.grad(lambda t: robust_scale(t)[1])(t)
        return value, slope, first, second

    zero = jnp.zeros(())
    if transform == "jit":
        value_and_derivatives = jax.jit(value_and_derivatives)
    elif transform == "vmap":
        value_and_derivatives, zero = jax.vmap(value_and_derivatives), jnp.zeros(3)
    value, slope, first, second = (np.asarray(part) for part in value_and_derivatives(zero))
    assert np.all(value == 1.0)
    assert np.all(slope == -0.25)
    assert np.all(first == -0.25)
    np.testing.assert_allclose(second, 13.0 / 48.0)


@pytest.mark.parametrize("batched", [False, True])
def test_the_tracker_term_is_clean_at_exactly_no_error(batched):
    qpos = jnp.asarray(POSES[0])
    term = tracker_term(observe(POSES[0], 0.0))
    if batched:
        both = eqx.filter_jit(eqx.filter_vmap(TrackerTerm.linearize, in_axes=(None, 0)))
        found = jax.tree.map(lambda leaf: leaf[1], both(term, jnp.stack([qpos, qpos])))
    else:
        found = linearized(term, qpos)
    np.testing.assert_allclose(found.residual, 0.0, atol=1e-10)
    assert np.all(np.isfinite(found.jacobian))
    assert_derivative(term, POSES[0])


@pytest.mark.parametrize("beyond", [-1e-3, -1e-9, 0.0, 1e-9, 1e-3])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_half_a_turn_off_value_and_derivative_are_finite_and_true(beyond, sign):
    """The sign of the measured quaternion makes no difference but at exactly half a turn."""
    qpos = POSES[0]
    truth = BODY.tracker_poses(qpos[None]).quaternions[0]
    turn = Rotation.from_rotvec((np.pi + beyond) * np.array([0.0, 0.6, 0.8]))
    measured = turn * Rotation.from_quat(truth, scalar_first=True)
    observation = observe(qpos, 0.0)._replace(
        quaternions=jnp.asarray(sign * measured.as_quat(scalar_first=True))
    )
    term = tracker_term(observation)
    _, turns = errors(term, jnp.asarray(qpos))
    lengths = np.linalg.norm(turns, axis=1)
    np.testing.assert_allclose(lengths, np.pi - abs(beyond), atol=1e-9)
    found = linearized(term, jnp.asarray(qpos))
    assert np.all(np.isfinite(found.residual))
    assert np.all(np.isfinite(found.jacobian))
    assert np.any(np.asarray(found.jacobian)[3 * TRACKERS :, 3:6] != 0.0)
    if abs(beyond) > 1e-6:
        assert_derivative(term, qpos)
