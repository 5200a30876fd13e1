"""Where examples come from: the database seen by one subject, minus what is left out."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray

from localreg.database.block_search import BlockSearch, plain
from localreg.database.neighbours import Metric, Query
from localreg.database.resemblance import Lineup
from localreg.database.store import PoseDatabase
from localreg.database.view import SubjectView
from localreg.errors import DatabaseError


class Examples(NamedTuple):
    """K neighbours, nearest first; inside a traced prior the arrays are JAX's.

    Attributes:
        angles: joint angles of the pose and its m predecessors, newest first [rad].
        roots: root position and quaternion of the pose and of its predecessor.
        features: what the trackers would have said.
        squared_distances: to the query; infinite for rows that only fill the shape.
    """

    angles: Float[ndarray, "K m_and_1 56"]
    roots: Float[ndarray, "K 2 7"]
    features: Float[ndarray, "K f"]
    squared_distances: Float[ndarray, " K"]


@dataclass(frozen=True, eq=False)
class ExampleSource:
    """Finds examples in a database as its subject sees it.

    Attributes:
        view: the database and what the subject's trackers would say in it.
        search: finds rows.
        targets: rows that may be found: allowed, and with all their predecessors.
        count: K.
    """

    view: SubjectView
    search: BlockSearch
    targets: Bool[ndarray, " N"]
    count: int

    @property
    def database(self) -> PoseDatabase:
        """The poses."""
        return self.view.database

    @property
    def features(self) -> Float32[ndarray, "N f"]:
        """What the subject's trackers would say in each of them."""
        return self.view.features

    @property
    def metric(self) -> Metric:
        """How differences count in the search."""
        return self.view.metric

    @cached_property
    def angles(self) -> Float32[ndarray, "N 56"]:
        """Joint angles of all poses, plain, since indexing a memory map is slow [rad]."""
        return plain(self.database.angles)

    def find(self, query: Query) -> Examples:
        """The nearest examples, single precision as stored."""
        rows, squared_distances = self.search.search(query, self.count)
        past = np.arange(len(self.metric.history) + 1)
        roots = self.database.roots[rows[:, None] - np.arange(2)]
        return Examples(
            self.angles[rows[:, None] - past], roots, self.features[rows], squared_distances
        )

    @cached_property
    def _lineup(self) -> Lineup:
        return Lineup.of(self.view.layout, self.features, self.targets)

    def most_alike(
        self, positions: Float[ndarray, "J 3"], seen: Bool[ndarray, " J"]
    ) -> Float[ndarray, "56"] | None:
        """Joint angles of the pose that looks most like some tracker positions [rad].

        None where too few are seen; see `localreg.database.resemblance`.
        """
        row = self._lineup.most_alike(positions, seen)
        return None if row is None else self.angles[row].astype(float)


def example_source(
    view: SubjectView, allowed: Bool[ndarray, " N"] | None, count: int
) -> ExampleSource:
    """A source that finds only allowed poses, all by default.

    Raises:
        DatabaseError: nothing is left to find.
    """
    targets = view.targets if allowed is None else view.targets & allowed
    if not targets.any():
        raise DatabaseError(
            "nothing is left of the database to learn from; build it from more motions or "
            "leave less out"
        )
    return ExampleSource(view, view.search(allowed), targets, count)
