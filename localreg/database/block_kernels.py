"""The search among blocks of consecutive poses as machine code; see `block_search`.

A query is a point among windows, a window's neighbourhood in time a curve. Everything here
is bounds that hold whatever lies outside the principal directions, so that what is passed
over could not have been found; all arithmetic is single precision with that much slack.
"""

from math import sqrt
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float32, Int32, UInt8
from numba import njit
from numpy import ndarray

BLOCK = 8
"""Poses of a block. Twice as many are bounded twice as loosely, half as many cost more."""

_MARGIN = 1.04  # what is gathered in advance of what is expected to be near
_SLACK = 1e-4  # of what rounding may add to a squared length, as a share of it
# Sums may be reordered to fill vector registers; what is not finite stays so.
_FAST = {"contract", "reassoc", "nsz", "arcp"}


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

    center: Float32[ndarray, "B d"]
    tangent: Float32[ndarray, "B 2 d"]
    gram: Float32[ndarray, "B 3"]
    first: Int32[ndarray, " B"]
    windows: UInt8[ndarray, " B"]
    radius: Float32[ndarray, " B"]
    off_curve: Float32[ndarray, " B"]
    beside: Float32[ndarray, "B 2"]
    longest: Float32[ndarray, "1"]
    cluster_center: Float32[ndarray, "C d"]
    cluster_radius: Float32[ndarray, " C"]
    cluster_begin: Int32[ndarray, "C_and_1"]


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
        without: the recording that must not be found; -1 for none.
    """

    past: Float32[ndarray, " m56"]
    past_weight: Float32[ndarray, " m56"]
    features: Float32[ndarray, " f"]
    feature_weight: Float32[ndarray, " f"]
    point: Float32[ndarray, " d"]
    turn: Float32[ndarray, "d d"]
    beside: float
    without: int


class Scratch(NamedTuple):
    """Room that a search writes to, kept from one to the next.

    Attributes:
        apart: squared distance of every block's center.
        order: room for selections.
        probed: which clusters are looked into.
        cluster_apart: squared distance of every cluster's center.
        turned: some centers as far as they are trusted.
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
    turned: Float32[ndarray, "some d"]
    points: Int32[ndarray, " N"]
    estimates: Float32[ndarray, " N"]
    least: Float32[ndarray, " N"]
    rows: Int32[ndarray, " N"]
    squared: Float32[ndarray, " N"]


@njit(cache=True)
@no_type_check
def nth_smallest(values, count, n):
    """The n-th smallest (from 0) of the first `count` values, which are moved about."""
    low, high = 0, count - 1
    while low < high:
        middle = (low + high) // 2
        if values[middle] < values[low]:
            values[middle], values[low] = values[low], values[middle]
        if values[high] < values[low]:
            values[high], values[low] = values[low], values[high]
        if values[high] < values[middle]:
            values[high], values[middle] = values[middle], values[high]
        pivot = values[middle]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if n <= j:
            high = j
        elif n >= i:
            low = i
        else:
            break
    return values[n]


@njit(cache=True, fastmath=_FAST, inline="always")
@no_type_check
def _difference(values, wanted, weights):
    total = np.float32(0.0)
    for i in range(len(wanted)):
        away = values[i] - wanted[i]
        total += weights[i] * away * away
    return total


@njit(cache=True, fastmath=_FAST, inline="always")
@no_type_check
def window_distance(poses, row, target):
    """The squared distance of one window, by the metric itself."""
    width = poses.angles.shape[1]
    begin = row * width - len(target.past)
    past = poses.angles.reshape(-1)[begin : row * width]
    return _difference(past, target.past, target.past_weight) + _difference(
        poses.features[row], target.features, target.feature_weight
    )


@njit(cache=True, fastmath=_FAST)
@no_type_check
def all_distances(poses, target, out):
    """Write the squared distance of every pose that may be found, infinity for the others."""
    for row in range(len(out)):
        out[row] = window_distance(poses, row, target) if poses.kept[row] else np.inf


@njit(cache=True, fastmath=_FAST, inline="always")
@no_type_check
def _apart(one, other):
    total = np.float32(0.0)
    for i in range(len(one)):
        away = one[i] - other[i]
        total += away * away
    return total


