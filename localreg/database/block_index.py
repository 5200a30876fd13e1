"""Blocks of consecutive windows under bounds, made once for a database and a subject.

Windows of 40 poses a second lie on smooth curves in a space where 32 principal directions
hold 95 % of the variance. Eight in a row are a parabola but for a twentieth of the distance
at which neighbours are found, so that one look at three vectors bounds eight distances. 64
directions hold 99.4 %: a window in them, at eight bits each, is one line of the processor's
cache and tells its distance well enough that few others have to be compared in full.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from numpy import ndarray

from localreg.database.block_parts import (
    BLOCK,
    DIRECTIONS,
    SKETCHED,
    Blocks,
    Sketches,
)
from localreg.database.neighbours import Metric

_BASIS_WINDOWS: Final = 20_000  # that principal directions are found from
_CHUNK: Final = 4096  # blocks at a time
_CLUSTERED: Final = 200_000  # smaller databases are scanned faster than clusters are chosen
_BLOCKS_A_CLUSTER: Final = 32
_ROUNDS: Final = 8
_LARGEST_DIGIT: Final = 127
_BEYOND: Final = 1.02  # what is drawn beyond the largest of the windows that directions are from

_TIMES: Final = (np.arange(BLOCK) - 0.5 * (BLOCK - 1)).astype(np.float32)
_BENDS: Final = _TIMES**2 - np.mean(_TIMES**2)

Tell = Callable[[int, int, str], None]


@dataclass(frozen=True, eq=False)
class BlockIndex:
    """An index of the windows of a database.

    Attributes:
        mean: of the windows, in units of the metric: past oldest first, then features.
        basis: principal directions, those of blocks first.
        blocks: what is searched.
        sketches: what is seen of each window on the way.
    """

    mean: Float[ndarray, " n"]
    basis: Float32[ndarray, "n D"]
    blocks: Blocks
    sketches: Sketches

    def arrays(self) -> dict[str, ndarray]:
        """Everything as named arrays."""
        parts = {**self.blocks._asdict(), **self.sketches._asdict()}
        return {"mean": self.mean, "basis": self.basis, **parts}

    @classmethod
    def of_arrays(cls, arrays: dict[str, ndarray]) -> "BlockIndex":
        """The index of what `arrays` gave.

        Raises:
            KeyError: an array is missing.
        """
        blocks = Blocks(*(arrays[name] for name in Blocks._fields))
        sketches = Sketches(*(arrays[name] for name in Sketches._fields))
        return cls(arrays["mean"], arrays["basis"], blocks, sketches)


def window_scale(metric: Metric, width: int) -> Float[ndarray, " n"]:
    """Weights of a window's entries: past oldest first, then features."""
    return np.concatenate([np.repeat(metric.history[::-1], width), metric.features])


