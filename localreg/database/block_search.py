"""Neighbours among blocks of consecutive windows: exact, or exact in the likeliest part.

A block whose bound lies beyond the K-th nearest window known is passed over whole; what
remains is compared by the metric itself. In small databases that is done for all blocks. In
large ones only for those of the clusters nearest to the query and for what follows the
neighbours of the frame before, wherever that is, so that the time of a search hardly grows
with the database. The answer depends on nothing but the query.
"""

import copy
import threading
from collections.abc import Sequence
from functools import lru_cache, partial
from typing import Final, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from numpy import ndarray
from scipy.linalg import solve_triangular

from localreg.database.block_distances import all_distances, look_from
from localreg.database.block_index import BlockIndex, window_scale
from localreg.database.block_kernels import search_blocks
from localreg.database.block_parts import DIRECTIONS, SKETCHED, SOME, Poses, Scratch, Target
from localreg.database.neighbours import (
    Metric,
    Neighbours,
    NeighbourSearch,
    Query,
)

PROBES: Final = 128
"""Clusters that are looked into in large databases. Of the 96 nearest windows among 1.1 million,
these and what follows the last neighbours hold 99.4 %, and 98.2 % in the hardest clip."""

_FIRST: Final = 24  # clusters that a first limit is taken from
_MORE: Final = 1.1  # by how much the K-th distance may grow from frame to frame
_TABLE: Final = 1024  # places in the table of what follows; a power of two
_MOST_HINTS: Final = _TABLE // 2
_UNTRUSTED: Final = 1e-6  # what is trusted of a direction of which nothing is
_KEPT_TURNS: Final = 32  # trust lasts: that of the first frames, or while a tracker is away


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
        probes: how many clusters to look into; all of them if None.
        strict: whether also a query of which only a part is known is answered exactly. Bounds
            are loose there, and such searches take twice as long.
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
        strict: bool = True,
    ):
        self._index = index
        groups = np.zeros(len(angles), dtype=np.int32) if groups is None else groups
        self._poses = Poses(*map(plain, (angles, features, allowed, groups.astype(np.int32))))
        self._blocks = type(index.blocks)(*map(plain, index.blocks))
        self._sketches = type(index.sketches)(*map(plain, index.sketches))
        self._available = np.bincount(groups[allowed], minlength=int(groups.max()) + 1)
        self._all_available = int(self._available.sum())
        self._scale = window_scale(metric, angles.shape[1])
        self._weight = np.square(self._scale).astype(np.float32)
        clusters = len(index.blocks.cluster_center)
        self._probes = clusters if probes is None else min(probes, clusters)
        self._is_strict = strict
        self._turn = lru_cache(_KEPT_TURNS)(partial(_trusted, index.basis))
        self._room = threading.local()

    @property
    def is_exact(self) -> bool:
        """Whether no neighbour can be missing."""
        return self._is_strict and self._sees_all

    @property
    def _sees_all(self) -> bool:
        return self._probes == len(self._blocks.cluster_center)

    def made_exact(self) -> "BlockSearch":
        """The same search with no neighbour missing."""
        other = copy.copy(self)
        other._probes, other._is_strict = len(self._blocks.cluster_center), True
        other._room = threading.local()
        return other

    def search(self, query: Query, count: int, without: int = -1) -> Neighbours:
        """The `count` nearest allowed poses, those of one recording left out if wanted."""
        wanted = min(count, self.available(without))
        if not wanted:
            raise ValueError("no pose may be found")
        room = self._scratch()
        target = self._target(query, without)
        guess, hints = 0.0, _NO_ROWS
        if query.near is not None and np.isfinite(query.near.squared_distances[-1]):
            guess = _MORE * query.near.squared_distances[-1]
            if not self._sees_all:
                hints = query.near.rows[:_MOST_HINTS]
        rows, squared = search_blocks(
            self._blocks, self._sketches, self._poses, target, wanted, self._probes, _FIRST,
            guess, hints, room,
        )  # fmt: skip
        if wanted < count:
            extra = count - wanted
            rows = np.concatenate([rows, np.resize(rows, extra)])
            squared = np.concatenate([squared, np.full(extra, np.inf, squared.dtype)])
        return Neighbours(rows, squared)

    def available(self, without: int = -1) -> int:
        """How many poses may be found when one recording is left out."""
        return self._all_available - (int(self._available[without]) if without >= 0 else 0)

    def squared_distances(self, queries: Sequence[Query]) -> Float32[ndarray, "Q N"]:
        """Distances of all poses to each of some queries; infinite where not allowed."""
        squared = np.empty((len(queries), len(self._poses.kept)), dtype=np.float32)
        for query, out in zip(queries, squared, strict=True):
            all_distances(self._poses, self._target(query, -1), out)
        return squared

    def _target(self, query: Query, without: int) -> Target:
        """The query in the terms of the index."""
        past = query.history.size
        raw, away, point, beside, fine_beside = look_from(
            query.history, query.features, self._scale, self._index.mean, self._index.basis
        )
        weight, turn = self._weight, _NO_TURN
        if not query.is_whole:
            known = np.repeat(query.history_valid[::-1], query.history.shape[1])
            trust = np.concatenate([known, query.feature_trust])
            turn = self._turn(trust.tobytes())
            weight = np.square(self._scale * trust).astype(np.float32)
            point = (turn.onto @ away).astype(np.float32)
            length = float(np.sum(np.square(trust * away)))
            outside = length - np.cumsum(np.square(point, dtype=float))[[DIRECTIONS - 1, -1]]
            beside, fine_beside = np.sqrt(np.maximum(outside, 0.0)).tolist()
        return Target(
            raw[:past], weight[:past], raw[past:], weight[past:], point[:DIRECTIONS],
            turn.coarse, beside, point, turn.fine, fine_beside, without, self._is_strict,
        )  # fmt: skip

    def _scratch(self) -> Scratch:
        """Room for this thread's searches."""
        if not hasattr(self._room, "scratch"):
            count, blocks = len(self._poses.kept), self._blocks
            most = max(count, len(blocks.center))
            self._room.scratch = Scratch(
                apart=np.empty(len(blocks.center), dtype=np.float32),
                order=np.empty(most, dtype=np.float32),
                probed=np.empty(len(blocks.cluster_center), dtype=np.uint8),
                cluster_apart=np.empty(len(blocks.cluster_center), dtype=np.float32),
                held=np.empty(len(blocks.center), dtype=np.int32),
                curves=np.empty((3 * SOME, DIRECTIONS), dtype=np.float32),
                turned=np.empty((3 * SOME, DIRECTIONS), dtype=np.float32),
                products=np.empty((SOME, 5), dtype=np.float32),
                drawn=np.empty((SOME, SKETCHED), dtype=np.float32),
                fine_turned=np.empty((SOME, SKETCHED), dtype=np.float32),
                known=np.empty(_TABLE, dtype=np.int32),
                points=np.empty(count, dtype=np.int32),
                estimates=np.empty(most, dtype=np.float32),
                least=np.empty(count, dtype=np.float32),
                rows=np.empty(count, dtype=np.int32),
                squared=np.empty(count, dtype=np.float32),
            )
        return self._room.scratch