@njit(cache=True, fastmath=_FAST, inline="always")
@no_type_check
def _along_curve(cc, cs, cb, ss, sb, bb, out):
    """Write the squared distances of a point to the 8 points of a curve; returns their least.

    The arguments are the inner products of c, from the center to the point, and of the
    curve's slope s and bend b.
    """
    least = np.float32(np.inf)
    for k in range(BLOCK):
        t = np.float32(k - 3.5)
        u = t * t - np.float32(5.25)
        squared = cc + t * t * ss + u * u * bb + np.float32(2.0) * (t * u * sb - t * cs - u * cb)
        out[k] = max(squared, np.float32(0.0))
        least = min(least, out[k])
    return least


@njit(cache=True, fastmath=_FAST, inline="always")
@no_type_check
def _reach(target, limit, low, high):
    """How far a window within `limit` can be in principal directions; negative if nowhere.

    `low` and `high` bound the length of what of it lies outside them.
    """
    if len(target.turn):
        # |T(z - q)| >= |what is turned| - |what is not|, the latter never longer than before.
        most = sqrt(limit) + high
        return most * most - target.beside * target.beside
    gap = max(low - target.beside, target.beside - high, 0.0)
    return limit - gap * gap


@njit(cache=True, fastmath=_FAST, inline="always")
@no_type_check
def _measure(centers, target, begin, end, scratch, out):
    """Write the squared distances of some centers."""
    if len(target.turn) == 0:
        for i in range(begin, end):
            out[i] = _apart(target.point, centers[i])
    else:
        room = scratch.turned
        for start in range(begin, end, len(room)):
            stop = min(start + len(room), end)
            # One matrix product for many is five times as fast as many for one.
            np.dot(centers[start:stop], target.turn, room[: stop - start])
            for i in range(start, stop):
                out[i] = _apart(target.point, room[i - start])


@njit(cache=True, fastmath=_FAST, inline="always")
@no_type_check
def _curve_of(blocks, target, block, apart, turned, squared):
    """Squared distances of the windows of one block, as its curve has them."""
    cs = cb = ss = sb = bb = np.float32(0.0)
    # Not by views of rows, even on a path not taken: counting who holds them costs eight
    # times all the rest.
    if len(target.turn):
        turned[:] = 0.0
        for k in range(len(target.point)):
            center = blocks.center[block, k]
            slope, bend = blocks.tangent[block, 0, k], blocks.tangent[block, 1, k]
            for i in range(len(target.point)):
                turned[0, i] += target.turn[k, i] * center
                turned[1, i] += target.turn[k, i] * slope
                turned[2, i] += target.turn[k, i] * bend
        for i in range(len(target.point)):
            away = target.point[i] - turned[0, i]
            slope, bend = turned[1, i], turned[2, i]
            cs += away * slope
            cb += away * bend
            ss += slope * slope
            sb += slope * bend
            bb += bend * bend
    else:
        for i in range(len(target.point)):
            away = target.point[i] - blocks.center[block, i]
            cs += away * blocks.tangent[block, 0, i]
            cb += away * blocks.tangent[block, 1, i]
        ss, sb, bb = blocks.gram[block, 0], blocks.gram[block, 1], blocks.gram[block, 2]
    return _along_curve(apart, cs, cb, ss, sb, bb, squared)


@njit(cache=True, fastmath=_FAST)
@no_type_check
def _choose_clusters(blocks, target, probes, first, scratch):
    """Mark the clusters to look into: 2 at once, 1 perhaps; they get 3 once measured."""
    count = len(blocks.cluster_center)
    _measure(blocks.cluster_center, target, 0, count, scratch, scratch.cluster_apart)
    scratch.order[:count] = scratch.cluster_apart
    last = nth_smallest(scratch.order, count, min(probes, count) - 1)
    near = np.float32(-1.0)
    if first:
        near = nth_smallest(scratch.order, min(probes, count), min(first, probes, count) - 1)
    for cluster in range(count):
        apart = scratch.cluster_apart[cluster]
        scratch.probed[cluster] = 2 if apart <= near else (1 if apart <= last else 0)