def build_index(
    angles: Float32[ndarray, "N 56"],
    features: Float32[ndarray, "N f"],
    targets: Bool[ndarray, " N"],
    metric: Metric,
    tell: Tell | None = None,
) -> BlockIndex:
    """Index all windows of a database.

    Args:
        angles: joint angles of all poses [rad].
        features: their features.
        targets: rows with a whole window of predecessors.
        metric: how differences count.
        tell: is told how many blocks are done, of how many.
    """
    lags = len(metric.history)
    scale = window_scale(metric, angles.shape[1]).astype(np.float32)

    def windows(rows: Int[ndarray, "*k"]) -> Float32[ndarray, "*k n"]:
        past = angles[rows[..., None] - np.arange(lags, 0, -1)]
        whole = np.concatenate([past.reshape(*rows.shape, -1), features[rows]], axis=-1)
        return whole * scale

    rows = np.flatnonzero(targets)
    some = windows(rows[:: max(1, len(rows) // _BASIS_WINDOWS)]).astype(float)
    mean = some.mean(axis=0)
    some -= mean
    vectors = np.linalg.eigh(some.T @ some)[1][:, ::-1]
    # Short windows have fewer directions than there is room for.
    basis = np.zeros((len(vectors), SKETCHED), dtype=np.float32)
    basis[:, : len(vectors)] = vectors[:, :SKETCHED]
    unit = np.abs(some.astype(np.float32) @ basis).max(axis=0) / _LARGEST_DIGIT
    unit = np.maximum(_BEYOND * unit, 1e-12).astype(np.float32)
    sketches = Sketches(
        np.zeros((len(targets), len(unit)), np.int8), unit, np.zeros((len(targets), 2), np.float32)
    )
    first, last = _block_ends(targets)
    count = len(first)
    center = np.empty((count, DIRECTIONS), dtype=np.float32)
    tangent = np.empty((count, 2, DIRECTIONS), dtype=np.float32)
    radius, off_curve = np.empty(count, np.float32), np.empty(count, np.float32)
    beside = np.empty((count, 2), dtype=np.float32)
    for begin in range(0, count, _CHUNK):
        chunk = slice(begin, begin + _CHUNK)
        # A short block repeats its last window, which changes no bound.
        within = np.minimum(first[chunk, None] + np.arange(BLOCK), last[chunk, None])
        raw = windows(within) - mean.astype(np.float32)
        points = raw @ basis
        rest = np.linalg.norm(raw - points @ basis.T, axis=-1)
        _sketch(sketches, within, points, rest)
        rest = np.hypot(rest, np.linalg.norm(points[..., DIRECTIONS:], axis=-1))
        points = points[..., :DIRECTIONS]
        beside[chunk, 0], beside[chunk, 1] = rest.min(axis=1), rest.max(axis=1)
        center[chunk] = points.mean(axis=1)
        away = points - center[chunk, None]
        tangent[chunk, 0] = np.einsum("k,bkd->bd", _TIMES / (_TIMES @ _TIMES), away)
        tangent[chunk, 1] = np.einsum("k,bkd->bd", _BENDS / (_BENDS @ _BENDS), away)
        radius[chunk] = np.linalg.norm(away, axis=-1).max(axis=1)
        away -= (
            _TIMES[:, None] * tangent[chunk, None, 0] + _BENDS[:, None] * tangent[chunk, None, 1]
        )
        off_curve[chunk] = np.linalg.norm(away, axis=-1).max(axis=1)
        if tell is not None:
            tell(min(begin + _CHUNK, count), count, "indexing")
    present = 1 + last - first
    order, middle, begin = _clusters(center, len(rows))
    reach = np.linalg.norm(center[order] - np.repeat(middle, np.diff(begin), axis=0), axis=1)
    blocks = Blocks(
        center=center[order],
        tangent=tangent[order],
        gram=_gram(tangent[order]),
        first=first[order].astype(np.int32),
        windows=((1 << present[order]) - 1).astype(np.uint8),
        radius=radius[order],
        off_curve=off_curve[order],
        beside=beside[order],
        longest=beside[:, 1].max(keepdims=True),
        cluster_center=middle,
        cluster_radius=np.maximum.reduceat(reach + radius[order], begin[:-1]).astype(np.float32),
        cluster_begin=begin.astype(np.int32),
    )
    return BlockIndex(mean, basis, blocks, sketches)


def _sketch(
    sketches: Sketches,
    rows: Int[ndarray, "*k"],
    points: Float32[ndarray, "*k D"],
    rest: Float32[ndarray, "*k"],
) -> None:
    """Draw some windows, given in principal directions and the length of what is not in them."""
    drawn = np.rint(points / sketches.unit).clip(-_LARGEST_DIGIT, _LARGEST_DIGIT)
    sketches.digits[rows] = drawn
    sketches.off[rows, 0] = np.linalg.norm(points - drawn * sketches.unit, axis=-1)
    sketches.off[rows, 1] = rest


def _gram(tangent: Float32[ndarray, "B 2 d"]) -> Float32[ndarray, "B 3"]:
    pairs = ((0, 0), (0, 1), (1, 1))
    return np.stack(
        [np.einsum("bd,bd->b", tangent[:, one], tangent[:, other]) for one, other in pairs], axis=1
    )


def _block_ends(targets: Bool[ndarray, " N"]) -> tuple[Int[ndarray, " B"], Int[ndarray, " B"]]:
    """First and last rows of blocks that cut every run of targets in eights."""
    edges = np.diff(np.concatenate([[0], targets.astype(np.int8), [0]]))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    counts = -(-(stops - starts) // BLOCK)
    number = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    first = np.repeat(starts, counts) + BLOCK * number
    return first, np.minimum(first + BLOCK, np.repeat(stops, counts)) - 1


def _clusters(
    center: Float32[ndarray, "B d"], windows: int
) -> tuple[Int[ndarray, " B"], Float32[ndarray, "C d"], Int[ndarray, "C_and_1"]]:
    """Blocks in the order of their clusters, the clusters' means, and where they begin."""
    if windows < _CLUSTERED:
        middle = center.mean(axis=0, keepdims=True)
        return np.arange(len(center)), middle, np.array([0, len(center)])
    import faiss

    faiss.omp_set_num_threads(1)
    means: Any = faiss.Kmeans(
        center.shape[1], len(center) // _BLOCKS_A_CLUSTER,
        niter=_ROUNDS, seed=1, min_points_per_centroid=1, max_points_per_centroid=64,
    )  # fmt: skip
    means.train(center)
    member = means.index.search(center, 1)[1][:, 0]
    order = np.argsort(member, kind="stable")
    used, begin = np.unique(member[order], return_index=True)
    return order, np.ascontiguousarray(means.centroids[used]), np.append(begin, len(center))
