"""Local ridge regression against the normal equations and true refits."""

import numpy as np
import pytest
from numpy import ndarray

from localreg.synthesis.local_fit import LocalFit, Normal, kernel_weights, within_reach


def problem(seed: int, examples: int, inputs: int, outputs: int) -> tuple[ndarray, ...]:
    """Inputs of falling variance, outputs that depend on them in part, and a question."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(examples, inputs)) @ np.diag(0.9 ** np.arange(inputs))
    Y = X @ rng.normal(size=(inputs, outputs)) / inputs + 0.3 * rng.normal(size=(examples, outputs))
    return X + rng.normal(size=inputs), Y + rng.normal(size=outputs), rng.normal(size=inputs)


def ridge_fit(X: ndarray, Y: ndarray, weights: ndarray, x: ndarray, ridge: float) -> Normal:
    """All that is predicted of every output is believed."""
    return LocalFit(X, Y, weights, x, ridge).normal(np.ones(Y.shape[1]))


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


@pytest.mark.parametrize("factor", [1e-9, 1.0, 1e9])
def test_only_ratios_of_weights_count(factor):
    X, Y, weights, x = ridge_problem(15)
    for got, expected in zip(
        ridge_fit(X, Y, factor * weights, x, 0.3), ridge_fit(X, Y, weights, x, 0.3), strict=True
    ):
        np.testing.assert_allclose(got, expected, rtol=1e-9)


@pytest.mark.parametrize("share", [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.2, 0.0, 0.9]])
def test_a_share_of_the_deviation_lies_between_mean_and_fit(share):
    X, Y, weights, x = ridge_problem(17)
    mean = weights @ Y / weights.sum()
    whole, _ = normal_equations(X, Y, weights, x, 0.3 * weights.sum())
    fit = LocalFit(X, Y, weights, x, 0.3)
    np.testing.assert_allclose(fit.mean, mean, rtol=1e-9)
    np.testing.assert_allclose(fit.deviation, whole - mean, rtol=1e-8, atol=1e-9)
    found = fit.normal(np.array(share))
    np.testing.assert_allclose(found.mean, mean + share * (whole - mean), rtol=1e-8, atol=1e-9)


def test_outputs_with_shares_of_their_own_have_residuals_of_true_refits():
    """Each example predicted from the others: their mean and a share of what they add to it."""
    X, Y, weights, x = ridge_problem(18)
    share, total = np.array([0.0, 0.4, 1.0]), weights.sum()
    errors = np.empty_like(Y)
    for i in range(len(X)):
        rest = np.arange(len(X)) != i
        mean = weights[rest] @ Y[rest] / weights[rest].sum()
        fitted, _ = normal_equations(X[rest], Y[rest], weights[rest], X[i], 0.3 * total)
        errors[i] = Y[i] - mean - share * (fitted - mean)
    slopes = share * normal_equations(X, Y, weights, x, 0.3 * total)[1]
    expected = errors.T @ (weights[:, None] * errors) / total + slopes.T @ slopes
    covariance = LocalFit(X, Y, weights, x, 0.3).normal(share).covariance
    np.testing.assert_allclose(covariance, expected, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(covariance, covariance.T)


def test_single_precision_loses_nothing_that_counts():
    """Inputs of a deviation of hundreds of their noise, outputs in radians."""
    X, Y, x = problem(22, 300, 48, 56)
    X, x = 200.0 * X, 200.0 * x
    weights = np.random.default_rng(1).uniform(0.05, 1.0, 300)
    double = ridge_fit(X, Y, weights, x, 10.0)
    single = ridge_fit(X.astype(np.float32), Y.astype(np.float32), weights, x, 10.0)
    sigma = np.sqrt(np.diagonal(double.covariance))
    assert np.abs(single.mean - double.mean).max() < 1e-3 * sigma.min()
    scale = np.outer(sigma, sigma)
    assert (np.abs(single.covariance - double.covariance) / scale).max() < 1e-3


@pytest.mark.parametrize("examples", [1, 2, 3, 8])
def test_fewer_examples_than_inputs_are_answered(examples):
    X, Y, weights, x = ridge_problem(14, examples=examples, inputs=12)
    mean, covariance = ridge_fit(X, Y, weights, x, 1.0)
    expected, _ = normal_equations(X, Y, weights, x, weights.sum())
    np.testing.assert_allclose(mean, expected, rtol=1e-9, atol=1e-9)
    assert np.all(np.isfinite(covariance))
    assert np.linalg.eigvalsh(covariance)[0] > -1e-12


@pytest.mark.parametrize("ridge", [1.0, 300.0])
def test_equal_examples_predict_themselves_without_doubt(ridge):
    X, Y, weights, x = ridge_problem(19)
    X, Y = np.repeat(X[:1], len(X), axis=0), np.repeat(Y[:1], len(Y), axis=0)
    mean, covariance = ridge_fit(X, Y, weights, x, ridge)
    np.testing.assert_allclose(mean, Y[0], atol=1e-9)
    np.testing.assert_allclose(covariance, 0.0, atol=1e-9)


def test_a_great_ridge_leaves_the_weighted_mean():
    X, Y, weights, x = ridge_problem(20)
    mean, _ = ridge_fit(X, Y, weights, x, 1e12)
    np.testing.assert_allclose(mean, weights @ Y / weights.sum(), rtol=1e-9)


def test_what_is_fitted_is_not_changed():
    given = ridge_problem(21)
    copies = [part.copy() for part in given]
    fit = LocalFit(*given, 2.0)
    first = fit.normal(np.array([1.0, 0.5, 0.0]))
    again = fit.normal(np.array([1.0, 0.5, 0.0]))
    for part, copy in zip((*given, *first), (*copies, *again), strict=True):
        np.testing.assert_array_equal(part, copy)


def test_weights_fall_from_one_at_the_query_to_nearly_none_at_the_farthest():
    weights = kernel_weights(np.array([0.0, 1.0, 2.0, 4.0]))
    assert weights[0] == 1.0
    assert np.all(np.diff(weights) < 0.0)
    assert 0.0 < weights[-1] < 0.01


def test_rows_at_infinite_distance_have_no_weight():
    finite = np.array([0.5, 1.0, 2.0])
    padded = kernel_weights(np.concatenate([finite, np.full(2, np.inf)]))
    np.testing.assert_array_equal(padded[3:], 0.0)
    np.testing.assert_array_equal(padded[:3], kernel_weights(finite))


@pytest.mark.parametrize("distance", [0.0, 1e-300, 1e-15, 1.0, 1e30])
def test_equal_distances_have_equal_weights_above_zero(distance):
    weights = kernel_weights(np.full(5, distance))
    assert np.all(weights == weights[0])
    assert 0.0 < weights[0] <= 1.0


@pytest.mark.parametrize("hopeless", [np.inf, np.nan])
def test_where_no_distance_is_finite_all_examples_count_alike(hopeless):
    weights = kernel_weights(np.full(15, hopeless))
    np.testing.assert_array_equal(weights, 1.0)
    X, Y, _, x = ridge_problem(16)
    mean, covariance = ridge_fit(X, Y, weights, x, 3.0)
    assert np.all(np.isfinite(mean))
    assert np.all(np.linalg.eigvalsh(covariance) >= 0.0)


def test_an_input_is_held_near_the_examples_that_count():
    """Within their range, a quarter of it and three deviations; inside it stays as it is."""
    X = np.array([[0.0, 1.0], [8.0, 1.0], [1e6, -1e6]])
    weights = np.array([1.0, 0.5, 0.0])
    for x, expected in [
        ([4.0, 1.5], [4.0, 1.5]), ([12.9, 4.0], [12.9, 4.0]), ([1e9, -1e9], [13.0, -2.0]),
        ([-1e9, 1e9], [-5.0, 4.0]),
    ]:  # fmt: skip
        np.testing.assert_allclose(within_reach(X, weights, np.array(x)), expected)
