"""Streams with positions only, or orientations only, are rehearsed as what they are."""

from dataclasses import replace

import numpy as np
import pytest
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.subject import canonical_subject
from localreg.database.block_search import BlockSearch
from localreg.database.features import FeatureLayout
from localreg.database.neighbours import Neighbours, Query
from localreg.evaluation.trackers import TrackerQuality, simulate_trackers
from localreg.live.warm_up import warm_up
from localreg.synthesis import local_regression
from localreg.synthesis.attention import observe
from localreg.synthesis.estimator import Result
from localreg.synthesis.experience import learn_half
from localreg.synthesis.halves import Measured
from localreg.synthesis.local_regression import LocalRegression
from localreg.synthesis.synthesizer import Synthesizer
from tests.localreg.synthesis.sessions import Session, follow, only

ALL, NONE = np.ones(6, dtype=bool), np.zeros(6, dtype=bool)
MASKS = {"position": (ALL, NONE), "orientation": (NONE, ALL)}


@pytest.fixture(scope="module")
def layout() -> FeatureLayout:
    return FeatureLayout.of(canonical_subject())


@pytest.fixture
def fresh(localreg: Synthesizer) -> Synthesizer:
    """The estimator with a prior that no stream has begun with yet."""
    return replace(localreg, prior=replace(localreg.prior))


def prior_of(estimator: Synthesizer) -> LocalRegression:
    assert isinstance(estimator.prior, LocalRegression)
    return estimator.prior


@pytest.mark.parametrize("seed", range(5))
def test_a_turned_reference_sees_everything_turned(seed: int, layout: FeatureLayout) -> None:
    rng = np.random.default_rng(seed)
    positions = rng.normal(size=(6, 3))
    rotations = Rotation.random(6, rng=rng)
    turn = rng.normal(size=3)
    quaternions = rotations.as_quat(scalar_first=True)
    turned = quaternions.copy()
    own = rotations[layout.reference] * Rotation.from_rotvec(turn)
    turned[layout.reference] = own.as_quat(scalar_first=True)
    np.testing.assert_allclose(
        FeatureLayout.seen_turned(layout.extract(positions, quaternions), turn),
        layout.extract(positions, turned),
        atol=1e-12,
    )


def test_each_half_knows_its_columns(layout: FeatureLayout) -> None:
    position = Measured.of(layout, position=True, orientation=False)
    orientation = Measured.of(layout, position=False, orientation=True)
    of_positions = layout.columns(np.ones(6), np.zeros(6)) > 0.0
    np.testing.assert_array_equal(position.trust > 0.0, of_positions)
    np.testing.assert_array_equal(orientation.trust > 0.0, ~of_positions)
    np.testing.assert_array_equal(position.coordinates, [True] * 3 + [False] * 3)
    np.testing.assert_array_equal(orientation.coordinates, [False] * 3 + [True] * 3)
    assert position.turns
    assert not orientation.turns


def test_what_is_measured_is_told_of_any_tracker(trackers) -> None:
    frame = trackers.frame(0)
    some = np.arange(6) == 4
    for masks, signals in (
        ((ALL, ALL), "both"),
        ((some, ~some), "both"),
        ((some, NONE), "position"),
        ((NONE, some), "orientation"),
        ((NONE, NONE), None),
    ):
        assert observe(only(frame, *masks)).signals == signals


def test_a_stream_is_what_it_was_when_something_was_first_measured(fresh, trackers) -> None:
    nothing = only(trackers.frame(0), NONE, NONE)
    state = fresh.step(fresh.init(nothing), nothing)[0]
    assert state.signals is None
    for index, masks in enumerate([MASKS["orientation"], (ALL, ALL), (NONE, NONE)]):
        state = fresh.step(state, only(trackers.frame(index), *masks))[0]
        assert state.signals == "orientation"


@pytest.mark.parametrize(("signals", "worst"), [("position", 1.5), ("orientation", 1.3)])
def test_streams_of_half_the_signals_are_followed(signals, worst, fresh, walk, body) -> None:
    frames = list(simulate_trackers(walk, TrackerQuality(signals=signals)))
    session = Session(walk.qpos, body, follow(fresh, frames))
    assert list(prior_of(fresh)._halves) == [signals]
    errors = np.abs(session.qpos[5:, 7:] - walk.qpos[5:, 7:])
    assert np.degrees(errors.mean()) < worst
    # Expected errors are of the size of the true ones.
    sigma = np.array([pose.predicted_sigma for pose in session.poses])[5:]
    ratio = np.sqrt(np.mean(np.square(errors)) / np.mean(np.square(sigma)))
    assert 0.6 < ratio < 1.3


