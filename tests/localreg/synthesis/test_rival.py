"""A pose that the trackers allow and the database does not know gives way to another."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from jaxtyping import Float
from numpy import ndarray

from localreg.body.skeleton import DOF_NAMES
from localreg.database.neighbours import Query
from localreg.evaluation.trackers import TrackerQuality, simulate_trackers
from localreg.synthesis.attention import observe
from localreg.synthesis.belief import Belief
from localreg.synthesis.estimator import Result
from localreg.synthesis.methods import build_estimator
from localreg.synthesis.prior import Acquisition, Expectation, Prior
from localreg.synthesis.rival import Doubt, are_apart
from localreg.synthesis.state import State
from localreg.synthesis.synthesizer import _is_found
from tests.localreg.synthesis.sessions import follow, without

BEARABLE = 0.7
SHOULDER = [7 + DOF_NAMES.index("rhumerusr" + axis) for axis in "zyx"]


def written_otherwise(qpos):
    """The same pose by other angles of one shoulder: every tracker stays where it is."""
    z, y, x = qpos[SHOULDER]
    other = qpos.copy()
    other[SHOULDER] = z + np.pi, np.pi - y, x + np.pi
    return other


@dataclass(frozen=True, eq=False)
class Stubborn(Prior):
    """Expects the pose to stay what it is, and is surprised by one shoulder's angles."""

    prior: Prior
    known: float  # the shoulder's angle in the database [rad]

    def expect(self, query: Query, state: State) -> Expectation:
        told = self.prior.expect(query, state)
        belief = Belief(np.array(state.qpos), np.zeros(62), 300.0 * np.eye(62))
        off = abs(state.qpos[SHOULDER[1]] - self.known) > 1.0
        return told._replace(belief=belief, surprise=5.0 if off else 0.1)

    def acquire(self, query: Query) -> Acquisition:
        return self.prior.acquire(query)

    def acquire_plainly(self) -> Acquisition | None:
        return self.prior.acquire_plainly()


class Misled(Prior):
    """Finds a pose that is not the one the trackers come from."""

    def __init__(self, prior: Prior, angles: Float[ndarray, "56"]) -> None:
        self.prior, self.angles = prior, angles

    def expect(self, query: Query, state: State) -> Expectation:
        return self.prior.expect(query, state)

    def conclude(self, expectation, qpos, covariance):
        return self.prior.conclude(expectation, qpos, covariance)

    def acquire(self, query: Query) -> Acquisition:
        return Acquisition(self.angles[None], self.angles, 1e3 * np.eye(56))

    def acquire_plainly(self) -> Acquisition | None:
        return self.prior.acquire_plainly()


def test_a_shoulder_that_began_the_other_way_round_is_set_right(localreg, trackers, walk):
    frames = list(trackers)[1:40]
    stubborn = replace(localreg, prior=Stubborn(localreg.prior, walk.qpos[0, SHOULDER[1]]))
    start = localreg.init_at(written_otherwise(walk.qpos[0]))
    poses = follow(stubborn, frames, start)
    found_anew = [index for index, pose in enumerate(poses) if pose.result == Result.REACQUIRED]
    assert len(found_anew) == 1
    when = found_anew[0]
    assert when < 20
    off = np.abs(np.array([pose.qpos[SHOULDER] for pose in poses]) - walk.qpos[1:40, SHOULDER])
    assert off[:when].mean(axis=1).min() > 1.0
    assert off[when:].max() < 0.5
    residuals = np.array([pose.position_residuals for pose in poses])
    assert residuals.max() < 0.05  # the trackers were met throughout

    patient = replace(stubborn, settings=replace(stubborn.settings, bearable_surprise=np.inf))
    results = {pose.result for pose in follow(patient, frames, start)}
    assert results == {Result.SOLVED}
    assert patient.init(trackers.frame(0)).doubt.rival is None


def test_no_rival_is_sought_while_most_trackers_are_away(localreg, trackers, walk):
    frames = [without(frame, 0, 2, 3, 4) for frame in list(trackers)[1:40]]
    state = localreg.init_at(written_otherwise(walk.qpos[0]))
    for frame in frames:
        state, _ = localreg.step(state, frame)
        assert state.doubt.rival is None


@pytest.mark.parametrize("signals", ["both", "position"])
def test_a_pose_that_is_known_well_gives_up_the_rival_that_it_began_with(localreg, walk, signals):
    frames = list(simulate_trackers(walk, TrackerQuality(signals=signals)))[:60]
    state = localreg.init(frames[0])
    assert are_apart(state.qpos, state.doubt.rival.qpos)
    there = []
    for frame in frames:
        state, pose = localreg.step(state, frame)
        assert pose.result == Result.SOLVED
        there.append(state.doubt.rival is not None)
    followed = sum(there)
    assert 1 <= followed <= 24
    assert not any(there[followed:])


