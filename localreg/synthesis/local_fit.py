"""Local ridge regression: from K weighted examples to a prediction and its covariance.

Inputs X (K x n), outputs Y (K x d), weights (K,), the present input x (n,). It is a few matrix
products of hundreds of rows: in single precision, as the database is stored, they take half
the time, and centered inputs in units of their noise lose nothing by it.
"""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int
from numba import njit
from numpy import ndarray

from localreg import numerics as numerics
from localreg.synthesis.linear_algebra import factorize, invert_triangle

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
    return _kernel_weights(squared_distances)


@njit(cache=True)
@no_type_check
def _kernel_weights(squared_distances):
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


def within_reach(
    X: Float[ndarray, "K n"], weights: Float[ndarray, " K"], x: Float[ndarray, " n"]
) -> Float[ndarray, " n"]:
    """The input, held near those of the examples that count; in units of its noise.

    A local regression has nothing to say far from its examples: a tracker that jumped by
    5 m bent the prediction by radians, and the body followed it 60 cm. Held within the
    examples' range, a quarter of it and three deviations, 3 cm.
    """
    return _within_reach(X, weights, x)


@njit(cache=True)
@no_type_check
def _within_reach(X, weights, x):
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
    noise. A larger ridge leans more on the examples' mean. It computes in the precision of
    the examples.
    """

    def __init__(
        self,
        X: Float[ndarray, "K n"],
        Y: Float[ndarray, "K d"],
        weights: Float[ndarray, " K"],
        x: Float[ndarray, " n"],
    ) -> None:
        self._fit = _Fit(*_moments(X, Y, weights.astype(X.dtype), x.astype(X.dtype)))

    def predictions(self, ridges: Float[ndarray, " r"]) -> Float[ndarray, "r d"]:
        """All outputs with each of some ridges."""
        return _predictions(self._fit, ridges.astype(self._fit.x.dtype))

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
        return Normal(*_normal(self._fit, ridges.astype(self._fit.x.dtype), choice))


class _Fit(NamedTuple):
    """Centered examples, weighted by the root of their shares, and their moments."""

    mean: Float[ndarray, " d"]
    shares: Float[ndarray, " K"]
    X: Float[ndarray, "K n"]
    Y: Float[ndarray, "K d"]
    x: Float[ndarray, " n"]
    square: Float[ndarray, "n n"]
    moment: Float[ndarray, "n d"]


@njit(cache=True)
@no_type_check
def _moments(X, Y, weights, x):
    """The parts of a `_Fit`."""
    shares = weights / weights.sum()
    center, mean = np.dot(shares, X), np.dot(shares, Y)
    A, B = np.empty_like(X), np.empty_like(Y)
    for i in range(len(X)):
        root = np.sqrt(shares[i])
        for j in range(X.shape[1]):
            A[i, j] = root * (X[i, j] - center[j])
        for j in range(Y.shape[1]):
            B[i, j] = root * (Y[i, j] - mean[j])
    return mean, shares, A, B, x - center, np.dot(A.T, A), np.dot(A.T, B)


@njit(cache=True)
@no_type_check
def _whitening(square, ridge):
    """W with W^T W = (square + ridge I)^-1; zero, so that no input counts, if there is none."""
    grown = square.copy()
    for i in range(len(grown)):
        grown[i, i] += ridge
    L, W = np.zeros_like(grown), np.zeros_like(grown)
    if factorize(grown, grown.dtype.type(0.0), L):
        invert_triangle(L, W)
    return W


@njit(cache=True)
@no_type_check
def _predictions(fit, ridges):
    """All outputs with each of some ridges."""
    found = np.empty((len(ridges), len(fit.mean)), fit.X.dtype)
    for r in range(len(ridges)):
        W = _whitening(fit.square, ridges[r])
        found[r] = fit.mean + np.dot(np.dot(np.dot(W, fit.x), W), fit.moment)
    return found


@njit(cache=True)
@no_type_check
def _normal(fit, ridges, choice):
    """Mean and covariance with a ridge for every output."""
    examples, outputs = fit.Y.shape
    one, least = fit.X.dtype.type(1.0), fit.X.dtype.type(1.0 - _LARGEST_LEVERAGE)
    slopes = np.empty_like(fit.moment)
    scale = np.empty((examples, len(ridges)), fit.X.dtype)
    for r in range(len(ridges)):
        if not np.any(choice == r):
            continue
        W = _whitening(fit.square, ridges[r])
        kept = one - fit.shares
        for direction in np.dot(W, fit.X.T):
            for i in range(examples):
                kept[i] -= direction[i] * direction[i]
        scale[:, r] = one / np.maximum(kept, least)
        solved = np.dot(W.T, np.dot(W, fit.moment))
        for j in range(outputs):
            if choice[j] == r:
                slopes[:, j] = solved[:, j]
    residuals = np.dot(fit.X, slopes)
    for i in range(examples):
        for j in range(outputs):
            residuals[i, j] = (fit.Y[i, j] - residuals[i, j]) * scale[i, choice[j]]
    covariance = np.dot(residuals.T, residuals) + np.dot(slopes.T, slopes)
    return fit.mean + np.dot(fit.x, slopes), covariance
