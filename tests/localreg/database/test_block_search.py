"""Blocks, clusters and what is trusted: always the neighbours of a plain scan."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray

from localreg.database import PoseDatabase, block_index
from localreg.database.block_index import BlockIndex, build_index
from localreg.database.block_kernels import nth_smallest
from localreg.database.block_parts import BLOCK
from localreg.database.block_search import BlockSearch
from localreg.database.neighbours import Metric, Neighbours, Query
from tests.localreg.database.made_motion import make_motion
from tests.localreg.database.plain_search import PlainSearch

METRIC = Metric(np.array([0.3, 0.15, 0.07]), np.linspace(0.5, 3.0, 20))
CLOSE = 2e-4


@pytest.fixture(scope="module")
def database() -> PoseDatabase:
    lengths = (40, 403, 5, 1, 298, 700)
    return PoseDatabase.build(make_motion(i, n, 40.0) for i, n in enumerate(lengths))


@pytest.fixture(scope="module")
def features(database: PoseDatabase) -> ndarray:
    """Smooth functions of the pose, as those of trackers are."""
    onto = np.random.default_rng(0).normal(size=(56, 20)) / 8.0
    return np.sin(database.angles @ onto).astype(np.float32)


@pytest.fixture(scope="module")
def targets(database: PoseDatabase) -> ndarray:
    found = np.zeros(len(database), dtype=bool)
    found[database.window_targets(3)] = True
    return found


@pytest.fixture(scope="module", params=["one cluster", "many clusters"])
def index(request, database, features, targets) -> BlockIndex:
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "many clusters":
            patch.setattr(block_index, "_CLUSTERED", 100)
        index = build_index(database.angles, features, targets, METRIC)
    assert (len(index.blocks.cluster_center) > 1) == (request.param == "many clusters")
    return index


def query_at(database: PoseDatabase, features: ndarray, row: int, seed: int) -> Query:
    rng = np.random.default_rng(seed)
    past = database.angles[row - np.arange(1, 4)] + 0.02 * rng.normal(size=(3, 56))
    seen = features[row] + 0.01 * rng.normal(size=20)
    return Query(past, np.ones(3, dtype=bool), seen, np.ones(20))


def test_every_window_is_in_one_block(index: BlockIndex, targets: ndarray) -> None:
    blocks = index.blocks
    counts = np.zeros(len(targets), dtype=int)
    for k in range(BLOCK):
        held = (blocks.windows >> k & 1) == 1
        np.add.at(counts, blocks.first[held] + k, 1)
    np.testing.assert_array_equal(counts, targets)
    assert blocks.cluster_begin[0] == 0
    assert blocks.cluster_begin[-1] == len(blocks.center)
    assert np.all(np.diff(blocks.cluster_begin) > 0)


def test_bounds_hold_all_windows(index, database, features, targets) -> None:
    blocks = index.blocks
    scale = np.concatenate([np.repeat(METRIC.history[::-1], 56), METRIC.features])
    cluster = np.repeat(np.arange(len(blocks.cluster_center)), np.diff(blocks.cluster_begin))
    for k in range(BLOCK):
        held = np.flatnonzero((blocks.windows >> k & 1) == 1)
        rows = blocks.first[held] + k
        past = database.angles[rows[:, None] - np.array([3, 2, 1])].reshape(len(rows), -1)
        windows = np.hstack([past, features[rows]]) * scale - index.mean
        basis = index.basis[:, : blocks.center.shape[1]]
        points = windows @ basis
        beside = np.linalg.norm(windows - points @ basis.T, axis=1)
        assert np.all(beside >= blocks.beside[held, 0] - 1e-4)
        assert np.all(beside <= blocks.beside[held, 1] + 1e-4)
        apart = np.linalg.norm(points - blocks.center[held], axis=1)
        assert np.all(apart <= blocks.radius[held] + 1e-4)
        t = k - 3.5
        curve = blocks.center + t * blocks.tangent[:, 0] + (t * t - 5.25) * blocks.tangent[:, 1]
        assert np.all(np.linalg.norm(points - curve[held], axis=1) <= blocks.off_curve[held] + 1e-4)
        middle = blocks.cluster_center[cluster[held]]
        apart = np.linalg.norm(points - middle, axis=1)
        assert np.all(apart <= blocks.cluster_radius[cluster[held]] + 1e-4)


def test_sketches_say_how_far_off_they_are(index, database, features, targets) -> None:
    rows = np.flatnonzero(targets)
    scale = np.concatenate([np.repeat(METRIC.history[::-1], 56), METRIC.features])
    past = database.angles[rows[:, None] - np.array([3, 2, 1])].reshape(len(rows), -1)
    windows = np.hstack([past, features[rows]]) * scale - index.mean
    points = windows @ index.basis
    drawn = index.sketches.digits[rows] * index.sketches.unit
    off, beside = index.sketches.off[rows].T
    np.testing.assert_allclose(np.linalg.norm(points - drawn, axis=1), off, atol=1e-4)
    rest = np.linalg.norm(windows - points @ index.basis.T, axis=1)
    np.testing.assert_allclose(beside, rest, atol=1e-4)
    assert np.median(off) < 0.02 * np.median(np.linalg.norm(points, axis=1))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("share", [1.0, 0.5, 0.02])
@pytest.mark.parametrize("trusted", ["all", "some", "half", "past", "trackers"])
def test_neighbours_are_those_of_a_plain_scan(
    index, database, features, targets, seed, trusted, share
) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 600))
    allowed = targets & (rng.random(len(targets)) < share)
    allowed[rng.choice(np.flatnonzero(targets))] = True
    row = int(rng.choice(np.flatnonzero(targets)))
    query = query_at(database, features, row, seed)
    if trusted == "some":
        query = query._replace(feature_trust=(rng.random(20) < 0.7).astype(float))
    elif trusted == "half":
        query = query._replace(feature_trust=rng.random(20))
    elif trusted == "past":
        query = query._replace(feature_trust=np.zeros(20))
    elif trusted == "trackers":
        query = query._replace(history_valid=np.zeros(3, dtype=bool))
    search = BlockSearch(index, database.angles, features, allowed, METRIC)
    assert search.is_exact
    plain = PlainSearch(database.angles, features, allowed, METRIC)
    near = None
    for factor in (1.0, 0.1, 10.0):  # then with a guess, good or bad
        rows, squared = search.search(query._replace(near=near), count)
        near = Neighbours(rows, factor * squared)
        expected = plain.search(query, count)
        np.testing.assert_allclose(squared, expected.squared_distances, rtol=CLOSE, atol=CLOSE)
        found = rows[np.isfinite(squared)]
        assert len(set(found.tolist())) == len(found)
        assert np.all(allowed[found])
    np.testing.assert_allclose(
        search.squared_distances([query])[0],
        plain.squared_distances([query])[0],
        rtol=CLOSE,
        atol=CLOSE,
    )


def test_a_recording_can_be_left_out_of_one_search(index, database, features, targets) -> None:
    groups = np.array([clip.group for clip in database.clips])[database.clip_index]
    search = BlockSearch(index, database.angles, features, targets, METRIC, groups)
    for row in np.flatnonzero(targets)[::97]:
        query = query_at(database, features, row, 1)
        without = int(groups[row])
        plain = PlainSearch(database.angles, features, targets & (groups != without), METRIC)
        rows, squared = search.search(query, 60, without)
        assert np.all(groups[rows] != without)
        expected = plain.search(query, 60).squared_distances
        np.testing.assert_allclose(squared, expected, rtol=CLOSE, atol=CLOSE)
        assert groups[search.search(query, 60).rows[0]] == without


def test_the_likeliest_clusters_hold_most_neighbours(database, features, targets) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(block_index, "_CLUSTERED", 100)
        index = build_index(database.angles, features, targets, METRIC)
    clusters = len(index.blocks.cluster_center)
    exact = BlockSearch(index, database.angles, features, targets, METRIC)
    recalls = []
    for probes in (1, clusters // 2, clusters):
        search = BlockSearch(index, database.angles, features, targets, METRIC, probes=probes)
        assert search.is_exact == (probes == clusters)
        shares = []
        for row in np.flatnonzero(targets)[::41]:
            query = query_at(database, features, row, 2)
            found, squared = search.search(query, 30)
            again = search.search(query, 30)
            np.testing.assert_array_equal(found, again.rows)
            assert np.all(np.isfinite(squared))
            shares.append(np.isin(exact.search(query, 30).rows, found).mean())
        recalls.append(np.mean(shares))
    assert recalls[0] <= recalls[1] <= recalls[2] == 1.0
    assert recalls[1] > 0.9


def test_what_follows_the_last_neighbours_is_looked_at(database, features, targets) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(block_index, "_CLUSTERED", 100)
        index = build_index(database.angles, features, targets, METRIC)
    exact = BlockSearch(index, database.angles, features, targets, METRIC)
    few = BlockSearch(index, database.angles, features, targets, METRIC, probes=2)
    shares = []
    for row in np.flatnonzero(targets & np.roll(targets, -1))[::41]:
        before = exact.search(query_at(database, features, row, 2), 30)
        query = query_at(database, features, row + 1, 2)
        true = exact.search(query, 30)
        alone, led = few.search(query, 30), few.search(query._replace(near=before), 30)
        assert len(set(led.rows.tolist())) == 30
        assert np.all(targets[led.rows])
        assert np.all(led.squared_distances <= alone.squared_distances + CLOSE)
        shares.append([np.isin(true.rows, found.rows).mean() for found in (alone, led)])
    assert np.mean(shares, axis=0)[1] > np.mean(shares, axis=0)[0]
    assert np.mean(shares, axis=0)[1] > 0.9


@pytest.mark.parametrize("known", ["past", "three features of four", "one pose"])
def test_what_is_likely_of_partial_queries_is_nearly_all(index, database, features, targets, known):
    strict = BlockSearch(index, database.angles, features, targets, METRIC)
    likely = BlockSearch(index, database.angles, features, targets, METRIC, strict=False)
    assert not likely.is_exact
    assert likely.made_exact().is_exact
    shares = []
    for row in np.flatnonzero(targets)[::41]:
        query = query_at(database, features, row, 5)
        whole = likely.search(query, 30).squared_distances
        np.testing.assert_array_equal(whole, strict.search(query, 30).squared_distances)
        if known == "past":
            query = query._replace(feature_trust=np.zeros(20))
        elif known == "one pose":
            query = query._replace(history_valid=np.array([True, False, False]))
        else:
            query = query._replace(feature_trust=(np.arange(20) % 4 > 0).astype(float))
        found = likely.search(query, 30).rows
        shares.append(np.isin(strict.search(query, 30).rows, found).mean())
    assert np.mean(shares) > 0.99


def test_where_little_is_allowed_all_clusters_are_looked_into(database, features, targets) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(block_index, "_CLUSTERED", 100)
        index = build_index(database.angles, features, targets, METRIC)
    allowed = np.zeros_like(targets)
    allowed[np.flatnonzero(targets)[-3:]] = True
    search = BlockSearch(index, database.angles, features, allowed, METRIC, probes=1)
    query = query_at(database, features, int(np.flatnonzero(targets)[0]), 3)
    rows, squared = search.search(query, 5)
    assert set(rows.tolist()) == set(np.flatnonzero(allowed).tolist())
    assert np.isfinite(squared).sum() == 3


def test_nothing_may_be_found(index, database, features, targets) -> None:
    search = BlockSearch(index, database.angles, features, np.zeros_like(targets), METRIC)
    with pytest.raises(ValueError, match="no pose"):
        search.search(query_at(database, features, 10, 4), 5)


@given(
    values=st.lists(st.floats(0.0, 1e6, width=32), min_size=1, max_size=60),
    n=st.integers(0, 59),
)
@settings(max_examples=200, deadline=None)
def test_the_nth_smallest(values: list[float], n: int) -> None:
    n = min(n, len(values) - 1)
    array = np.array(values, dtype=np.float32)
    found = nth_smallest(array, len(array), n)
    assert found == np.sort(np.array(values, dtype=np.float32))[n]
    assert np.all(array[: n + 1] <= found)
    assert np.all(array[n:] >= found)


def test_arrays_give_the_index_back(index: BlockIndex) -> None:
    again = BlockIndex.of_arrays(index.arrays())
    np.testing.assert_array_equal(again.basis, index.basis)
    for one, other in zip(again.blocks, index.blocks, strict=True):
        np.testing.assert_array_equal(one, other)
