"""Local ridge regression: from K weighted examples to a prediction and its covariance.

Inputs X (K x n), outputs Y (K x d), weights (K,), the present input x (n,), all on the host:
a few matrix products of hundreds of rows, which BLAS does faster than anything compiled here.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from localreg import numerics as numerics

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
    """Weighted ridge regressions of several outputs on the same examples.

    With inputs measured in units of their own noise a unit ridge is the errors-in-variables
    solution: an input is believed as far as its spread among the neighbours exceeds its
    noise. A larger ridge leans more on the examples' mean. The weighted covariance of the
    inputs is diagonalized once, after which a ridge is one addition to its eigenvalues.
    """

    def __init__(
        self,
        X: Float[ndarray, "K n"],
        Y: Float[ndarray, "K d"],
        weights: Float[ndarray, " K"],
        x: Float[ndarray, " n"],
    ) -> None:
        total = weights.sum()
        shares = weights / total
        center = shares @ X
        self._mean = shares @ Y
        self._shares, self._Y = shares, Y - self._mean
        centered = X - center
        weighted = centered * shares[:, None]
        values, vectors = np.linalg.eigh(centered.T @ weighted)
        self._values = np.maximum(values, 0.0)
        self._X, self._x = centered @ vectors, (x - center) @ vectors
        self._moment = vectors.T @ (weighted.T @ self._Y)

    def predictions(self, ridges: Float[ndarray, " r"]) -> Float[ndarray, "r d"]:
        """All outputs with each of some ridges."""
        return self._mean + (self._x / (self._values + ridges[:, None])) @ self._moment

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
        slopes = self._moment / (self._values[:, None] + ridges[choice])
        spread = np.square(self._X) @ (1.0 / (self._values[:, None] + ridges))
        kept = np.maximum(1.0 - self._shares[:, None] * (1.0 + spread), 1.0 - _LARGEST_LEVERAGE)
        residuals = (self._Y - self._X @ slopes) * (
            np.sqrt(self._shares)[:, None] / kept[:, choice]
        )
        return Normal(self._mean + self._x @ slopes, residuals.T @ residuals + slopes.T @ slopes)
