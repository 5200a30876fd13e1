"""The search among blocks of consecutive poses as machine code; see `block_search`.

A query is a point among windows, a window's neighbourhood in time a curve. Blocks that hold a
neighbour are found by their curves, windows of them by their sketches, and only what is left
is compared by the metric itself, which reads fifteen times as much memory. Everything here is
bounds that hold whatever lies outside the principal directions, so that what is passed over
could not have been found; all arithmetic is single precision with that much slack.
"""

from math import sqrt
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float32, Int8, Int32, UInt8
from numba import njit
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

_MARGIN = 1.04  # what is gathered in advance of what is expected to be near
_FIRST_COMPARED = 1.1  # times as many as are wanted give the limit for the others
_RANKED = 1000  # clusters whose distances are put in order
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
        products: of each curve what `_along_curve` takes.
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


@njit(cache=True)
@no_type_check
def look_from(history, features, scale, mean, basis):
    """A query as a window among others.

    Returns:
        The window, what it is away from the mean in units of the metric, that along the
        principal directions, and the lengths of what of it lies outside those of blocks and
        outside all.
    """
    lags, width = history.shape
    past = lags * width
    raw, away = np.empty(len(scale), np.float32), np.empty(len(scale))
    for n in range(past):
        away[n] = history[lags - 1 - n // width, n % width]
    away[past:] = features
    length = 0.0
    for n in range(len(scale)):
        raw[n] = away[n]
        away[n] = scale[n] * away[n] - mean[n]
        length += away[n] * away[n]
    point = np.dot(away.astype(np.float32), basis)
    beside = fine_beside = length
    for k in range(SKETCHED):
        square = np.float64(point[k]) ** 2
        fine_beside -= square
        if k < DIRECTIONS:
            beside -= square
    return raw, away, point, sqrt(max(beside, 0.0)), sqrt(max(fine_beside, 0.0))


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
def _apart(point, rows, row):
    """The squared distance of a point to a row."""
    total = np.float32(0.0)
    for i in range(len(point)):
        away = point[i] - rows[row, i]
        total += away * away
    return total


@njit(cache=True, fastmath=_FAST, inline="always")
@no_type_check
def _along_curve(cc, products, n, out):
    """Write the squared distances of a point to the 8 points of a curve; returns their least.

    Args:
        cc: squared distance of the point to the curve's center.
        products: of the vector to the point with slope s and bend b; s s, s b and b b.
        n: which row of them. Not by a view: counting who holds it costs more than all else.
        out: written.
    """
    cs, cb = products[n, 0], products[n, 1]
    ss, sb, bb = products[n, 2], products[n, 3], products[n, 4]
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
def _reach(is_turned, is_strict, outside, limit, low, high):
    """How far a window within `limit` can be in principal directions, squared; less if nowhere.

    Args:
        is_turned: whether directions are as far as they are trusted.
        is_strict: whether that is a bound, which is loose for turned directions, or likely.
        outside: length of what of the query lies outside them.
        limit: a squared distance.
        low: least length of what of the window lies outside them.
        high: the greatest.
    """
    if is_turned:
        if not is_strict:
            return limit
        # |T(z - q)| >= |what is turned| - |what is not|, the latter never longer than before.
        most = np.float32(sqrt(limit)) + high
        return most * most - outside * outside
    gap = max(low - outside, outside - high, np.float32(0.0))
    return limit - gap * gap


@njit(cache=True, fastmath=_FAST, inline="always")
@no_type_check
def _measure(centers, target, begin, end, scratch, out):
    """Write the squared distances of some centers."""
    point = target.point
    if len(target.turn) == 0:
        for i in range(begin, end):
            out[i] = _apart(point, centers, i)
    else:
        room = scratch.turned
        for start in range(begin, end, SOME):
            stop = min(start + SOME, end)
            # One matrix product for many is five times as fast as many for one.
            np.dot(centers[start:stop], target.turn, room[: stop - start])
            for i in range(start, stop):
                out[i] = _apart(point, room, i - start)


@njit(cache=True, fastmath=_FAST)
@no_type_check
def _inner_products(blocks, target, begin, end, scratch):
    """Write to `products` what `_along_curve` takes of the held blocks from one to another."""
    point, center, tangent, gram = target.point, blocks.center, blocks.tangent, blocks.gram
    held, products = scratch.held, scratch.products
    if len(target.turn) == 0:
        for n in range(begin, end):
            block, cs, cb = held[n], np.float32(0.0), np.float32(0.0)
            for i in range(DIRECTIONS):
                away = point[i] - center[block, i]
                cs += away * tangent[block, 0, i]
                cb += away * tangent[block, 1, i]
            products[n - begin, 0], products[n - begin, 1] = cs, cb
            for k in range(3):
                products[n - begin, 2 + k] = gram[block, k]
        return
    curves, turned = scratch.curves, scratch.turned
    for n in range(begin, end):
        block, row = held[n], 3 * (n - begin)
        for i in range(DIRECTIONS):
            curves[row, i] = center[block, i]
            curves[row + 1, i] = tangent[block, 0, i]
            curves[row + 2, i] = tangent[block, 1, i]
    rows = 3 * (end - begin)
    np.dot(curves[:rows], target.turn, turned[:rows])
    for n in range(end - begin):
        cs = cb = ss = sb = bb = np.float32(0.0)
        for i in range(DIRECTIONS):
            away = point[i] - turned[3 * n, i]
            slope, bend = turned[3 * n + 1, i], turned[3 * n + 2, i]
            cs += away * slope
            cb += away * bend
            ss += slope * slope
            sb += slope * bend
            bb += bend * bend
        products[n, 0], products[n, 1] = cs, cb
        products[n, 2], products[n, 3], products[n, 4] = ss, sb, bb


@njit(cache=True, fastmath=_FAST)
@no_type_check
def _choose_clusters(blocks, target, probes, first, scratch):
    """Mark the clusters to look into: 2 at once, 1 perhaps; they get 3 once measured."""
    apart, order, probed = scratch.cluster_apart, scratch.order, scratch.probed
    count = len(apart)
    _measure(blocks.cluster_center, target, 0, count, scratch, apart)
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


@njit(cache=True, fastmath=_FAST, inline="always")
@no_type_check
def _may(poses, row, target):
    return poses.kept[row] and poses.groups[row] != target.without


@njit(cache=True, fastmath=_FAST)
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
            _inner_products(blocks, target, begin, end, scratch)
            for n in range(begin, end):
                block = scratch.held[n]
                _along_curve(scratch.apart[block], scratch.products, n - begin, squared)
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


@njit(cache=True, fastmath=_FAST)
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


@njit(cache=True, fastmath=_FAST)
@no_type_check
def _hold(blocks, target, limit, scratch):
    """Write the blocks whose balls are within a limit to `held`; returns how many there are."""
    apart, radius, beside, held = scratch.apart, blocks.radius, blocks.beside, scratch.held
    probed, cluster_begin = scratch.probed, blocks.cluster_begin
    is_turned, outside = len(target.turn) > 0, np.float32(target.beside)
    slack = np.float32(_SLACK)
    # A first look, the same for all blocks: no root is taken of those that are far.
    farthest = _reach(is_turned, target.is_strict, outside, limit, outside, blocks.longest[0])
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
            _measure(blocks.center, target, begin, end, scratch, apart)
        for block in range(begin, end):
            ball = farthest + radius[block]
            if apart[block] > ball * ball:
                continue
            reach = _reach(
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


@njit(cache=True, fastmath=_FAST)
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
        _inner_products(blocks, target, begin, end, scratch)
        for n in range(begin, end):
            block = held[n]
            reach = _reach(
                is_turned, target.is_strict, outside, limit, beside[block, 0], beside[block, 1]
            )
            reach += np.float32(_SLACK) * (apart[block] + limit)
            tube = np.float32(sqrt(reach)) + off_curve[block]
            tube *= tube
            if _along_curve(apart[block], products, n - begin, squared) > tube:
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


@njit(cache=True, fastmath=_FAST)
@no_type_check
def _sketched(sketches, target, count, scratch):
    """Write about the squared distances of the gathered windows, by their sketches."""
    digits, unit, point = sketches.digits, sketches.unit, target.fine_point
    if len(target.fine_turn) == 0:
        for i in range(count):
            row, total = scratch.points[i], np.float32(0.0)
            for k in range(SKETCHED):
                away = unit[k] * digits[row, k] - point[k]
                total += away * away
            scratch.estimates[i] = total
        return
    room, turned = scratch.drawn, scratch.fine_turned
    for start in range(0, count, SOME):
        stop = min(start + SOME, count)
        for i in range(start, stop):
            row = scratch.points[i]
            for k in range(SKETCHED):
                room[i - start, k] = unit[k] * digits[row, k]
        np.dot(room[: stop - start], target.fine_turn, turned[: stop - start])
        for i in range(start, stop):
            total = np.float32(0.0)
            for k in range(SKETCHED):
                away = point[k] - turned[i - start, k]
                total += away * away
            scratch.estimates[i] = total


@njit(cache=True, fastmath=_FAST, inline="always")
@no_type_check
def _least(target, squared, off, beside):
    """What the squared distance of a window is at least, and about what it is.

    Args:
        target: the query.
        squared: squared distance of its sketch along the principal directions.
        off: how far the sketch is from the window there.
        beside: length of what lies outside them.
    """
    away = max(np.float32(sqrt(squared)) - off, np.float32(0.0))
    if len(target.fine_turn):
        if not target.is_strict:
            return away * away, squared
        # What is not trusted is no longer than it was.
        least = sqrt(away * away + target.fine_beside**2) - beside
        return max(least, 0.0) * abs(least), squared
    gap = beside - target.fine_beside
    return away * away + gap * gap, squared + beside * beside


@njit(cache=True, fastmath=_FAST)
@no_type_check
def _compare(sketches, poses, target, count, wanted, scratch):
    """Write the gathered windows that may be among the nearest to `rows` and `squared`.

    Returns:
        How many, and the squared distance of the last one wanted.
    """
    _sketched(sketches, target, count, scratch)
    for i in range(count):
        off = sketches.off[scratch.points[i]]
        least, about = _least(target, scratch.estimates[i], off[0], off[1])
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
    within = limit * np.float32(1.0 + _SLACK) + np.float32(_SLACK)
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


@njit(cache=True, fastmath=_FAST)
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
                    _measure(blocks.center, target, begin, end, scratch, scratch.apart)
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
