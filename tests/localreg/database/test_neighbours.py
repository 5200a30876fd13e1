"""Searches against a double loop over poses and lags."""

from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray

from localreg.database import PoseDatabase
from localreg.database.block_index import build_index
from localreg.database.block_search import BlockSearch
from localreg.database.features import FeatureLayout
from localreg.database.neighbours import Metric, NeighbourSearch, Query
from localreg.database.view import SubjectView
from localreg.synthesis.examples import example_source
from tests.localreg.database.made_motion import make_motion
from tests.localreg.database.plain_search import PlainSearch, nearest

CLOSE = 2e-4  # poses are stored in single precision


class Problem(NamedTuple):
    angles: ndarray
    features: ndarray
    allowed: ndarray
    metric: Metric
    query: Query


def problem(seed: int, poses: int = 60, lags: int = 3, columns: int = 7) -> Problem:
    """Anything: masks, weights (some of them zero), and which poses are allowed."""
    rng = np.random.default_rng(seed)
    allowed = rng.random(poses) < rng.choice([0.1, 0.5, 1.0])
    allowed[:lags] = False
    allowed[rng.integers(lags, poses)] = True
    metric = Metric(
        rng.uniform(0.0, 2.0, lags) * (rng.random(lags) < 0.8),
        rng.uniform(0.0, 2.0, columns) * (rng.random(columns) < 0.8),
    )
    query = Query(
        rng.normal(size=(lags, 56)),
        rng.random(lags) < 0.7,
        rng.normal(size=columns),
        rng.random(columns) ** 0.3 * (rng.random(columns) < rng.choice([0.0, 0.5, 1.0])),
    )
    if rng.random() < 0.5:
        query = query._replace(feature_trust=np.ceil(query.feature_trust))
    angles, features = rng.normal(size=(poses, 56)), rng.normal(size=(poses, columns))
    return Problem(angles.astype(np.float32), features.astype(np.float32), allowed, metric, query)


def plain_distances(p: Problem) -> ndarray:
    """Squared distances, pose by pose; infinite where not allowed."""
    squared = np.full(len(p.angles), np.inf)
    for row in np.flatnonzero(p.allowed):
        squared[row] = 0.0
        for lag, past in enumerate(p.query.history, start=1):
            if p.query.history_valid[lag - 1]:
                away = p.metric.history[lag - 1] * (p.angles[row - lag].astype(float) - past)
                squared[row] += away @ away
        away = p.metric.features * (p.features[row].astype(float) - p.query.features)
        squared[row] += np.sum(np.square(p.query.feature_trust * away))
    return squared


def plain_search(p: Problem) -> PlainSearch:
    return PlainSearch(p.angles, p.features, p.allowed, p.metric)


def block_search(p: Problem) -> NeighbourSearch:
    windows = np.arange(len(p.angles)) >= len(p.metric.history)
    index = build_index(p.angles, p.features, windows, p.metric)
    return BlockSearch(index, p.angles, p.features, p.allowed, p.metric)


@pytest.fixture(scope="module", params=[plain_search, block_search], ids=["plain", "blocks"])
def search_in(request):
    return request.param


@given(seed=st.integers(0, 2**32), count=st.integers(1, 80))
@settings(max_examples=150, deadline=None)
def test_the_nearest_are_those_of_a_double_loop(search_in, seed, count):
    p = problem(seed)
    rows, squared = search_in(p).search(p.query, count)
    expected = plain_distances(p)
    available = int(p.allowed.sum())
    found = min(count, available)
    assert rows.shape == squared.shape == (count,)
    assert np.all(p.allowed[rows])
    assert len(set(rows[:found].tolist())) == found
    np.testing.assert_allclose(squared[:found], expected[rows[:found]], rtol=CLOSE, atol=CLOSE)
    np.testing.assert_allclose(squared[:found], np.sort(expected)[:found], rtol=CLOSE, atol=CLOSE)
    assert np.all(np.diff(squared[:found]) >= 0.0)
    assert np.all(np.isinf(squared[found:]))


@given(seed=st.integers(0, 2**32), queries=st.integers(1, 9))
@settings(max_examples=50, deadline=None)
def test_distances_to_several_queries_are_those_to_each(search_in, seed, queries):
    p = problem(seed)
    asked = [problem(seed + number).query for number in range(queries)]
    found = search_in(p).squared_distances(asked)
    assert found.shape == (queries, len(p.angles))
    for squared, query in zip(found, asked, strict=True):
        np.testing.assert_allclose(
            squared, plain_distances(p._replace(query=query)), rtol=CLOSE, atol=CLOSE
        )
        assert np.all(np.isfinite(squared) == p.allowed)


