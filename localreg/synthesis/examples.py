"""Where examples come from: the database seen by one subject, minus what is left out."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float, Float32
from numpy import ndarray

from localreg.body.kinematics import Kinematics
from localreg.database.features import FeatureLayout, database_features
from localreg.database.neighbours import ExactSearch, Metric, NeighbourSearch, Query
from localreg.database.store import PoseDatabase
from localreg.errors import DatabaseError
from localreg.numerics import host_arrays


class Examples(NamedTuple):
    """K neighbours, nearest first.

    Attributes:
        angles: joint angles of the pose and its m predecessors, newest first [rad].
        roots: root position and quaternion of the pose and of its predecessor.
        features: what the trackers would have said.
        squared_distances: to the query; infinite for rows that only fill the shape.
    """

    angles: Float[Array, "K m_and_1 56"]
    roots: Float[Array, "K 2 7"]
    features: Float[Array, "K f"]
    squared_distances: Float[Array, " K"]


@dataclass(frozen=True, eq=False)
class ExampleSource:
    """Finds examples in a database.

    Attributes:
        database: the poses.
        features: what the subject's trackers would say in each of them.
        search: finds rows.
        metric: how differences count in the search.
        targets: rows that may be found: allowed, and with all their predecessors.
        count: K.
        history: m.
    """

    database: PoseDatabase
    features: Float32[ndarray, "N f"]
    search: NeighbourSearch
    metric: Metric
    targets: Bool[ndarray, " N"]
    count: int
    history: int

    @cached_property
    def angles(self) -> Float32[ndarray, "N 56"]:
        """Joint angles of all poses: a plain array, since indexing a memory map is slow [rad]."""
        return np.asarray(self.database.angles)

    def find(self, query: Query) -> Examples:
        """The nearest examples, single precision as stored."""
        rows, squared_distances = self.search.search(query, self.count)
        angles = self.database.angles[rows[:, None] - np.arange(self.history + 1)]
        roots = self.database.roots[rows[:, None] - np.arange(2)]
        return Examples(*host_arrays(angles, roots, self.features[rows], squared_distances))


def example_source(
    database: PoseDatabase,
    features: Float32[ndarray, "N f"],
    allowed: Bool[ndarray, " N"] | None,
    metric: Metric,
    count: int,
) -> ExampleSource:
    """A source that finds only allowed poses.

    Raises:
        DatabaseError: nothing is left to find.
    """
    history = len(metric.history)
    targets = np.zeros(len(database), dtype=bool)
    targets[database.window_targets(history)] = True
    if allowed is not None:
        targets &= allowed
    if not targets.any():
        raise DatabaseError(
            "nothing is left of the database to learn from; build it from more motions or "
            "leave less out"
        )
    search = ExactSearch(database.angles, features, targets, metric)
    return ExampleSource(database, features, search, metric, targets, count, history)


def features_for(
    database: PoseDatabase, layout: FeatureLayout, kinematics: Kinematics
) -> Float32[ndarray, "N f"]:
    """What a subject's trackers would say in every pose of a database."""
    return database_features(layout, kinematics, database.roots, database.angles)