@njit(cache=True, fastmath=_FAST, inline="always")
@no_type_check
def _may(poses, row, target):
    return poses.kept[row] and poses.groups[row] != target.without


@njit(cache=True, fastmath=_FAST)
@no_type_check
def _expected_limit(blocks, poses, target, wanted, scratch, turned, squared):
    """About the squared distance of the last of `wanted` windows; infinite if there are fewer.

    Taken from the nearest blocks of the clusters that are looked into at once.
    """
    measured = 0
    for cluster in range(len(blocks.cluster_center)):
        if scratch.probed[cluster] == 3:
            for block in range(blocks.cluster_begin[cluster], blocks.cluster_begin[cluster + 1]):
                scratch.order[measured] = scratch.apart[block]
                measured += 1
    share = min(2 * wanted // BLOCK + 1, measured)
    while True:
        limit = nth_smallest(scratch.order, measured, share - 1)
        count = 0
        for cluster in range(len(blocks.cluster_center)):
            if scratch.probed[cluster] != 3:
                continue
            for block in range(blocks.cluster_begin[cluster], blocks.cluster_begin[cluster + 1]):
                if scratch.apart[block] > limit:
                    continue
                _curve_of(blocks, target, block, scratch.apart[block], turned, squared)
                beside = _beside(blocks, block)
                windows = blocks.windows[block]
                for k in range(BLOCK):
                    if windows >> k & 1 and _may(poses, blocks.first[block] + k, target):
                        scratch.estimates[count] = squared[k] + beside
                        count += 1
        if count >= wanted:
            beside = np.float32(target.beside * target.beside)
            return nth_smallest(scratch.estimates, count, wanted - 1) + beside
        if share == measured:
            return np.float32(np.inf)
        share = min(2 * share, measured)


@njit(cache=True, fastmath=_FAST, inline="always")
@no_type_check
def _beside(blocks, block):
    """About the squared length of what lies outside the principal directions."""
    middle = np.float32(0.5) * (blocks.beside[block, 0] + blocks.beside[block, 1])
    return middle * middle


@njit(cache=True, fastmath=_FAST, inline="always")
@no_type_check
def _gather(blocks, poses, target, begin, end, limit, farthest, scratch, count, turned, squared):
    """Append the windows of some blocks that may be within a limit; returns how many there are."""
    for block in range(begin, end):
        ball = farthest + blocks.radius[block]
        if scratch.apart[block] > ball * ball:
            continue
        reach = _reach(target, limit, blocks.beside[block, 0], blocks.beside[block, 1])
        reach += np.float32(_SLACK) * (scratch.apart[block] + limit)
        if reach < 0.0:
            continue
        reach = np.float32(sqrt(reach))
        ball = reach + blocks.radius[block]
        if scratch.apart[block] > ball * ball:
            continue
        tube = reach + blocks.off_curve[block]
        tube *= tube
        if _curve_of(blocks, target, block, scratch.apart[block], turned, squared) > tube:
            continue
        beside = _beside(blocks, block)
        windows = blocks.windows[block]
        for k in range(BLOCK):
            row = blocks.first[block] + k
            if squared[k] <= tube and windows >> k & 1 and _may(poses, row, target):
                scratch.points[count] = row
                scratch.estimates[count] = squared[k] + beside
                scratch.least[count] = _least(
                    target, squared[k], blocks.off_curve[block],
                    blocks.beside[block, 0], blocks.beside[block, 1],
                )  # fmt: skip
                count += 1
    return count


@njit(cache=True, fastmath=_FAST, inline="always")
@no_type_check
def _least(target, squared, off_curve, low, high):
    """What the squared distance of a window is at least; the inverse of `_reach`."""
    away = max(np.float32(sqrt(squared)) - off_curve, np.float32(0.0))
    if len(target.turn):
        away = sqrt(away * away + target.beside * target.beside) - high
        return max(away, 0.0) * away
    gap = max(low - target.beside, target.beside - high, 0.0)
    return away * away + gap * gap


@njit(cache=True, fastmath=_FAST)
@no_type_check
def _gather_all(blocks, poses, target, limit, scratch, turned, squared):
    """Write the windows that may be within a limit to `points`; returns how many there are."""
    # A first look, the same for all blocks: no root is taken of those that are far.
    farthest = _reach(target, limit, target.beside, blocks.longest[0])
    farthest = np.float32(sqrt(max(farthest, 0.0))) * np.float32(1.0 + _SLACK)
    count = 0
    for cluster in range(len(blocks.cluster_center)):
        if scratch.probed[cluster] == 0:
            continue
        begin, end = blocks.cluster_begin[cluster], blocks.cluster_begin[cluster + 1]
        if scratch.probed[cluster] != 3:
            ball = farthest + blocks.cluster_radius[cluster]
            if scratch.cluster_apart[cluster] > ball * ball:
                continue
            scratch.probed[cluster] = 3
            _measure(blocks.center, target, begin, end, scratch, scratch.apart)
        count = _gather(
            blocks, poses, target, begin, end, limit, farthest, scratch, count, turned, squared
        )
    return count


@njit(cache=True, fastmath=_FAST)
@no_type_check
def _compare(poses, target, count, wanted, scratch):
    """Write the gathered windows that may be among the nearest to `rows` and `squared`.

    Returns:
        How many, and a squared distance that at least `wanted` windows keep to.
    """
    for i in range(count):
        scratch.order[i] = scratch.estimates[i]
    middle = nth_smallest(scratch.order, count, wanted - 1)
    limit, found = np.float32(0.0), 0
    for i in range(count):
        if scratch.estimates[i] <= middle:
            row = scratch.points[i]
            scratch.rows[found] = row
            scratch.squared[found] = window_distance(poses, row, target)
            limit = max(limit, scratch.squared[found])
            found += 1
    within = limit * np.float32(1.0 + _SLACK) + np.float32(_SLACK)
    for i in range(count):
        if scratch.estimates[i] > middle and scratch.least[i] <= within:
            row = scratch.points[i]
            distance = window_distance(poses, row, target)
            if distance <= limit:
                scratch.rows[found] = row
                scratch.squared[found] = distance
                found += 1
    return found, limit


@njit(cache=True, fastmath=_FAST)
@no_type_check
def search_blocks(blocks, poses, target, wanted, probes, first, guess, scratch):
    """Write the windows that may be among the nearest to `rows` and `squared`; how many.

    Of the clusters that are probed, no nearer window is missing.

    Args:
        blocks: the index.
        poses: what it is of.
        target: the query.
        wanted: how many windows are sought; not more than may be found.
        probes: how many clusters are looked into, the nearest ones.
        first: how many of them a first limit is taken from.
        guess: what the squared distance of the last one may be; 0 if nobody knows. It
            changes the time, not the answer.
        scratch: room.
    """
    turned = np.empty((3, len(target.point)), dtype=np.float32)
    squared = np.empty(BLOCK, dtype=np.float32)
    # With a guess no cluster has to be looked into for a first limit.
    _choose_clusters(blocks, target, probes, 0 if guess > 0.0 else first, scratch)
    limit, expected = np.float32(guess), False
    while True:
        if not expected and limit == 0.0:
            if guess > 0.0:
                _choose_clusters(blocks, target, probes, first, scratch)
            for cluster in range(len(blocks.cluster_center)):
                if scratch.probed[cluster] == 2:
                    begin, end = blocks.cluster_begin[cluster], blocks.cluster_begin[cluster + 1]
                    _measure(blocks.center, target, begin, end, scratch, scratch.apart)
                    scratch.probed[cluster] = 3
            limit = _expected_limit(blocks, poses, target, wanted, scratch, turned, squared)
            limit *= np.float32(_MARGIN)
            expected = True
        count = _gather_all(blocks, poses, target, limit, scratch, turned, squared)
        if count >= wanted:
            found, known = _compare(poses, target, count, wanted, scratch)
            if known <= limit:
                return found
            limit = known
        elif not expected:
            limit = np.float32(0.0)
        elif limit < np.inf:
            limit = np.float32(np.inf)
        else:
            # Too few in these clusters may be found: look into all.
            scratch.probed[:] = np.maximum(scratch.probed, 1)
