"""What an index of consecutive poses is made of, and what a search in it writes to.

A query is a point among windows, a window's neighbourhood in time a curve: see `block_search`.
"""

from typing import NamedTuple

from jaxtyping import Bool, Float32, Int8, Int32, UInt8
from numpy import ndarray

BLOCK = 8
"""Poses of a block. Twice as many are bounded twice as loosely, half as many cost more."""

# Loops of a length that the compiler knows are eight times as fast.
DIRECTIONS = 32
"""Principal directions of blocks. With fewer, bounds are loose; more cost more to compare."""

SKETCHED = 64
"""Principal directions of windows."""

SOME = 256
"""Blocks or windows at a time: their turned vectors stay in the cache."""


class Blocks(NamedTuple):
    """Blocks of consecutive windows in principal directions, clusters one after another.

    Window k of a block, t = k - 3.5, lies within `off_curve` of
    `center + t tangent[0] + (t^2 - 5.25) tangent[1]`.

    Attributes:
        center: means.
        tangent: slopes and bends.
        gram: of each slope its square, its product with the bend, and the bend's square.
        first: row of the first window.
        windows: which of the 8 are windows, one bit each.
        radius: of the ball about the center that holds them.
        off_curve: largest distance from the curve.
        beside: least and greatest length of what lies outside the principal directions.
        longest: the greatest of these, alone.
        cluster_center: means of the clusters' centers.
        cluster_radius: of balls that hold their windows.
        cluster_begin: first block of every cluster, and the end.
    """

    center: Float32[ndarray, "B 32"]
    tangent: Float32[ndarray, "B 2 32"]
    gram: Float32[ndarray, "B 3"]
    first: Int32[ndarray, " B"]
    windows: UInt8[ndarray, " B"]
    radius: Float32[ndarray, " B"]
    off_curve: Float32[ndarray, " B"]
    beside: Float32[ndarray, "B 2"]
    longest: Float32[ndarray, "1"]
    cluster_center: Float32[ndarray, "C 32"]
    cluster_radius: Float32[ndarray, " C"]
    cluster_begin: Int32[ndarray, "C_and_1"]


class Sketches(NamedTuple):
    """Every window in eight bits a direction, in more directions than blocks have.

    Attributes:
        digits: along the principal directions; rows that are no windows are not used.
        unit: what one is worth in each direction.
        off: how far a sketch is from its window along the principal directions, and the
            length of what lies outside them.
    """

    digits: Int8[ndarray, "N 64"]
    unit: Float32[ndarray, "64"]
    off: Float32[ndarray, "N 2"]


class Poses(NamedTuple):
    """What distances are taken of.

    Attributes:
        angles: joint angles of all poses [rad].
        features: their features.
        kept: which poses may be found.
        groups: recordings that they belong to.
    """

    angles: Float32[ndarray, "N 56"]
    features: Float32[ndarray, "N f"]
    kept: Bool[ndarray, " N"]
    groups: Int32[ndarray, " N"]


class Target(NamedTuple):
    """A query as the kernels take it.

    Attributes:
        past: joint angles, oldest first, one after another [rad].
        past_weight: squared weights of their differences.
        features: features of the present trackers.
        feature_weight: squared weights of their differences, trust included.
        point: the query in principal directions, turned as the blocks are to be.
        turn: what turns principal directions into what is trusted of them; empty if all is.
        beside: length of what lies outside them.
        fine_point, fine_turn, fine_beside: the same in the directions of sketches, which
            begin with those of blocks.
        without: the recording that must not be found; -1 for none.
        is_strict: whether no neighbour may be missing.
    """

    past: Float32[ndarray, " m56"]
    past_weight: Float32[ndarray, " m56"]
    features: Float32[ndarray, " f"]
    feature_weight: Float32[ndarray, " f"]
    point: Float32[ndarray, "32"]
    turn: Float32[ndarray, "d d"]
    beside: float
    fine_point: Float32[ndarray, "64"]
    fine_turn: Float32[ndarray, "D D"]
    fine_beside: float
    without: int
    is_strict: bool


class Scratch(NamedTuple):
    """Room that a search writes to, kept from one to the next.

    Attributes:
        apart: squared distance of every block's center.
        order: room for selections.
        probed: which clusters are looked into.
        cluster_apart: squared distance of every cluster's center.
        held: blocks that may hold a neighbour.
        curves: their centers, slopes and bends, some at a time.
        turned: the same, or some centers, as far as they are trusted.
        products: of each curve what `along_curve` takes.
        drawn, fine_turned: some sketches, and as far as they are trusted.
        known: a table of rows that need not be gathered.
        points: rows that may be near.
        estimates: about their squared distances.
        least: bounds of them from below.
        rows: rows whose distance is known.
        squared: their squared distances.
    """

    apart: Float32[ndarray, " B"]
    order: Float32[ndarray, " most"]
    probed: UInt8[ndarray, " C"]
    cluster_apart: Float32[ndarray, " C"]
    held: Int32[ndarray, " B"]
    curves: Float32[ndarray, "3_some 32"]
    turned: Float32[ndarray, "3_some 32"]
    products: Float32[ndarray, "some 5"]
    drawn: Float32[ndarray, "some 64"]
    fine_turned: Float32[ndarray, "some 64"]
    known: Int32[ndarray, " power_of_two"]
    points: Int32[ndarray, " N"]
    estimates: Float32[ndarray, " N"]
    least: Float32[ndarray, " N"]
    rows: Int32[ndarray, " N"]
    squared: Float32[ndarray, " N"]