class _Turn(NamedTuple):
    """Principal directions as far as a query is trusted.

    Attributes:
        fine: what turns coordinates along them into trusted ones.
        coarse: the same for the directions of blocks.
        onto: from a window to trusted coordinates.
    """

    fine: Float32[ndarray, "D D"]
    coarse: Float32[ndarray, "d d"]
    onto: Float[ndarray, "D n"]


_NOTHING: Final = np.zeros((0, 0), dtype=np.float32)
_NO_TURN: Final = _Turn(_NOTHING, _NOTHING, np.zeros((0, 0)))
_NO_ROWS: Final = np.zeros(0, dtype=np.int64)


def _trusted(basis: Float32[ndarray, "n D"], trust_bytes: bytes) -> _Turn:
    """What is trusted of the principal directions.

    With A = T P the trusted part of the directions, and A^T A = L L^T, |A y - T q| is the
    distance of y L from a point, and of what of T q lies outside A's dimensions. L is
    triangular, so that the first directions do without the others.
    """
    trust = np.frombuffer(trust_bytes)
    part = trust[:, None] * basis
    square = part.T @ part
    square[np.diag_indices(len(square))] += _UNTRUSTED
    L = np.linalg.cholesky(square)
    onto = solve_triangular(L, part.T * trust, lower=True, check_finite=False)
    fine = L.astype(np.float32)
    return _Turn(fine, np.ascontiguousarray(fine[:DIRECTIONS, :DIRECTIONS]), onto)


def plain(array: ndarray) -> ndarray:
    """A read-only view: one type for the compiler, whether mapped from a file or not."""
    plain = np.asarray(array).view(np.ndarray)
    plain.flags.writeable = False
    return plain
