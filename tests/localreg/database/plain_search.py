"""Neighbours by comparing all poses: what every search is held to."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float32
from numpy import ndarray

from localreg.database.neighbours import Metric, Neighbours, Query


class PlainSearch:
    """Brute force by matrix products."""

    def __init__(
        self,
        angles: Float32[ndarray, "N 56"],
        features: Float32[ndarray, "N f"],
        allowed: Bool[ndarray, " N"],
        metric: Metric,
    ):
        """Prepare the search.

        Args:
            angles: joint angles of all poses [rad].
            features: their features.
            allowed: which poses may be found; those without a full window of
                predecessors in their clip must not be.
            metric: how differences count.
        """
        self._metric = metric
        self._angles = angles
        self._angle_squares = np.einsum("ij,ij->i", angles, angles)
        self._features = features * metric.features.astype(np.float32)
        self._feature_squares = np.einsum("ij,ij->i", self._features, self._features)
        self._forbidden = np.flatnonzero(~allowed)
        self._available = int(allowed.sum())

    def search(self, query: Query, count: int) -> Neighbours:
        """The `count` nearest allowed poses."""
        squared = self.squared_distances([query])[0]
        return nearest(squared, count, min(count, self._available))

    def squared_distances(self, queries: Sequence[Query]) -> Float32[ndarray, "Q N"]:
        """Distances of all poses to each of some queries; infinite where not allowed."""
        squared = np.zeros((len(queries), len(self._angles)), dtype=np.float32)
        # |a - b|^2 = |a|^2 - 2 a b + |b|^2, all lags in one product over the poses.
        past = np.array([query.history for query in queries], dtype=np.float32)
        valid = np.array([query.history_valid for query in queries])
        lags = past.shape[1]
        products = (self._angles @ past.reshape(-1, past.shape[2]).T).T
        products = products.reshape(len(queries), lags, len(self._angles))
        for row, distances in enumerate(squared):
            for lag in range(1, lags + 1):
                weight = self._metric.history[lag - 1]
                if weight > 0.0 and valid[row, lag - 1]:
                    then = past[row, lag - 1]
                    part = self._angle_squares[:-lag] - 2.0 * products[row, lag - 1, :-lag]
                    distances[lag:] += np.float32(weight**2) * (part + then @ then)
        trust = np.array([query.feature_trust for query in queries])
        features = np.array([query.features for query in queries])
        scaled = (features * self._metric.features * trust).astype(np.float32)
        # Rows this short are padded with whatever lies behind them; its flags mean nothing.
        with np.errstate(invalid="ignore"):
            products = (self._features @ (scaled * trust.astype(np.float32)).T).T
        for row, distances in enumerate(squared):
            squares = self._feature_squares
            if np.any(trust[row] != 1.0):
                squares = np.square(self._features) @ np.square(trust[row]).astype(np.float32)
            distances += squares - 2.0 * products[row] + scaled[row] @ scaled[row]
        squared[:, self._forbidden] = np.inf
        return squared


def nearest(squared: Float32[ndarray, " N"], count: int, available: int) -> Neighbours:
    """The nearest of all poses, from their squared distances.

    Args:
        squared: distances, infinite where not allowed.
        count: how many rows to return.
        available: how many of them there are; the rest repeats them at infinite distance.
    """
    rows = np.argpartition(squared, available - 1)[:available]
    rows = rows[np.argsort(squared[rows], kind="stable")]
    distances = np.maximum(squared[rows].astype(float), 0.0)
    if available < count:
        extra = count - available
        rows = np.concatenate([rows, np.resize(rows, extra)])
        distances = np.concatenate([distances, np.full(extra, np.inf)])
    return Neighbours(rows, distances)
