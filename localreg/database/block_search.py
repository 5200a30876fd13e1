"""Neighbours among blocks of consecutive windows: exact, or exact in the likeliest part.

A block whose bound lies beyond the K-th nearest window known is passed over whole; what
remains is compared by the metric itself. In small databases that is done for all blocks. In
large ones only for those of the clusters nearest to the query, so that the time of a search
hardly grows with the database; the answer depends on nothing but the query.
"""

import copy
import threading
from collections.abc import Sequence
from typing import Final

import numpy as np
from jaxtyping import Bool, Float32, Int
from numpy import ndarray

from localreg.database.block_index import BlockIndex, window_scale
from localreg.database.block_kernels import (
    Poses,
    Scratch,
    Target,
    all_distances,
    search_blocks,
)
from localreg.database.neighbours import (
    Metric,
    Neighbours,
    NeighbourSearch,
    Query,
)

PROBES: Final = 288
"""Clusters that are looked into in large databases. Of the 128 nearest windows among 1.1 million,
256 clusters hold 99.4 % and 400 hold 99.8 %; with 224 some clips fall short of 99 %."""

_FIRST: Final = 24  # clusters that a first limit is taken from
_TURNED: Final = 256  # centers at a time
_MORE: Final = 1.1  # by how much the K-th distance may grow from frame to frame
_UNTRUSTED: Final = 1e-6  # share of a direction below which nothing is trusted of it


class BlockSearch(NeighbourSearch):
    """Search by a `BlockIndex`.

    Args:
        index: of these angles and features, by this metric.
        angles: joint angles of all poses [rad].
        features: their features.
        allowed: which poses may be found; those without a full window of predecessors in
            their clip must not be.
        metric: how differences count.
        groups: the recording that every pose belongs to, for `search` without one; by
            default there is only one.
        probes: how many clusters to look into; all of them, and so exactly, if None.
    """

    def __init__(
        self,
        index: BlockIndex,
        angles: Float32[ndarray, "N 56"],
        features: Float32[ndarray, "N f"],
        allowed: Bool[ndarray, " N"],
        metric: Metric,
        groups: Int[ndarray, " N"] | None = None,
        probes: int | None = None,
    ):
        self._index = index
        groups = np.zeros(len(angles), dtype=np.int32) if groups is None else groups
        self._poses = Poses(*map(_plain, (angles, features, allowed, groups.astype(np.int32))))
        self._blocks = type(index.blocks)(*map(_plain, index.blocks))
        self._available = np.bincount(groups[allowed], minlength=int(groups.max()) + 1)
        self._scale = window_scale(metric, angles.shape[1])
        clusters = len(index.blocks.cluster_center)
        self._probes = clusters if probes is None else min(probes, clusters)
        self._room = threading.local()

    @property
    def is_exact(self) -> bool:
        """Whether no neighbour can be missing."""
        return self._probes == len(self._blocks.cluster_center)

    def made_exact(self) -> "BlockSearch":
        """The same search with no neighbour missing."""
        other = copy.copy(self)
        other._probes = len(self._blocks.cluster_center)
        other._room = threading.local()
        return other

    def search(self, query: Query, count: int, without: int = -1) -> Neighbours:
        """The `count` nearest allowed poses, those of one recording left out if wanted."""
        wanted = min(count, self.available(without))
        if not wanted:
            raise ValueError("no pose may be found")
        room = self._scratch()
        target = self._target(query, without)
        guess = self._room.guess.get((wanted, len(target.turn)), 0.0)
        found = search_blocks(
            self._blocks, self._poses, target, wanted, self._probes, _FIRST, guess, room
        )
        squared = room.squared[:found]
        order = np.argsort(squared)[:wanted]
        rows, squared = room.rows[:found][order].astype(np.int64), squared[order].astype(float)
        self._room.guess[wanted, len(target.turn)] = _MORE * squared[-1]
        if wanted < count:
            extra = count - wanted
            rows = np.concatenate([rows, np.resize(rows, extra)])
            squared = np.concatenate([squared, np.full(extra, np.inf)])
        return Neighbours(rows, squared)

    def available(self, without: int = -1) -> int:
        """How many poses may be found when one recording is left out."""
        found = int(self._available.sum())
        return found - int(self._available[without]) if without >= 0 else found

    def squared_distances(self, queries: Sequence[Query]) -> Float32[ndarray, "Q N"]:
        """Distances of all poses to each of some queries; infinite where not allowed."""
        squared = np.empty((len(queries), len(self._poses.kept)), dtype=np.float32)
        for query, out in zip(queries, squared, strict=True):
            all_distances(self._poses, self._target(query, -1), out)
        return squared

    def _target(self, query: Query, without: int) -> Target:
        """The query in the terms of the index."""
        lags, width = query.history.shape
        past_trust = np.repeat(query.history_valid[::-1].astype(float), width)
        trust = np.concatenate([past_trust, query.feature_trust])
        window = np.concatenate([query.history[::-1].ravel(), query.features])
        weight = np.square(self._scale * trust).astype(np.float32)
        away = self._scale * window - self._index.mean
        basis = self._index.basis
        if np.all(trust == 1.0):
            turn = _NO_TURN
            point = away.astype(np.float32) @ basis
        else:
            turn, point = _trusted(basis, trust, away)
            away = trust * away
        beside = float(away @ away) - float(point @ point)
        past = lags * width
        raw = window.astype(np.float32)
        return Target(
            raw[:past], weight[:past], raw[past:], weight[past:], point, turn,
            np.sqrt(max(beside, 0.0)), without,
        )  # fmt: skip

    def _scratch(self) -> Scratch:
        """Room for this thread's searches."""
        if not hasattr(self._room, "scratch"):
            count, blocks = len(self._poses.kept), self._blocks
            most = max(count, len(blocks.center))
            self._room.guess = {}
            self._room.scratch = Scratch(
                apart=np.empty(len(blocks.center), dtype=np.float32),
                order=np.empty(most, dtype=np.float32),
                probed=np.empty(len(blocks.cluster_center), dtype=np.uint8),
                cluster_apart=np.empty(len(blocks.cluster_center), dtype=np.float32),
                turned=np.empty((_TURNED, blocks.center.shape[1]), dtype=np.float32),
                points=np.empty(count, dtype=np.int32),
                estimates=np.empty(most, dtype=np.float32),
                least=np.empty(count, dtype=np.float32),
                rows=np.empty(count, dtype=np.int32),
                squared=np.empty(count, dtype=np.float32),
            )
        return self._room.scratch


_NO_TURN: Final = np.zeros((0, 0), dtype=np.float32)


def _trusted(
    basis: Float32[ndarray, "n d"], trust: ndarray, away: ndarray
) -> tuple[Float32[ndarray, "d d"], Float32[ndarray, " d"]]:
    """What turns principal directions into what is trusted of them, and the query there.

    With A = T P, the trusted part of the directions, |A y - T q| is the distance of y W
    from a point, and of what of T q lies outside A's dimensions.
    """
    part = trust[:, None] * basis
    values, vectors = np.linalg.eigh(part.T @ part)
    roots = np.sqrt(np.where(values > _UNTRUSTED, values, 0.0))
    point = vectors.T @ (part.T @ (trust * away))
    point = np.divide(point, roots, out=np.zeros_like(point), where=roots > 0.0)
    turn = np.ascontiguousarray(vectors * roots, dtype=np.float32)
    return turn, point.astype(np.float32)


def _plain(array: ndarray) -> ndarray:
    """A read-only view: one type for the compiler, whether mapped from a file or not."""
    plain = np.asarray(array).view(np.ndarray)
    plain.flags.writeable = False
    return plain
