"""A pose that the trackers allow and the database does not know gives way to another."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from localreg.body.skeleton import DOF_NAMES
from localreg.database.neighbours import Query
from localreg.synthesis.attention import observe
from localreg.synthesis.belief import Belief
from localreg.synthesis.estimator import Result
from localreg.synthesis.prior import Acquisition, Expectation, Prior
from localreg.synthesis.rival import Doubt, are_apart
from localreg.synthesis.state import State
from localreg.synthesis.synthesizer import _may_replace
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


def test_no_rival_is_sought_while_most_trackers_are_away(localreg, trackers, walk):
    frames = [without(frame, 0, 2, 3, 4) for frame in list(trackers)[1:40]]
    state = localreg.init_at(written_otherwise(walk.qpos[0]))
    for frame in frames:
        state, _ = localreg.step(state, frame)
        assert state.doubt.rival is None


def test_a_pose_that_is_known_well_has_no_rival(localreg, trackers):
    frames = list(trackers)[:60]
    state = localreg.init(frames[0])
    for frame in frames:
        state, _ = localreg.step(state, frame)
        assert state.doubt.rival is None


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


@pytest.mark.parametrize(("rivals", "wins"), [(0.5, True), (0.8, False), (2.0, False)])
def test_a_rival_wins_by_clearly_less_surprise_in_the_end(rivals, wins):
    """What it is like in its first frames does not count."""
    doubt = Doubt()
    for surprise in [9.0, 9.0, 9.0, rivals, rivals, rivals]:
        assert not doubt.is_decided
        doubt = doubt.beside(1.0, object(), surprise)
    assert doubt.is_decided
    assert doubt.prefers_the_rival == wins
    assert doubt.settled_on_the_rival.surprise == pytest.approx(rivals)
    assert doubt.settled.rival is None


def test_rests_grow_while_rivals_are_given_up():
    doubt, rests = Doubt(), []
    for _ in range(5):
        doubt = doubt.settled
        rests.append(doubt.rest)
    assert rests == [10, 20, 40, 80, 80]
    assert doubt.settled_on_the_rival.pause == 10


def test_the_same_pose_is_no_rival(walk):
    assert not are_apart(walk.qpos[0], walk.qpos[0])
    assert are_apart(walk.qpos[0], written_otherwise(walk.qpos[0]))


def test_a_rival_must_meet_the_trackers_by_another_pose(localreg, trackers):
    present = localreg._advance(localreg.init(trackers.frame(0)), observe(trackers.frame(1)))
    turned = present.solution._replace(qpos=written_otherwise(present.solution.qpos))
    rival = present._replace(solution=turned)
    assert _may_replace(rival, present)
    assert not _may_replace(present, present)
    assert not _may_replace(rival._replace(result=Result.FAILED), present)
    away = present.residuals._replace(median_square=1e3)
    assert not _may_replace(rival._replace(residuals=away), present)
