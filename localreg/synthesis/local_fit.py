"""Local ridge regression: from K weighted examples to a prediction and its covariance.

Inputs X (K x n), outputs Y (K x d), weights (K,), the present input x (n,), all on the host:
a few matrix products of hundreds of rows, which BLAS does faster than anything compiled here.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from localreg.numerics import scipy_linalg

_LARGEST_LEVERAGE = 0.95  # a lone far example may own its fit; keeps its residual finite


class Normal(NamedTuple):
    """A Gaussian over d outputs."""

    mean: Float[ndarray, " d"]
    covariance: Float[ndarray, "d d"]


def kernel_weights(squared_distances: Float[ndarray, " K"]) -> Float[ndarray, " K"]:
    """Weights that fall smoothly from 1 at the query to 0 beyond the farthest neighbour.

    Rows at infinite distance, which only fill the shape, get none; where no row is at a
    finite distance, all count alike.
    """
    finite = np.isfinite(squared_distances)
    if not finite.any():
        return np.ones(len(squared_distances))
    known = np.where(finite, squared_distances, 0.0)
    return np.where(finite, np.square(1.0 - known / max(1.1 * known.max(), 1e-12)), 0.0)


def within_reach(
    X: Float[ndarray, "K n"], weights: Float[ndarray, " K"], x: Float[ndarray, " n"]
) -> Float[ndarray, " n"]:
    """The input, held near those of the examples that count; in units of its noise.

    A local regression has nothing to say far from its examples: a tracker that jumped by
    5 m bent the prediction by radians, and the body followed it 60 cm. Held within the
    examples' range, a quarter of it and three deviations, 3 cm.
    """
    counted = X[weights > 0.0]
    low, high = counted.min(axis=0), counted.max(axis=0)
    margin = 0.25 * (high - low) + 3.0
    return np.clip(x, low - margin, high + margin)


class LocalFit:
    """Weighted normal equations that several ridges share.

    With inputs measured in units of their own noise a unit ridge is the errors-in-variables
    solution: an input is believed as far as its spread among the neighbours exceeds its
    noise. A larger ridge leans more on the examples' mean.
    """

    def __init__(
        self,
        X: Float[ndarray, "K n"],
        Y: Float[ndarray, "K d"],
        weights: Float[ndarray, " K"],
        x: Float[ndarray, " n"],
    ) -> None:
        self._total = weights.sum()
        center = weights @ X / self._total
        self._mean = weights @ Y / self._total
        self._weights = weights
        self._X, self._Y, self._x = X - center, Y - self._mean, x - center
        weighted = self._X * weights[:, None]
        self._gram = self._X.T @ weighted
        self._moment = weighted.T @ self._Y

    def predictions(self, ridges: Float[ndarray, " r"]) -> Float[ndarray, "r d"]:
        """All outputs with each of some ridges."""
        return np.array(
            [
                self._mean + self._x @ scipy_linalg.cho_solve(factor, self._moment)
                for factor in map(self._factor, ridges)
            ]
        )

    def normal(self, ridges: Float[ndarray, " r"], choice: Int[ndarray, " d"]) -> Normal:
        """The prediction with its leave-one-out covariance, every output with its own ridge.

        The covariance is that of the leave-one-out residuals e_i / (1 - h_ii), exact for
        weighted ridge (PRESS; Allen 1974) with

            h_ii = w_i / sum w + w_i x_i^T (X^T W X + lambda I)^-1 x_i

        on centered inputs, plus the noise of x carried through the regression.

        Args:
            ridges: to choose from.
            choice: which of them each output takes.
        """
        mean, residuals = self._mean.copy(), np.empty_like(self._Y)
        slopes = np.empty((self._X.shape[1], len(mean)))
        for ridge, columns in _by_ridge(ridges, choice):
            factor = self._factor(ridge)
            B = scipy_linalg.cho_solve(factor, self._moment[:, columns], check_finite=False)
            half = scipy_linalg.solve_triangular(
                factor[0], self._X.T, lower=True, check_finite=False
            )
            leverage = self._weights * (1.0 / self._total + np.einsum("nk,nk->k", half, half))
            kept = np.maximum(1.0 - leverage, 1.0 - _LARGEST_LEVERAGE)
            residuals[:, columns] = (self._Y[:, columns] - self._X @ B) / kept[:, None]
            slopes[:, columns] = B
            mean[columns] += self._x @ B
        residuals *= np.sqrt(self._weights / self._total)[:, None]
        return Normal(mean, residuals.T @ residuals + slopes.T @ slopes)

    def _factor(self, ridge: float) -> tuple[Float[ndarray, "n n"], bool]:
        normal = self._gram.copy()
        normal.flat[:: len(normal) + 1] += ridge * self._total
        return scipy_linalg.cholesky(normal, lower=True, check_finite=False), True


def _by_ridge(
    ridges: Float[ndarray, " r"], choice: Int[ndarray, " d"]
) -> Iterator[tuple[float, Int[ndarray, " c"]]]:
    """Every ridge that is chosen, and the outputs that take it."""
    for number in np.unique(choice):
        yield float(ridges[number]), np.flatnonzero(choice == number)
