"""The published projections against plain implementations of the same formulas."""

from functools import partial

import jax
import numpy as np
import pytest
from numpy import ndarray

from localreg.synthesis.regression import joint_projection, per_dof_projection

per_dof = partial(jax.jit, static_argnums=3)(per_dof_projection)
joint = partial(jax.jit, static_argnums=3)(joint_projection)

# Examples, inputs, outputs, rank: few examples and many, one direction and all there are.
SHAPES = [(12, 30, 4, 5), (12, 30, 4, 1), (12, 30, 4, 11), (25, 6, 3, 4), (3, 168, 2, 2)]
NULL = 1e-7  # singular values below this share of the largest carry no direction


def problem(seed: int, examples: int, inputs: int, outputs: int) -> tuple[ndarray, ...]:
    """Inputs of falling variance, outputs that depend on them in part, and a question."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(examples, inputs)) @ np.diag(0.9 ** np.arange(inputs))
    Y = X @ rng.normal(size=(inputs, outputs)) / inputs + 0.3 * rng.normal(size=(examples, outputs))
    return X + rng.normal(size=inputs), Y + rng.normal(size=outputs), rng.normal(size=inputs)


def leading(A: ndarray, rank: int) -> ndarray:
    """The leading right singular vectors as columns, without those of no length."""
    _, singular, Vt = np.linalg.svd(A, full_matrices=False)
    return Vt[:rank][singular[:rank] > NULL * singular[0]].T


def plain_per_dof(X: ndarray, Y: ndarray, x: ndarray, rank: int) -> tuple[ndarray, ndarray]:
    center, mean = X.mean(axis=0), Y.mean(axis=0)
    X, Y, x = X - center, Y - mean, x - center
    predicted, sigma = np.zeros(Y.shape[1]), np.zeros(Y.shape[1])
    for d, y in enumerate(Y.T):
        U = leading(np.column_stack([X, y]), rank)
        U_x, u_y = U[:-1], U[-1]
        alpha = U_x @ np.linalg.solve(U_x.T @ U_x, u_y)
        predicted[d] = mean[d] + alpha @ x
        sigma[d] = np.sqrt(np.mean((y - X @ alpha) ** 2))
    return predicted, sigma


def plain_joint(X: ndarray, Y: ndarray, x: ndarray, rank: int) -> tuple[ndarray, ndarray]:
    center, mean = X.mean(axis=0), Y.mean(axis=0)
    X, Y, x = X - center, Y - mean, x - center
    U = leading(np.hstack([X, Y]), rank)
    U_x, U_y = U[: X.shape[1]], U[X.shape[1] :]
    alpha = U_y @ np.linalg.solve(U_x.T @ U_x, U_x.T)
    return mean + alpha @ x, np.sqrt(np.mean((Y - X @ alpha.T) ** 2, axis=0))


def assert_same(ours, theirs: tuple[ndarray, ndarray], scale: float = 1.0) -> None:
    for got, expected in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9 * scale)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("implementation", ["per_dof", "joint"])
def test_a_projection_is_what_a_plain_svd_gives(shape, implementation):
    ours, plain = {"per_dof": (per_dof, plain_per_dof), "joint": (joint, plain_joint)}[
        implementation
    ]
    *size, rank = shape
    for seed in range(20):
        X, Y, x = problem(seed, *size)
        assert_same(ours(X, Y, x, rank), plain(X, Y, x, rank))


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1e3, 1e6, 1e10])
@pytest.mark.parametrize("implementation", ["per_dof", "joint"])
def test_a_projection_does_not_care_for_units(scale, implementation):
    ours, plain = {"per_dof": (per_dof, plain_per_dof), "joint": (joint, plain_joint)}[
        implementation
    ]
    X, Y, x = (scale * part for part in problem(3, 12, 30, 4))
    assert_same(ours(X, Y, x, 5), plain(X, Y, x, 5), scale)


@pytest.mark.parametrize("implementation", [per_dof, joint])
def test_an_output_that_never_changes_is_predicted_without_doubt(implementation):
    X, Y, x = problem(4, 12, 30, 4)
    Y[:, 1] = 0.7
    mean, sigma = implementation(X, Y, x, 5)
    assert mean[1] == pytest.approx(0.7, abs=1e-9)
    assert sigma[1] == pytest.approx(0.0, abs=1e-9)
    assert np.all(np.isfinite(mean))
    assert np.all(np.asarray(sigma)[[0, 2, 3]] > 0.01)


@pytest.mark.parametrize("distinct", [1, 2, 4, 6])
@pytest.mark.parametrize("implementation", ["per_dof", "joint"])
def test_repeated_examples_leave_no_direction_beyond_their_rank(distinct, implementation):
    """As when a small database cannot fill the neighbourhood."""
    X, Y, x = problem(5, 12, 30, 4)
    rows = np.resize(np.arange(distinct), 12)
    ours, plain = {"per_dof": (per_dof, plain_per_dof), "joint": (joint, plain_joint)}[
        implementation
    ]
    X, Y = X[rows], Y[rows]
    if distinct == 1:
        mean, sigma = ours(X, Y, x, 5)
        np.testing.assert_allclose(mean, Y[0], atol=1e-9)
        np.testing.assert_allclose(sigma, 0.0, atol=1e-9)
    else:
        assert_same(ours(X, Y, x, 5), plain(X, Y, x, 5))


@pytest.mark.parametrize("implementation", [per_dof, joint])
def test_inputs_that_say_nothing_leave_the_mean(implementation):
    X, Y, x = problem(6, 12, 30, 4)
    mean, sigma = implementation(np.repeat(X[:1], 12, axis=0), Y, x, 5)
    np.testing.assert_allclose(mean, Y.mean(axis=0), atol=1e-6)
    np.testing.assert_allclose(sigma, Y.std(axis=0), atol=1e-6)


def test_inputs_with_equal_variance_in_all_directions():
    """Equal eigenvalues everywhere: the secular equation has poles on top of each other."""
    rng = np.random.default_rng(7)
    X = np.linalg.qr(rng.normal(size=(12, 6)))[0]
    X = np.vstack([X, -X])
    Y, x = rng.normal(size=(24, 4)), rng.normal(size=6)
    assert_same(per_dof(X, Y, x, 6), plain_per_dof(X, Y, x, 6))


@pytest.mark.parametrize("implementation", [per_dof, joint])
def test_more_directions_than_examples_are_as_many_as_there_are(implementation):
    X, Y, x = problem(8, 4, 30, 3)
    for many, most in zip(implementation(X, Y, x, 9), implementation(X, Y, x, 3), strict=True):
        np.testing.assert_allclose(many, most, rtol=1e-9, atol=1e-9)
