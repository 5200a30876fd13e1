"""A database as one subject sees it: what its trackers would say, and an index of that.

Both depend on the database, on where the subject wears its trackers and on the metric. For
large databases that were loaded from a folder they are kept in the user's cache folder, so
that the next start maps them instead of working them out.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from jaxtyping import Bool, Float32
from numpy import ndarray

from localreg.body.chain import Chain
from localreg.database.block_index import BlockIndex, build_index
from localreg.database.block_parts import Blocks, Sketches
from localreg.database.block_search import PROBES, BlockSearch
from localreg.database.cache import cached_arrays, digest, touch
from localreg.database.features import FeatureLayout, database_features
from localreg.database.neighbours import Metric
from localreg.database.store import PoseDatabase

LARGE: Final = 200_000
"""Poses from which neighbours are sought in the likeliest clusters only."""

_WORTH_KEEPING: Final = 20_000  # poses that take longer to index than to map
_VERSION: Final = 3  # of what is kept
_INDEX: Final = ("mean", "basis", *Blocks._fields, *Sketches._fields)

Tell = Callable[[int, int, str], None]


@dataclass(frozen=True, eq=False)
class SubjectView:
    """What a search needs, whatever is left out of the database.

    Attributes:
        database: the poses.
        layout: which feature column means what.
        metric: how differences count.
        features: what the subject's trackers would say in every pose.
        targets: rows with a whole window of predecessors.
        groups: the recording that every pose belongs to.
        index: of the windows.
        name: under which it is kept in the cache folder; empty if it is not.
    """

    database: PoseDatabase
    layout: FeatureLayout
    metric: Metric
    features: Float32[ndarray, "N f"]
    targets: Bool[ndarray, " N"]
    groups: ndarray
    index: BlockIndex
    name: str = ""

    def search(
        self, allowed: Bool[ndarray, " N"] | None = None, *, exact: bool | None = None
    ) -> BlockSearch:
        """A search for neighbours.

        Args:
            allowed: which poses may be found; all with a whole window by default.
            exact: whether no neighbour may be missing; by default that holds for whole
                queries where the database is smaller than `LARGE`.
        """
        targets = self.targets if allowed is None else self.targets & allowed
        sees_all = len(self.database) < LARGE if exact is None else exact
        return BlockSearch(
            self.index, self.database.angles, self.features, targets, self.metric,
            self.groups, None if sees_all else PROBES, strict=exact is True,
        )  # fmt: skip


def subject_view(
    database: PoseDatabase,
    layout: FeatureLayout,
    chain: Chain,
    metric: Metric,
    tell: Tell | None = None,
) -> SubjectView:
    """The view of a database that a subject's search needs.

    Args:
        database: the poses.
        layout: which feature column means what.
        chain: the subject's body.
        metric: how differences count.
        tell: is told how far the work is, unless it has been done before.
    """
    targets = np.zeros(len(database), dtype=bool)
    targets[database.window_targets(len(metric.history))] = True

    def make() -> dict[str, ndarray]:
        features = database_features(layout, chain, database.roots, database.angles, tell)
        index = build_index(database.angles, features, targets, metric, tell)
        return {"features": features, **index.arrays()}

    if database.identity and len(database) >= _WORTH_KEEPING:
        body = [np.asarray(getattr(chain, name)) for name in chain._fields]
        columns = [repr(getattr(layout, field.name)) for field in fields(layout)]
        name = digest(_VERSION, database.identity, *columns, *body, metric.history, metric.features)
        arrays = cached_arrays(name, make)
        touch(arrays["features"])
    else:
        name, arrays = "", make()
    groups = np.array([clip.group for clip in database.clips], dtype=np.int32)
    # Every search reads all over the index (60 MB of a million poses): in memory of its own it
    # has large pages and no page is fetched in the middle of a frame.
    return SubjectView(
        database=database,
        layout=layout,
        metric=metric,
        features=arrays["features"],
        targets=targets,
        groups=groups[database.clip_index],
        index=BlockIndex.of_arrays({part: np.array(arrays[part]) for part in _INDEX}),
        name=name,
    )
