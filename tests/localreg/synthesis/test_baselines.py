"""LPCA and LPCR against plain implementations of what was published, and on a real walk."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy import ndarray

from localreg.synthesis.baselines import principal_component_regression, principal_subspace
from localreg.synthesis.synthesizer import Synthesizer
from tests.localreg.synthesis.sessions import Session, follow

subspace_of = partial(jax.jit, static_argnums=1)(principal_subspace)
regress = partial(jax.jit, static_argnums=3)(principal_component_regression)


def spread(rng: np.random.Generator, rows: int, columns: int) -> ndarray:
    """Rows about some mean, of falling variance along random directions."""
    turn = np.linalg.qr(rng.normal(size=(columns, columns)))[0]
    center = rng.normal(size=columns)
    return center + rng.normal(size=(rows, columns)) @ np.diag(0.8 ** np.arange(columns)) @ turn


@pytest.mark.parametrize("rank", [1, 5, 30])
def test_the_subspace_prior_is_the_published_energy(rank: int) -> None:
    """w^T L^-1 w + |rest|^2 / floor^2, written out, wherever the variances exceed the floor."""
    rng = np.random.default_rng(rank)
    poses, floor = spread(rng, 40, 12), 0.05
    mean, covariance = map(np.asarray, subspace_of(jnp.asarray(poses), rank, jnp.asarray(floor)))
    values, vectors = np.linalg.eigh(np.cov(poses.T, bias=True))
    U, L = vectors[:, ::-1][:, :rank], np.maximum(values[::-1][:rank], floor**2)
    for pose in rng.normal(size=(5, 12)):
        w = U.T @ (pose - poses.mean(axis=0))
        rest = pose - poses.mean(axis=0) - U @ w
        expected = w @ (w / L) + rest @ rest / floor**2
        found = (pose - mean) @ np.linalg.solve(covariance, pose - mean)
        assert found == pytest.approx(expected)


def plain_regression(X: ndarray, Y: ndarray, x: ndarray, rank: int) -> tuple[ndarray, ndarray]:
    center, mean = X.mean(axis=0), Y.mean(axis=0)
    _, singular, Vt = np.linalg.svd(X - center, full_matrices=False)
    U = Vt[:rank][singular[:rank] > 1e-6 * singular[0]].T
    scores = (X - center) @ U
    slopes, *_ = np.linalg.lstsq(scores, Y - mean, rcond=None)
    residuals = Y - mean - scores @ slopes
    return mean + (x - center) @ U @ slopes, np.sqrt(np.mean(residuals**2, axis=0))


# Examples, inputs, outputs, rank: few examples and many, one direction and more than there are.
@pytest.mark.parametrize(
    ("examples", "inputs", "outputs", "rank"),
    [(12, 30, 4, 5), (12, 30, 4, 1), (12, 30, 4, 20), (25, 6, 3, 4), (3, 168, 2, 2)],
)
def test_the_regression_is_least_squares_on_principal_scores(
    examples: int, inputs: int, outputs: int, rank: int
) -> None:
    rng = np.random.default_rng(examples + rank)
    X, Y = spread(rng, examples, inputs), spread(rng, examples, outputs)
    x = rng.normal(size=inputs)
    found = regress(jnp.asarray(X), jnp.asarray(Y), jnp.asarray(x), rank)
    for ours, plain in zip(found, plain_regression(X, Y, x, rank), strict=True):
        np.testing.assert_allclose(ours, plain, atol=1e-6)


def test_equal_examples_predict_themselves() -> None:
    rng = np.random.default_rng(0)
    X, Y = (np.repeat(rng.normal(size=(1, n)), 8, axis=0) for n in (20, 5))
    mean, sigma = regress(jnp.asarray(X), jnp.asarray(Y), jnp.asarray(rng.normal(size=20)), 4)
    np.testing.assert_allclose(mean, Y[0], atol=1e-9)
    np.testing.assert_allclose(sigma, 0.0, atol=1e-9)
    mean, covariance = subspace_of(jnp.asarray(Y), 4, jnp.asarray(0.1))
    np.testing.assert_allclose(mean, Y[0], atol=1e-9)
    np.testing.assert_allclose(covariance, 0.01 * np.eye(5), atol=1e-9)


@pytest.mark.parametrize("method", ["lpca", "lpcr"])
def test_they_find_a_walk_and_follow_it(method, estimator_of, trackers, walk, body):
    estimator: Synthesizer = estimator_of(method)
    session = Session(walk.qpos[:40], body, follow(estimator, list(trackers)[:40]))
    assert session.is_finite
    assert session.errors[5:].mean() < 0.03
    assert session.joint_speeds[5:].max() < 60.0
    residuals = np.array([pose.position_residuals for pose in session.poses])
    assert residuals[5:].mean() < 0.015
