"""The search among blocks of consecutive poses as machine code; see `block_search`.

Blocks that hold a neighbour are found by their curves, windows of them by their sketches, and
only what is left is compared by the metric itself, which reads fifteen times as much memory.
"""

from math import sqrt
from typing import no_type_check

import numpy as np
from numba import njit

from localreg.database.block_distances import (
    FAST,
    SLACK,
    along_curve,
    inner_products,
    least_distance,
    measure_centers,
    measure_sketches,
    reach_within,
    window_distance,
)
from localreg.database.block_parts import BLOCK, SOME

_MARGIN = 1.04  # what is gathered in advance of what is expected to be near
_FIRST_COMPARED = 1.1  # times as many as are wanted give the limit for the others
_RANKED = 1000  # clusters whose distances are put in order


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


@njit(cache=True, fastmath=FAST)
@no_type_check
def _choose_clusters(blocks, target, probes, first, scratch):
    """Mark the clusters to look into: 2 at once, 1 perhaps; they get 3 once measured."""
    apart, order, probed = scratch.cluster_apart, scratch.order, scratch.probed
    count = len(apart)
    measure_centers(blocks.cluster_center, target, 0, count, scratch, apart)
    # Clusters are in no order: some of them tell about how far that many are.
    stride = 1 + count // _RANKED
    some = 0
    for cluster in range(0, count, stride):
        order[some] = apart[cluster]
        some += 1
    last, near = np.float32(np.inf), np.float32(-1.0)
    if probes < count:
        last = nth_smallest(order, some, -(-probes // stride) - 1)
    if first:
        near = min(nth_smallest(order, some, min(-(-first // stride), some) - 1), last)
    for cluster in range(count):
        distance = apart[cluster]
        probed[cluster] = 2 if distance <= near else (1 if distance <= last else 0)


@njit(cache=True, fastmath=FAST, inline="always")
@no_type_check
def _may(poses, row, target):
    return poses.kept[row] and poses.groups[row] != target.without


@njit(cache=True, fastmath=FAST)
@no_type_check
def _expected_limit(blocks, poses, target, wanted, scratch):
    """About the squared distance of the last of `wanted` windows; infinite if there are fewer.

    Taken from the nearest blocks of the clusters that are looked into at once.
    """
    squared = np.empty(BLOCK, dtype=np.float32)
    measured = 0
    for cluster in range(len(blocks.cluster_center)):
        if scratch.probed[cluster] == 3:
            for block in range(blocks.cluster_begin[cluster], blocks.cluster_begin[cluster + 1]):
                scratch.order[measured] = scratch.apart[block]
                measured += 1
    share = min(2 * wanted // BLOCK + 1, measured)
    while True:
        limit = nth_smallest(scratch.order, measured, share - 1)
        held = 0
        for cluster in range(len(blocks.cluster_center)):
            if scratch.probed[cluster] != 3:
                continue
            for block in range(blocks.cluster_begin[cluster], blocks.cluster_begin[cluster + 1]):
                if scratch.apart[block] <= limit:
                    scratch.held[held] = block
                    held += 1
        count = 0
        for begin in range(0, held, SOME):
            end = min(begin + SOME, held)
            inner_products(blocks, target, begin, end, scratch)
            for n in range(begin, end):
                block = scratch.held[n]
                along_curve(scratch.apart[block], scratch.products, n - begin, squared)
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


@njit(cache=True, fastmath=FAST, inline="always")
@no_type_check
def _beside(blocks, block):
    """About the squared length of what lies outside the principal directions."""
    middle = np.float32(0.5) * (blocks.beside[block, 0] + blocks.beside[block, 1])
    return middle * middle


@njit(cache=True, inline="always")
@no_type_check
def _is_known(known, row):
    """Whether a row is in an open hash table."""
    place = row & len(known) - 1
    while known[place] != -1:
        if known[place] == row:
            return True
        place = place + 1 & len(known) - 1
    return False


@njit(cache=True, fastmath=FAST)
@no_type_check
def _follow(hints, poses, target, scratch):
    """Begin `points` with the poses after some; returns how many there are."""
    count = 0
    for hint in hints:
        row = hint + 1
        if row < len(poses.kept) and _may(poses, row, target) and not _is_known(scratch.known, row):
            place = row & len(scratch.known) - 1
            while scratch.known[place] != -1:
                place = place + 1 & len(scratch.known) - 1
            scratch.known[place] = row
            scratch.points[count] = row
            count += 1
    return count


@njit(cache=True, fastmath=FAST)
@no_type_check
def _hold(blocks, target, limit, scratch):
    """Write the blocks whose balls are within a limit to `held`; returns how many there are."""
    apart, radius, beside, held = scratch.apart, blocks.radius, blocks.beside, scratch.held
    probed, cluster_begin = scratch.probed, blocks.cluster_begin
    is_turned, outside = len(target.turn) > 0, np.float32(target.beside)
    slack = np.float32(SLACK)
    # A first look, the same for all blocks: no root is taken of those that are far.
    farthest = reach_within(is_turned, target.is_strict, outside, limit, outside, blocks.longest[0])
    farthest = np.float32(sqrt(max(farthest, np.float32(0.0)))) * (np.float32(1.0) + slack)
    count = 0
    for cluster in range(len(probed)):
        if probed[cluster] == 0:
            continue
        begin, end = cluster_begin[cluster], cluster_begin[cluster + 1]
        if probed[cluster] != 3:
            ball = farthest + blocks.cluster_radius[cluster]
            if scratch.cluster_apart[cluster] > ball * ball:
                continue
            probed[cluster] = 3
            measure_centers(blocks.center, target, begin, end, scratch, apart)
        for block in range(begin, end):
            ball = farthest + radius[block]
            if apart[block] > ball * ball:
                continue
            reach = reach_within(
                is_turned, target.is_strict, outside, limit, beside[block, 0], beside[block, 1]
            )
            reach += slack * (apart[block] + limit)
            if reach < np.float32(0.0):
                continue
            ball = np.float32(sqrt(reach)) + radius[block]
            if apart[block] <= ball * ball:
                held[count] = block
                count += 1
    return count


@njit(cache=True, fastmath=FAST)
@no_type_check
def _gather(blocks, poses, target, limit, hinted, scratch):
    """Append to `points` the windows that may be within a limit; returns how many there are.

    The first `hinted` are there already.
    """
    apart, beside, held, off_curve = scratch.apart, blocks.beside, scratch.held, blocks.off_curve
    windows, first, points, known = blocks.windows, blocks.first, scratch.points, scratch.known
    products, kept, groups = scratch.products, poses.kept, poses.groups
    is_turned, outside = len(target.turn) > 0, np.float32(target.beside)
    squared = np.empty(BLOCK, dtype=np.float32)
    holding, count = _hold(blocks, target, limit, scratch), hinted
    for begin in range(0, holding, SOME):
        end = min(begin + SOME, holding)
        inner_products(blocks, target, begin, end, scratch)
        for n in range(begin, end):
            block = held[n]
            reach = reach_within(
                is_turned, target.is_strict, outside, limit, beside[block, 0], beside[block, 1]
            )
            reach += np.float32(SLACK) * (apart[block] + limit)
            tube = np.float32(sqrt(reach)) + off_curve[block]
            tube *= tube
            if along_curve(apart[block], products, n - begin, squared) > tube:
                continue
            for k in range(BLOCK):
                row = first[block] + k
                if squared[k] > tube or not windows[block] >> k & 1 or not kept[row]:
                    continue
                if groups[row] == target.without or (hinted and _is_known(known, row)):
                    continue
                points[count] = row
                count += 1
    return count


@njit(cache=True, fastmath=FAST)
@no_type_check
def _compare(sketches, poses, target, count, wanted, scratch):
    """Write the gathered windows that may be among the nearest to `rows` and `squared`.

    Returns:
        How many, and the squared distance of the last one wanted.
    """
    measure_sketches(sketches, target, count, scratch)
    for i in range(count):
        off = sketches.off[scratch.points[i]]
        least, about = least_distance(target, scratch.estimates[i], off[0], off[1])
        scratch.least[i], scratch.estimates[i], scratch.order[i] = least, about, about
    some = min(int(_FIRST_COMPARED * wanted), count)
    middle = nth_smallest(scratch.order, count, some - 1)
    found = 0
    for i in range(count):
        if scratch.estimates[i] <= middle:
            row = scratch.points[i]
            scratch.rows[found] = row
            scratch.squared[found] = window_distance(poses, row, target)
            scratch.order[found] = scratch.squared[found]
            found += 1
    limit = nth_smallest(scratch.order, found, wanted - 1)
    within = limit * np.float32(1.0 + SLACK) + np.float32(SLACK)
    for i in range(count):
        if scratch.estimates[i] > middle and scratch.least[i] <= within:
            row = scratch.points[i]
            distance = window_distance(poses, row, target)
            if distance <= limit:
                scratch.rows[found] = row
                scratch.squared[found] = distance
                found += 1
    for i in range(found):
        scratch.order[i] = scratch.squared[i]
    return found, nth_smallest(scratch.order, found, wanted - 1)


@njit(cache=True)
@no_type_check
def _sorted(scratch, found, wanted):
    """The nearest of what has been found: rows, and squared distances."""
    order = np.argsort(scratch.squared[:found])
    rows, squared = np.empty(wanted, np.int64), np.empty(wanted)
    for n in range(wanted):
        rows[n], squared[n] = scratch.rows[order[n]], scratch.squared[order[n]]
    return rows, squared


@njit(cache=True, fastmath=FAST)
@no_type_check
def search_blocks(blocks, sketches, poses, target, wanted, probes, first, guess, hints, scratch):
    """The nearest windows, in order: their rows and squared distances.

    Of the clusters that are probed, no nearer window is missing.

    Args:
        blocks: the index.
        sketches: of the same windows.
        poses: what they are of.
        target: the query.
        wanted: how many windows are sought; not more than may be found.
        probes: how many clusters are looked into, the nearest ones.
        first: how many of them a first limit is taken from.
        guess: what the squared distance of the last one may be; 0 if nobody knows. It
            changes the time, not the answer.
        hints: rows whose successors are looked at wherever they are.
        scratch: room.
    """
    # With a guess no cluster has to be looked into for a first limit.
    _choose_clusters(blocks, target, probes, 0 if guess > 0.0 else first, scratch)
    limit, expected = np.float32(guess), False
    scratch.known[:] = -1
    hinted = _follow(hints, poses, target, scratch)
    while True:
        if not expected and limit == 0.0:
            if guess > 0.0:
                _choose_clusters(blocks, target, probes, first, scratch)
            for cluster in range(len(blocks.cluster_center)):
                if scratch.probed[cluster] == 2:
                    begin, end = blocks.cluster_begin[cluster], blocks.cluster_begin[cluster + 1]
                    measure_centers(blocks.center, target, begin, end, scratch, scratch.apart)
                    scratch.probed[cluster] = 3
            limit = _expected_limit(blocks, poses, target, wanted, scratch)
            limit *= np.float32(_MARGIN)
            expected = True
        count = _gather(blocks, poses, target, limit, hinted, scratch)
        if count >= wanted:
            found, known = _compare(sketches, poses, target, count, wanted, scratch)
            if known <= limit:
                return _sorted(scratch, found, wanted)
            limit = known
        elif not expected:
            limit = np.float32(0.0)
        elif limit < np.inf:
            limit = np.float32(np.inf)
        else:
            # Too few in these clusters may be found: look into all.
            scratch.probed[:] = np.maximum(scratch.probed, 1)