def test_a_rival_is_found_without_the_database(localreg, trackers, walk):
    first = trackers.frame(0)
    rival = localreg.init(first).doubt.rival
    fooled = replace(localreg, prior=Misled(localreg.prior, written_otherwise(walk.qpos[0])[7:]))
    misled = fooled.init(first)
    np.testing.assert_allclose(misled.doubt.rival.qpos, rival.qpos)
    assert are_apart(misled.qpos, rival.qpos)
    off = np.abs(rival.qpos[SHOULDER] - walk.qpos[0, SHOULDER])
    assert off.max() < 0.5

    poses = follow(fooled, list(trackers)[1:40], misled)
    found_anew = [index for index, pose in enumerate(poses) if pose.result == Result.REACQUIRED]
    assert len(found_anew) == 1
    assert found_anew[0] < 24
    late = np.abs(poses[-1].qpos[SHOULDER] - walk.qpos[39, SHOULDER])
    assert late.max() < 0.5


@pytest.mark.parametrize(("signals", "asked"), [("both", [1, 1, 2, 2]), ("position", [2, 2, 2, 2])])
def test_a_young_rival_keeps_to_whole_trackers_without_the_database(
    localreg, walk, signals, asked, monkeypatch
):
    frames = list(simulate_trackers(walk, TrackerQuality(signals=signals)))[:5]
    state = localreg.init(frames[0])
    localreg.step(state, frames[1])  # rehearses for half a signal, once
    searches, search = [], type(localreg.prior.source.search).search
    monkeypatch.setattr(
        type(localreg.prior.source.search), "search",
        lambda *args, **named: searches.append(None) or search(*args, **named),
    )  # fmt: skip
    for frame, times in zip(frames[1:], asked, strict=True):
        searches.clear()
        state, pose = localreg.step(state, frame)
        assert len(searches) == times
        rival = state.doubt.rival
        assert rival is not None
    assert rival.history_valid.all()
    assert np.nanmax(pose.position_residuals) < 0.03


def test_methods_that_know_no_surprise_follow_no_rivals(walk, trackers):
    plain = build_estimator("ik", walk.subject)
    assert plain.init(trackers.frame(0)).doubt.rival is None


def test_doubt_grows_and_falls_with_surprise():
    doubt = Doubt(surprise=0.1, rest=2)
    assert not doubt.wants_a_rival(BEARABLE)
    for _ in range(12):
        doubt = doubt.after(1.0)
    assert doubt.wants_a_rival(BEARABLE)
    for _ in range(30):
        doubt = doubt.after(0.1)
    assert not doubt.wants_a_rival(BEARABLE)


def test_where_surprise_is_not_known_there_is_no_rival():
    doubt = Doubt().after(float("nan"))
    for _ in range(40):
        doubt = doubt.after(float("nan"))
    assert not doubt.wants_a_rival(BEARABLE)


@pytest.mark.parametrize(("rivals", "when"), [(0.5, 6), (0.74, 6), (0.8, None), (2.0, None)])
def test_a_rival_wins_by_clearly_less_surprise(rivals, when):
    """What it is like in its first frames does not count."""
    doubt = Doubt().challenged_by(object())
    for frame in range(1, 25):
        assert not doubt.is_over
        doubt = doubt.beside(1.0, object(), 9.0 if frame <= 3 else rivals)
        if doubt.prefers_the_rival:
            break
    assert doubt.is_over == (when is None)
    assert doubt.prefers_the_rival == (when is not None)
    assert when is None or frame == when
    assert doubt.settled_on_the_rival.surprise == pytest.approx(rivals)
    assert doubt.settled.rival is None


@pytest.mark.parametrize(("begins", "when"), [(3, 6), (5, 12), (6, 12), (9, 24)])
def test_a_rival_may_win_late(begins, when):
    doubt = Doubt().challenged_by(object())
    for frame in range(1, 25):
        doubt = doubt.beside(1.0, object(), 1.0 if frame <= begins else 0.6)
        if doubt.prefers_the_rival:
            break
    assert frame == when


@pytest.mark.parametrize(("rivals", "over"), [(2.9, 24), (3.1, 6)])
def test_a_hopeless_rival_is_given_up_at_the_first_look(rivals, over):
    doubt = Doubt().challenged_by(object())
    while not doubt.is_over:
        doubt = doubt.beside(1.0, object(), rivals)
    assert doubt.followed == over
    assert not doubt.prefers_the_rival


def test_rests_grow_while_rivals_are_given_up():
    doubt, rests = Doubt(), []
    for _ in range(5):
        doubt = doubt.settled
        rests.append(doubt.rest)
    assert rests == [10, 20, 40, 80, 80]
    taken = doubt.challenged_by(object()).beside(1.0, object(), 0.5).settled_on_the_rival
    assert taken.pause == 10


def test_the_same_pose_is_no_rival(walk):
    assert not are_apart(walk.qpos[0], walk.qpos[0])
    assert are_apart(walk.qpos[0], written_otherwise(walk.qpos[0]))


def test_a_rival_must_meet_the_trackers(localreg, trackers):
    rival = localreg._advance(localreg.init(trackers.frame(0)), observe(trackers.frame(1)))
    assert _is_found(rival)
    assert not _is_found(rival._replace(result=Result.FAILED))
    away = rival.residuals._replace(median_square=1e3)
    assert not _is_found(rival._replace(residuals=away))