def test_streams_with_both_signals_rehearse_nothing_more(fresh, trackers) -> None:
    follow(fresh, [trackers.frame(0), only(trackers.frame(1), ALL, NONE), trackers.frame(2)])
    assert not prior_of(fresh)._halves


@pytest.mark.parametrize("signals", MASKS)
def test_a_warm_estimator_has_rehearsed_for_halves(signals, fresh, trackers, monkeypatch) -> None:
    warm_up(fresh)
    assert set(prior_of(fresh)._halves) == set(MASKS)
    monkeypatch.setattr(local_regression, "half_over", None)
    frame = only(trackers.frame(0), *MASKS[signals])
    state, pose = fresh.step(fresh.init(frame), frame)
    assert state.signals == signals
    assert pose.result == Result.SOLVED


@pytest.mark.parametrize("signals", MASKS)
def test_signals_that_come_later_are_heard(signals, fresh, trackers) -> None:
    state = None
    for index in range(4):
        frame = only(trackers.frame(index), *MASKS[signals])
        state = fresh.init(frame) if state is None else state
        state = fresh.step(state, frame)[0]
    assert state is not None
    prior = prior_of(fresh)
    frame = trackers.frame(4)
    for seen, answers in (
        (only(frame, *MASKS[signals]), prior._halves[signals]),
        (frame, prior),
    ):
        query = fresh._query(state, observe(seen))[0]
        if answers is not prior:
            query = answers.experience.as_rehearsed(query)
        np.testing.assert_array_equal(
            prior.expect(fresh._query(state, observe(seen))[0], state).belief.information,
            answers._expect(query, state).belief.information,
        )


def test_trust_is_relative_to_that_of_rehearsal(localreg, layout) -> None:
    prior = prior_of(localreg)
    measured = Measured.of(layout, position=True, orientation=False)
    found = replace(prior.experience, trust=measured.trust)
    seen = ALL.copy()
    seen[3] = False
    query = Query(np.zeros((3, 56)), np.ones(3, dtype=bool), np.zeros(layout.size), measured.trust)
    np.testing.assert_array_equal(found.as_rehearsed(query).feature_trust, measured.trust > 0.0)
    less = query._replace(
        feature_trust=measured.trust * layout.columns(seen.astype(float), np.ones(6))
    )
    np.testing.assert_allclose(
        found.as_rehearsed(less).feature_trust, layout.columns(seen.astype(float), np.zeros(6))
    )


class Spy(BlockSearch):
    """Keeps questions and answers of a search."""

    def __init__(self, search: BlockSearch) -> None:
        vars(self).update(vars(search))
        self.heard: list[tuple[Query, Neighbours, int]] = []

    def search(self, query: Query, count: int, without: int = -1) -> Neighbours:
        found = super().search(query, count, without)
        self.heard.append((query, found, without))
        return found


@pytest.mark.parametrize("signals", MASKS)
def test_rehearsal_hears_its_half_alone_and_never_its_own_clip(
    signals, localreg, layout, database
) -> None:
    allowed = database.exclude(subject="69")
    estimator: Synthesizer = localreg.leave_out(allowed)
    prior = prior_of(estimator)
    spy = Spy(prior.source.search)
    source = replace(prior.source, search=spy)
    measured = Measured.of(
        layout, position=signals == "position", orientation=signals == "orientation"
    )
    settings = replace(prior.settings, rehearsals=60)
    found = learn_half(prior.experience, source, settings, estimator.chain, measured)
    assert len(spy.heard) >= 60
    known: ndarray = measured.trust > 0.0
    for query, near, without in spy.heard:
        np.testing.assert_array_equal(query.feature_trust, known)
        assert np.all(allowed[near.rows])
        assert without >= 0
        assert not np.any(source.view.groups[near.rows] == without)
    # What is not measured does not enter the regression, whatever it may be.
    raw = np.zeros(len(found.pose.noise))
    trust = np.ones(len(raw))
    other = raw.copy()
    other[3 * 56 :][~known] = 7.0
    np.testing.assert_array_equal(found.pose.reduce(raw, trust), found.pose.reduce(other, trust))
    # With less to go by, the past is known less, and predictions err more.
    past, well_known = (known.pose.noise[: 3 * 56] for known in (found, prior.experience))
    assert past.mean() > 1.15 * well_known.mean()
    assert np.trace(found.pose_growth) > np.trace(prior.experience.pose_growth)
