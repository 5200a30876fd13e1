"""Distances of a query to windows, and bounds of them, as machine code.

Bounds hold whatever lies outside the principal directions, so that what is passed over could
not have been found; all arithmetic is single precision with that much slack.
"""

from math import sqrt
from typing import no_type_check

import numpy as np
from numba import njit

from localreg.database.block_parts import BLOCK, DIRECTIONS, SKETCHED, SOME

SLACK = 1e-4
"""Of what rounding may add to a squared length, as a share of it."""

FAST = {"contract", "reassoc", "nsz", "arcp"}
"""Sums may be reordered to fill vector registers; what is not finite stays so."""


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


@njit(cache=True, fastmath=FAST, inline="always")
@no_type_check
def _difference(values, wanted, weights):
    total = np.float32(0.0)
    for i in range(len(wanted)):
        away = values[i] - wanted[i]
        total += weights[i] * away * away
    return total


@njit(cache=True, fastmath=FAST, inline="always")
@no_type_check
def window_distance(poses, row, target):
    """The squared distance of one window, by the metric itself."""
    width = poses.angles.shape[1]
    begin = row * width - len(target.past)
    past = poses.angles.reshape(-1)[begin : row * width]
    return _difference(past, target.past, target.past_weight) + _difference(
        poses.features[row], target.features, target.feature_weight
    )


@njit(cache=True, fastmath=FAST)
@no_type_check
def all_distances(poses, target, out):
    """Write the squared distance of every pose that may be found, infinity for the others."""
    for row in range(len(out)):
        out[row] = window_distance(poses, row, target) if poses.kept[row] else np.inf


@njit(cache=True, fastmath=FAST, inline="always")
@no_type_check
def _apart(point, rows, row):
    """The squared distance of a point to a row."""
    total = np.float32(0.0)
    for i in range(len(point)):
        away = point[i] - rows[row, i]
        total += away * away
    return total


@njit(cache=True, fastmath=FAST, inline="always")
@no_type_check
def along_curve(cc, products, n, out):
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


@njit(cache=True, fastmath=FAST, inline="always")
@no_type_check
def reach_within(is_turned, is_strict, outside, limit, low, high):
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


@njit(cache=True, fastmath=FAST, inline="always")
@no_type_check
def measure_centers(centers, target, begin, end, scratch, out):
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


@njit(cache=True, fastmath=FAST)
@no_type_check
def inner_products(blocks, target, begin, end, scratch):
    """Write to `products` what `along_curve` takes of the held blocks from one to another."""
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


@njit(cache=True, fastmath=FAST)
@no_type_check
def measure_sketches(sketches, target, count, scratch):
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


@njit(cache=True, fastmath=FAST, inline="always")
@no_type_check
def least_distance(target, squared, off, beside):
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
