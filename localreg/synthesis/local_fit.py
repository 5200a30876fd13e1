"""Local ridge regression: from K weighted examples to a prediction and its covariance.

Inputs X (K x n), outputs Y (K x d), weights (K,), the present input x (n,). It is a few matrix
products of hundreds of rows: in single precision, as the database is stored, they take half
the time, and centered inputs in units of their noise lose nothing by it.
"""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray

from localreg import numerics as numerics
from localreg.synthesis.linear_algebra import factorize, invert_triangle

_LARGEST_LEVERAGE = 0.95  # a lone far example may own its fit; keeps its residual finite


class Normal(NamedTuple):
    """A Gaussian over d outputs."""

    mean: Float[ndarray, " d"]
    covariance: Float[ndarray, "d d"]


@njit(cache=True)
@no_type_check
def kernel_weights(squared_distances):
    """Weights that fall smoothly from 1 at the query to 0 beyond the farthest neighbour.

    Rows at infinite distance, which only fill the shape, get none; where no row is at a
    finite distance, all count alike.
    """
    farthest = -1.0
    for squared in squared_distances:
        if np.isfinite(squared):
            farthest = max(farthest, squared)
    if farthest < 0.0:
        return np.ones(len(squared_distances))
    reach = max(1.1 * farthest, 1e-12)
    weights = np.zeros(len(squared_distances))
    for i, squared in enumerate(squared_distances):
        if np.isfinite(squared):
            weights[i] = (1.0 - squared / reach) ** 2
    return weights


@njit(cache=True)
@no_type_check
def within_reach(X, weights, x):
    """The input, held near those of the examples that count; in units of its noise.

    A local regression has nothing to say far from its examples: a tracker that jumped by
    5 m bent the prediction by radians, and the body followed it 60 cm. Held within the
    examples' range, a quarter of it and three deviations, 3 cm.
    """
    low, high = np.full_like(x, np.inf), np.full_like(x, -np.inf)
    for i in range(len(X)):
        if weights[i] > 0.0:
            for j in range(len(x)):
                low[j], high[j] = min(low[j], X[i, j]), max(high[j], X[i, j])
    held = np.empty_like(x)
    for j in range(len(x)):
        margin = 0.25 * (high[j] - low[j]) + 3.0
        held[j] = min(max(x[j], low[j] - margin), high[j] + margin)
    return held


class LocalFit:
    """Weighted ridge regressions of several outputs on the same examples.

    With inputs measured in units of their own noise a unit ridge is the errors-in-variables
    solution: an input is believed as far as its spread among the neighbours exceeds its
    noise. A larger ridge leans more on the examples' mean, and so does an output of which
    only a share of the predicted deviation from that mean is believed. It computes in the
    precision of the examples.
    """

    def __init__(
        self,
        X: Float[ndarray, "K n"],
        Y: Float[ndarray, "K d"],
        weights: Float[ndarray, " K"],
        x: Float[ndarray, " n"],
        ridge: float,
    ) -> None:
        kind = X.dtype.type
        self._fit = _Fit(*_fit(X, Y, weights.astype(kind), x.astype(kind), kind(ridge)))

    @property
    def mean(self) -> Float[ndarray, " d"]:
        """The examples' mean."""
        return self._fit.mean

    @property
    def deviation(self) -> Float[ndarray, " d"]:
        """The predicted deviation from that mean."""
        return self._fit.x @ self._fit.slopes

    def normal(self, share: Float[ndarray, " d"]) -> Normal:
        """The prediction with its leave-one-out covariance.

        The covariance is that of the leave-one-out residuals: y_i - mean of the others
        where nothing of the deviation is believed, e_i / (1 - h_ii) where all is, which is
        exact for weighted ridge (PRESS; Allen 1974) with

            h_ii = w_i / sum w + w_i x_i^T (X^T W X + lambda I)^-1 x_i

        on centered inputs; plus the noise of x carried through the regression.

        Args:
            share: of the predicted deviation that is believed, for every output.
        """
        return Normal(*_normal(self._fit, share.astype(self._fit.x.dtype)))


class _Fit(NamedTuple):
    """Centered examples, weighted by the root of their shares, and what fits them.

    Attributes:
        mean: of the outputs.
        Y: outputs.
        x: the present input.
        slopes: from inputs to outputs.
        fitted: what they say of the outputs.
        alone: 1 / (1 - share) of every example: its residual from the mean of the others.
        left_out: 1 / (1 - leverage): its residual from the fit to the others.
    """

    mean: Float[ndarray, " d"]
    Y: Float[ndarray, "K d"]
    x: Float[ndarray, " n"]
    slopes: Float[ndarray, "n d"]
    fitted: Float[ndarray, "K d"]
    alone: Float[ndarray, " K"]
    left_out: Float[ndarray, " K"]


@njit(cache=True)
@no_type_check
def _fit(X, Y, weights, x, ridge):
    """The parts of a `_Fit`."""
    one, least = X.dtype.type(1.0), X.dtype.type(1.0 - _LARGEST_LEVERAGE)
    shares = weights / weights.sum()
    center, mean = np.dot(shares, X), np.dot(shares, Y)
    A, B = np.empty_like(X), np.empty_like(Y)
    for i in range(len(X)):
        root = np.sqrt(shares[i])
        for j in range(X.shape[1]):
            A[i, j] = root * (X[i, j] - center[j])
        for j in range(Y.shape[1]):
            B[i, j] = root * (Y[i, j] - mean[j])
    square = np.dot(A.T, A)
    for i in range(len(square)):
        square[i, i] += ridge
    # W^T W is the inverse; zero, so that no input counts, where there is none.
    L, W = np.zeros_like(square), np.zeros_like(square)
    if factorize(square, X.dtype.type(0.0), L):
        invert_triangle(L, W)
    white = np.dot(W, A.T)
    along = np.dot(white, B)
    kept = one - shares
    alone = one / np.maximum(kept, least)
    for k in range(len(white)):
        for i in range(len(X)):
            kept[i] -= white[k, i] * white[k, i]
    left_out = one / np.maximum(kept, least)
    return mean, B, x - center, np.dot(W.T, along), np.dot(white.T, along), alone, left_out


@njit(cache=True)
@no_type_check
def _normal(fit, share):
    """Mean and covariance with a share of the deviation for every output."""
    residuals = np.empty_like(fit.Y)
    for i in range(len(residuals)):
        for j in range(residuals.shape[1]):
            alone, left_out = fit.alone[i], fit.left_out[i]
            plain, fitted = fit.Y[i, j] * alone, (fit.Y[i, j] - fit.fitted[i, j]) * left_out
            residuals[i, j] = plain + share[j] * (fitted - plain)
    slopes = fit.slopes * share
    covariance = np.dot(residuals.T, residuals) + np.dot(slopes.T, slopes)
    return fit.mean + np.dot(fit.x, slopes), covariance


@njit(cache=True)
@no_type_check
def predict(X, Y, weights, x, ridge, share):
    """Mean and covariance of a `LocalFit` at an input that is held `within_reach`.

    Args:
        X: inputs of the examples.
        Y: their outputs.
        weights: how they count.
        x: the present input.
        ridge: of the regression.
        share: of the predicted deviation that is believed, for every output.

    Returns:
        The mean, in double precision, and the covariance in that of the examples.
    """
    held = within_reach(X, weights, x)
    fit = _Fit(*_fit(X, Y, weights.astype(X.dtype), held, X.dtype.type(ridge)))
    mean, covariance = _normal(fit, share.astype(X.dtype))
    return mean.astype(np.float64), covariance
