"""The K database poses that best continue the past and agree with the trackers.

The distance of database pose i to a query is

    sum over lags l of |a (angles[i - l] - past[l])|^2 + |b (features[i] - features)|^2

with a and b the weights of `Metric`; lags and features that the query does not know are
left out. Poses are stored once: windows are read off the same array at shifted rows.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from numba import njit
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


class Neighbours(NamedTuple):
    """Rows of the database, nearest first, and their squared distances."""

    rows: Int[ndarray, " K"]
    squared_distances: Float[ndarray, " K"]


class Query(NamedTuple):
    """What is known before the pose is solved.

    Attributes:
        history: joint angles of the last m poses, newest first [rad].
        history_valid: which of them exist.
        features: features of the present trackers.
        feature_trust: how far each column is believed: 1 measured, 0 unknown.
        near: the neighbours of the frame before; what follows them is likely to be near.
    """

    history: Float[ndarray, "m 56"]
    history_valid: Bool[ndarray, " m"]
    features: Float[ndarray, " f"]
    feature_trust: Float[ndarray, " f"]
    near: Neighbours | None = None

    @property
    def is_whole(self) -> bool:
        """Whether everything is known and fully believed, as in nearly every frame."""
        return bool(_is_whole(self.history_valid, self.feature_trust))


@njit(cache=True)
@no_type_check
def _is_whole(valid, trust):
    return np.all(valid) and np.all(trust == 1.0)


class NeighbourSearch(ABC):
    """Finds neighbours; implementations trade exactness for speed."""

    @abstractmethod
    def search(self, query: Query, count: int, without: int = -1) -> Neighbours:
        """The `count` nearest allowed poses, those of one recording left out if wanted.

        If fewer are allowed, the nearest ones are repeated at infinite distance, so that
        the shape is always the same.
        """

    @abstractmethod
    def squared_distances(self, queries: Sequence[Query]) -> Float32[ndarray, "Q N"]:
        """Distances of all poses to each of some queries; infinite where not allowed."""
