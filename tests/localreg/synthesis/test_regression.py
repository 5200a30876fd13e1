"""Local regression against plain implementations of the same formulas."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy import ndarray

from localreg.synthesis.regression import (
    joint_projection,
    kernel_weights,
    per_dof_projection,
    weighted_ridge,
    within_reach,
)

per_dof = partial(jax.jit, static_argnums=3)(per_dof_projection)
joint = partial(jax.jit, static_argnums=3)(joint_projection)
ridge_fit = jax.jit(weighted_ridge)

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


def normal_equations(X, Y, weights, x, penalty) -> tuple[ndarray, ndarray]:
    """Weighted ridge with a free intercept, all unknowns in one system; and its slopes."""
    A = np.column_stack([np.ones(len(X)), X])
    P = penalty * np.eye(A.shape[1])
    P[0, 0] = 0.0
    solved = np.linalg.solve(A.T @ (weights[:, None] * A) + P, A.T @ (weights[:, None] * Y))
    return np.concatenate([[1.0], x]) @ solved, solved[1:]


def ridge_problem(seed: int, examples: int = 15, inputs: int = 4) -> tuple[ndarray, ...]:
    X, Y, x = problem(seed, examples, inputs, 3)
    return X, Y, np.random.default_rng(seed + 100).uniform(0.05, 1.0, examples), x


@pytest.mark.parametrize("ridge", [1e-6, 0.1, 3.0, 1e6])
@pytest.mark.parametrize("size", [(15, 4), (6, 9)])
def test_weighted_ridge_solves_the_normal_equations(ridge, size):
    for seed in range(5):
        X, Y, weights, x = ridge_problem(seed, *size)
        mean, _ = ridge_fit(X, Y, weights, x, ridge)
        expected, _ = normal_equations(X, Y, weights, x, ridge * weights.sum())
        np.testing.assert_allclose(mean, expected, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(
    ("size", "ridge"),
    [((15, 4), 0.01), ((15, 4), 0.3), ((15, 4), 3.0), ((9, 12), 0.3), ((9, 12), 3.0)],
)
def test_the_covariance_is_that_of_true_refits_without_each_example(ridge, size):
    """PRESS is exact for a penalty that stays what it was, not for one that shrinks with it.

    The penalty is ridge x the sum of all weights. A refit without example i finds its own
    center, but must keep that penalty: then e_i / (1 - h_ii) is its error at i, exactly.
    (No example here has a leverage above 0.95, at which the code caps it.)
    """
    X, Y, weights, x = ridge_problem(11, *size)
    total = weights.sum()
    errors = np.empty_like(Y)
    for i in range(len(X)):
        rest = np.arange(len(X)) != i
        predicted, _ = normal_equations(X[rest], Y[rest], weights[rest], X[i], ridge * total)
        errors[i] = Y[i] - predicted
    slopes = normal_equations(X, Y, weights, x, ridge * total)[1]
    expected = errors.T @ (weights[:, None] * errors) / total + slopes.T @ slopes
    _, covariance = ridge_fit(X, Y, weights, x, ridge)
    np.testing.assert_allclose(covariance, expected, rtol=1e-8, atol=1e-10)


def test_an_example_that_owns_its_fit_has_a_finite_error():
    X, Y, weights, x = ridge_problem(12)
    X[0] += 1e6
    mean, covariance = ridge_fit(X, Y, weights, x, 1e-9)
    assert np.all(np.isfinite(mean))
    assert np.all(np.isfinite(covariance))


def test_examples_of_no_weight_do_not_exist():
    X, Y, weights, x = ridge_problem(13)
    weights[10:] = 0.0
    alone = ridge_fit(X[:10], Y[:10], weights[:10], x, 0.3)
    X[10:], Y[10:] = 1e3, -1e3
    for got, expected in zip(ridge_fit(X, Y, weights, x, 0.3), alone, strict=True):
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("examples", [1, 2, 8])
def test_without_any_weight_all_examples_count_alike(examples):
    X, Y, _, x = ridge_problem(14)
    X, Y = X[:examples], Y[:examples]
    none = ridge_fit(X, Y, np.zeros(examples), x, 0.3)
    alike = ridge_fit(X, Y, np.ones(examples), x, 0.3)
    for got, expected in zip(none, alike, strict=True):
        assert np.all(np.isfinite(got))
        np.testing.assert_allclose(got, expected)


@pytest.mark.parametrize("factor", [1e-9, 1.0, 1e9])
def test_only_ratios_of_weights_count(factor):
    X, Y, weights, x = ridge_problem(15)
    for got, expected in zip(
        ridge_fit(X, Y, factor * weights, x, 0.3), ridge_fit(X, Y, weights, x, 0.3), strict=True
    ):
        np.testing.assert_allclose(got, expected, rtol=1e-9)


def test_weights_fall_from_one_at_the_query_to_nearly_none_at_the_farthest():
    weights = np.asarray(kernel_weights(jnp.array([0.0, 1.0, 2.0, 4.0])))
    assert weights[0] == 1.0
    assert np.all(np.diff(weights) < 0.0)
    assert 0.0 < weights[-1] < 0.01


def test_rows_at_infinite_distance_have_no_weight():
    finite = jnp.array([0.5, 1.0, 2.0])
    padded = kernel_weights(jnp.concatenate([finite, jnp.full(2, jnp.inf)]))
    np.testing.assert_array_equal(padded[3:], 0.0)
    np.testing.assert_array_equal(padded[:3], kernel_weights(finite))


@pytest.mark.parametrize("distance", [0.0, 1e-300, 1e-15, 1.0, 1e30])
def test_equal_distances_have_equal_weights_above_zero(distance):
    weights = np.asarray(kernel_weights(jnp.full(5, distance)))
    assert np.all(weights == weights[0])
    assert 0.0 < weights[0] <= 1.0


@pytest.mark.parametrize("hopeless", [np.inf, np.nan])
def test_hopeless_distances_lead_to_no_nan(hopeless):
    weights = kernel_weights(jnp.full(15, hopeless))
    np.testing.assert_array_equal(weights, 0.0)
    X, Y, _, x = ridge_problem(16)
    mean, covariance = ridge_fit(X, Y, weights, x, 3.0)
    assert np.all(np.isfinite(mean))
    assert np.all(np.linalg.eigvalsh(covariance) >= 0.0)


def test_an_input_is_held_near_the_examples_that_count():
    """Within their range, a quarter of it and three deviations; inside it stays as it is."""
    X = jnp.array([[0.0, 1.0], [8.0, 1.0], [1e6, -1e6]])
    weights = jnp.array([1.0, 0.5, 0.0])
    for x, expected in [
        ([4.0, 1.5], [4.0, 1.5]), ([12.9, 4.0], [12.9, 4.0]), ([1e9, -1e9], [13.0, -2.0]),
        ([-1e9, 1e9], [-5.0, 4.0]),
    ]:  # fmt: skip
        np.testing.assert_allclose(within_reach(X, weights, jnp.array(x)), expected)
    x = jnp.array([3.0, 5.0])
    np.testing.assert_array_equal(within_reach(X, jnp.zeros(3), x), x)