@pytest.mark.parametrize("count", [1, 5, 13])
@pytest.mark.parametrize("available", [1, 5, 13])
def test_the_nearest_of_given_distances(count, available):
    squared = np.full(40, np.inf, dtype=np.float32)
    near = np.random.default_rng(7).choice(40, available, replace=False)
    squared[near] = np.random.default_rng(8).permutation(available) + 0.5
    rows, distances = nearest(squared, count, min(count, available))
    finite = min(count, available)
    np.testing.assert_array_equal(distances[:finite], np.arange(finite) + 0.5)
    np.testing.assert_array_equal(squared[rows[:finite]], distances[:finite])
    assert len(rows) == len(distances) == count
    assert np.all(np.isinf(distances[finite:]))
    assert np.all(np.isfinite(squared[rows]))


@pytest.mark.parametrize("available", [1, 2, 5])
def test_too_few_poses_are_repeated_at_infinite_distance(search_in, available):
    p = problem(1)
    p.allowed[:] = False
    p.allowed[10 : 10 + available] = True
    rows, squared = search_in(p).search(p.query, 13)
    assert set(rows.tolist()) == set(range(10, 10 + available))
    assert np.all(np.isfinite(squared[:available]))
    assert np.all(np.isinf(squared[available:]))


def test_equal_poses_are_all_found(search_in):
    p = problem(2)
    p.angles[:] = p.angles[0]
    p.features[:] = p.features[0]
    p.allowed[:] = False
    p.allowed[[5, 9, 20, 33]] = True
    rows, squared = search_in(p).search(p.query, 4)
    assert set(rows.tolist()) == {5, 9, 20, 33}
    np.testing.assert_allclose(squared, squared[0], rtol=CLOSE, atol=CLOSE)


def test_a_query_out_of_the_database_finds_itself(search_in):
    p = problem(3, poses=200)
    metric = Metric(np.ones(3), np.ones(7))
    search = search_in(p._replace(allowed=np.arange(200) >= 3, metric=metric))
    for row in (3, 50, 199):
        past = p.angles[[row - 1, row - 2, row - 3]].astype(float)
        query = Query(past, np.ones(3, dtype=bool), p.features[row].astype(float), np.ones(7))
        rows, squared = search.search(query, 2)
        assert rows[0] == row
        assert squared[0] < 1e-3 < squared[1]


def test_a_query_that_knows_nothing_finds_allowed_poses(search_in):
    p = problem(4)
    query = p.query._replace(history_valid=np.zeros(3, dtype=bool), feature_trust=np.zeros(7))
    rows, squared = search_in(p).search(query, 1)
    assert p.allowed[rows[0]]
    assert squared[0] == 0.0


def test_searching_changes_nothing(search_in):
    p = problem(5)
    search = search_in(p)
    first = search.search(p.query, 9)
    search.search(problem(6).query, 30)
    for before, after in zip(first, search.search(p.query, 9), strict=True):
        np.testing.assert_array_equal(before, after)


@given(seed=st.integers(0, 2**32), history=st.integers(1, 4))
@settings(max_examples=25, deadline=None)
def test_windows_never_reach_over_the_start_of_a_clip(seed, history):
    rng = np.random.default_rng(seed)
    lengths = rng.integers(1, 12, size=4)
    lengths[0] = history + 2
    motions = [make_motion(i, int(n), 40.0) for i, n in enumerate(lengths)]
    database = PoseDatabase.build(motions, rate=40.0, mirror=bool(rng.integers(2)))
    features = rng.normal(size=(len(database), 5)).astype(np.float32)
    allowed = rng.random(len(database)) < 0.8
    allowed[history] = True
    metric = Metric(np.ones(history), np.ones(5))
    targets = np.zeros(len(database), dtype=bool)
    targets[database.window_targets(history)] = True
    index = build_index(database.angles, features, targets, metric)
    layout = FeatureLayout(0, ())  # a reference's four columns and one more: any will do here
    view = SubjectView(database, layout, metric, features, targets, database.clip_index, index)
    source = example_source(view, allowed, count=len(database))
    query = Query(
        rng.normal(size=(history, 56)), np.ones(history, dtype=bool),
        rng.normal(size=5), np.ones(5),
    )  # fmt: skip
    rows, squared = source.search.search(query, len(database))
    found = rows[np.isfinite(squared)]
    whole = database.clip_index[found] == database.clip_index[found - history]
    assert np.all(whole & (found >= history) & allowed[found])
    usable = sum(int(allowed[clip.start + history : clip.stop].sum()) for clip in database.clips)
    assert len(found) == usable
    examples = source.find(query)
    for lag in range(history + 1):
        np.testing.assert_array_equal(examples.angles[:, lag], database.angles[rows - lag])
    np.testing.assert_array_equal(examples.roots[:, 1], database.roots[rows - 1])
    np.testing.assert_array_equal(examples.features, features[rows])
