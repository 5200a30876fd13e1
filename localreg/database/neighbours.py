"""The K database poses that best continue the past and agree with the trackers.

The distance of database pose i to a query is

    sum over lags l of |a (angles[i - l] - past[l])|^2 + |b (features[i] - features)|^2

with a and b the weights of `Metric`; lags and features that the query does not know are
left out. Poses are stored once: windows are read off the same array at shifted rows.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from numpy import ndarray


@dataclass(frozen=True)
class Metric:
    """How differences count in the search.

    Attributes:
        history: weight of each lag's joint angles, newest first, shape (m,) [1/rad].
        features: weight of each feature column, shape (f,).
    """

    history: Float[ndarray, " m"]
    features: Float[ndarray, " f"]


class Query(NamedTuple):
    """What is known before the pose is solved.

    Attributes:
        history: joint angles of the last m poses, newest first [rad].
        history_valid: which of them exist.
        features: features of the present trackers.
        feature_valid: which columns are known.
    """

    history: Float[ndarray, "m 56"]
    history_valid: Bool[ndarray, " m"]
    features: Float[ndarray, " f"]
    feature_valid: Bool[ndarray, " f"]


class Neighbours(NamedTuple):
    """Rows of the database, nearest first, and their squared distances."""

    rows: Int[ndarray, " K"]
    squared_distances: Float[ndarray, " K"]


class NeighbourSearch(ABC):
    """Finds neighbours; implementations trade exactness for speed."""

    @abstractmethod
    def search(self, query: Query, count: int) -> Neighbours:
        """The `count` nearest allowed poses.

        If fewer are allowed, the nearest ones are repeated at infinite distance, so that
        the shape is always the same.
        """


class ExactSearch(NeighbourSearch):
    """Brute force by matrix products: exact, and fast enough to some 100,000 poses."""

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
        weights = np.where(query.history_valid, self._metric.history, 0.0)
        squared = np.zeros(len(self._angles), dtype=np.float32)
        # |a - b|^2 = |a|^2 - 2 a b + |b|^2, all lags in one product over the poses.
        past = query.history.astype(np.float32)
        products = self._angles @ past.T
        for lag, weight in enumerate(weights, start=1):
            if weight > 0.0:
                newest = past[lag - 1]
                part = self._angle_squares[:-lag] - 2.0 * products[:-lag, lag - 1]
                squared[lag:] += np.float32(weight**2) * (part + newest @ newest)
        scaled = (query.features * self._metric.features * query.feature_valid).astype(np.float32)
        if query.feature_valid.all():
            squares = self._feature_squares
        else:
            squares = np.square(self._features) @ query.feature_valid.astype(np.float32)
        squared += squares - 2.0 * (self._features @ scaled) + scaled @ scaled
        squared[self._forbidden] = np.inf
        count_found = min(count, self._available)
        rows = np.argpartition(squared, count_found - 1)[:count_found]
        rows = rows[np.argsort(squared[rows], kind="stable")]
        distances = np.maximum(squared[rows].astype(float), 0.0)
        if count_found < count:
            extra = count - count_found
            rows = np.concatenate([rows, np.resize(rows, extra)])
            distances = np.concatenate([distances, np.full(extra, np.inf)])
        return Neighbours(rows, distances)
