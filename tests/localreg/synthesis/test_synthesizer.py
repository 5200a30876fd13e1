"""What every estimator promises: purity, masks that are honored, no nonsense out."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from numpy import ndarray

from localreg.body.subject import Subject
from localreg.database import PoseDatabase
from localreg.database.block_search import BlockSearch
from localreg.database.neighbours import Neighbours, Query
from localreg.errors import DatabaseError
from localreg.evaluation.trackers import simulate_trackers
from localreg.synthesis.baselines import PastRegression
from localreg.synthesis.estimator import Pose, Result
from localreg.synthesis.experience import learn
from localreg.synthesis.local_regression import LocalRegression
from localreg.synthesis.methods import build_estimator
from localreg.synthesis.state import State
from localreg.synthesis.synthesizer import Synthesizer
from sensors.pose import TrackerFrame
from tests.localreg.synthesis.sessions import (
    Session,
    follow,
    moved_frame,
    moved_pose,
    only,
    without,
)

ALL = np.ones(6, dtype=bool)


class Traces(dict[str, int]):
    """How often a prior's methods were traced."""


@pytest.fixture
def traces(monkeypatch: pytest.MonkeyPatch) -> Traces:
    counted = Traces(predict=0, acquire=0)
    for name in counted:
        method = getattr(PastRegression, name)

        def counting(*args, _name=name, _method=method):
            counted[_name] += 1
            return _method(*args)

        monkeypatch.setattr(PastRegression, name, counting)
    return counted


def assert_equal_poses(one: Pose, other: Pose) -> None:
    for name, a, b in zip(Pose._fields, one, other, strict=True):
        np.testing.assert_array_equal(a, b, err_msg=name)


def copied(state: State) -> State:
    return jax.tree.map(np.array, state)


def assert_equal_states(one: State, other: State) -> None:
    jax.tree.map(np.testing.assert_array_equal, one, other)


def other_person(subject: Subject) -> Subject:
    shorter = Subject.from_offsets("other", 0.9 * subject.offsets, subject.axis_frames)
    return replace(shorter, name="other")


def test_a_prior_of_terms_is_traced_once_whatever_happens(
    traces, estimator_of, trackers, database, walk
):
    """Dropouts, nothing measured, losing the body, another start, another person, less data."""
    paper: Synthesizer = estimator_of("paper")
    frames = list(trackers)[:40]
    state = paper.step(paper.init(frames[0]), frames[0])[0]
    traces.update(predict=0, acquire=0)  # other tests may have compiled it before
    frames[3:6] = [without(frame, 2) for frame in frames[3:6]]
    frames[6:8] = [without(frame, *range(6)) for frame in frames[6:8]]
    frames[8:10] = [only(frame, ALL, ALL & (np.arange(6) > 2)) for frame in frames[8:10]]
    frames[20:] = [moved_frame(f, 2.0, np.array([9.0, 9.0, 5.0])) for f in frames[20:]]
    poses = follow(paper, frames, state)
    paper.init(without(frames[0], 1))
    follow(paper, frames[:2], paper.init_at(walk.qpos[0]))
    follow(paper.leave_out(database.exclude(clip="16_25")), frames[:2])
    person = other_person(walk.subject)
    seen = simulate_trackers(replace(walk, subject=person)).frame(0)
    follow(build_estimator("paper", person, database), [seen, seen])
    assert all(np.all(np.isfinite(pose.qpos)) for pose in poses)
    assert traces == {"predict": 0, "acquire": 0}


def test_a_step_is_a_function_of_state_and_frame(localreg, trackers, walk):
    state = localreg.init(trackers.frame(0))
    for index in range(1, 4):
        frame = trackers.frame(index)
        before, seen = copied(state), TrackerFrame(*(np.array(part) for part in frame))
        first, one = localreg.step(state, frame)
        localreg.step(localreg.init_at(walk.qpos[70]), trackers.frame(70))
        second, other = localreg.step(state, frame)
        assert_equal_poses(one, other)
        assert_equal_states(first, second)
        assert_equal_states(state, before)
        for part, kept in zip(frame, seen, strict=True):
            np.testing.assert_array_equal(part, kept)
        state = first


def test_time_and_residuals_are_the_frames(localreg, trackers, body):
    frame = without(trackers.frame(1), 3)._replace(time=17.25)
    _, pose = localreg.step(localreg.init(trackers.frame(0)), frame)
    assert pose.time == 17.25
    poses = body.tracker_poses(pose.qpos[None])
    distances = np.linalg.norm(poses.positions[0] - frame.positions, axis=1)
    dots = np.abs(np.sum(poses.quaternions[0] * frame.quaternions, axis=1))
    kept = np.arange(6) != 3
    np.testing.assert_allclose(pose.position_residuals[kept], distances[kept], atol=1e-9)
    np.testing.assert_allclose(
        pose.orientation_residuals[kept], 2 * np.arccos(dots.clip(max=1.0))[kept], atol=1e-6
    )
    assert np.isnan(pose.position_residuals[3])
    assert np.isnan(pose.orientation_residuals[3])


NONSENSE = {
    "nan": np.nan, "infinity": np.inf, "far away": 1e7, "very far away": 1e30,
    "beyond squaring": -1e200, "largest": 1.7e308,
}  # fmt: skip


@pytest.mark.parametrize("value", NONSENSE.values(), ids=NONSENSE.keys())
@pytest.mark.parametrize("tracker", [1, 2])
def test_positions_that_cannot_be_count_as_masked(localreg, trackers, tracker, value):
    state = localreg.init(trackers.frame(0))
    frame = trackers.frame(1)
    broken = frame._replace(positions=frame.positions.copy())
    broken.positions[tracker, 1] = value
    masked = only(frame, np.arange(6) != tracker, ALL)
    assert_equal_poses(localreg.step(state, broken)[1], localreg.step(state, masked)[1])


@pytest.mark.parametrize(
    "value",
    [np.zeros(4), np.full(4, np.nan), np.full(4, np.inf), np.array([1e200, 0, 0, 1e200]),
     np.array([0.1, 0, 0, 0])],
    ids=["zero", "nan", "infinity", "huge", "short"],
)  # fmt: skip
@pytest.mark.parametrize("tracker", [1, 2])
def test_quaternions_that_are_none_count_as_masked(localreg, trackers, tracker, value):
    state = localreg.init(trackers.frame(0))
    frame = trackers.frame(1)
    broken = frame._replace(quaternions=frame.quaternions.copy())
    broken.quaternions[tracker] = value
    masked = only(frame, ALL, np.arange(6) != tracker)
    assert_equal_poses(localreg.step(state, broken)[1], localreg.step(state, masked)[1])


def test_quaternions_a_little_off_unit_length_are_mended(localreg, trackers):
    state = localreg.init(trackers.frame(0))
    frame = trackers.frame(1)
    longer = frame._replace(quaternions=-1.003 * frame.quaternions)
    one, other = localreg.step(state, frame)[1], localreg.step(state, longer)[1]
    np.testing.assert_allclose(one.qpos, other.qpos, atol=1e-9)


def masks(*seen: int) -> ndarray:
    return np.isin(np.arange(6), seen)


@pytest.mark.parametrize(
    ("positions", "orientations", "within"),
    [
        (masks(1), masks(1), 0.2),
        (masks(2), masks(2), 0.6),
        (masks(2, 3), masks(2, 3), 0.2),
        (masks(1, 4, 5), masks(1, 4, 5), 0.06),
        (ALL, masks(), 0.06),
        (masks(0, 1, 2), masks(3, 4, 5), 0.2),
    ],
    ids=["torso", "hand", "hands", "no arms", "positions", "mixed"],
)
def test_any_trackers_will_do(localreg, trackers, walk, body, positions, orientations, within):
    frames = [only(frame, positions, orientations) for frame in list(trackers)[:50]]
    session = Session(walk.qpos[:50], body, follow(localreg, frames))
    assert session.is_finite
    assert session.errors[5:].mean() < within
    assert session.joint_speeds.max() < 40.0


def test_orientations_alone_tell_the_pose_but_not_the_place(localreg, trackers, walk, body):
    frames = [only(frame, masks(), ALL) for frame in list(trackers)[:50]]
    session = Session(walk.qpos[:50], body, follow(localreg, frames))
    assert session.is_finite
    moved = session.qpos
    moved[:, :3] = walk.qpos[:50, :3]
    apart = body.bone_ends(moved) - body.bone_ends(walk.qpos[:50])
    assert np.linalg.norm(apart, axis=-1)[5:].mean() < 0.06


def test_nothing_measured_from_the_first_frame_on_is_no_error(localreg, trackers):
    poses = follow(localreg, [without(frame, *range(6)) for frame in list(trackers)[:10]])
    for pose in poses:
        assert np.all(np.isfinite(pose.qpos))
        assert np.all(np.isnan(pose.position_residuals))
        assert pose.result is Result.SOLVED


class Spy(BlockSearch):
    """Keeps the answers of a search."""

    def __init__(self, search: BlockSearch) -> None:
        vars(self).update(vars(search))
        self.rows: list[ndarray] = []

    def search(self, query: Query, count: int, without: int = -1) -> Neighbours:
        found = super().search(query, count, without)
        self.rows.append(found.rows)
        return found


def test_poses_that_are_left_out_are_never_found(localreg, trackers, database: PoseDatabase):
    """Neither in a session nor in the rehearsals before it."""
    allowed = database.exclude(subject="16") | (np.arange(len(database)) % 7 == 0)
    estimator: Synthesizer = localreg.leave_out(allowed)
    prior = estimator.prior
    assert isinstance(prior, LocalRegression)
    spy = Spy(prior.source.search)
    source = replace(prior.source, search=spy)
    noise = prior.experience.pose.noise[3 * 56 :]
    experience = learn(source, prior.settings, noise, estimator.chain)
    rehearsed = len(spy.rows)
    assert rehearsed > 0.5 * prior.settings.rehearsals
    estimator = replace(estimator, prior=replace(prior, source=source, experience=experience))
    follow(estimator, list(trackers)[:30])
    assert len(spy.rows) >= rehearsed + 31
    found = np.unique(np.concatenate(spy.rows))
    assert np.all(allowed[found])
    usable = np.zeros(len(database), dtype=bool)
    usable[database.window_targets(3)] = True
    assert np.all(usable[found])
    assert len(found) > 100


def test_leaving_out_everything_is_an_error_that_says_so(localreg, database):
    with pytest.raises(DatabaseError, match="nothing is left of the database"):
        localreg.leave_out(np.zeros(len(database), dtype=bool))


def test_a_handful_of_poses_is_enough_to_go_on(localreg, trackers, walk, body, database):
    """Fewer than the neighbours asked for: the rest of the shape is filled."""
    allowed = np.zeros(len(database), dtype=bool)
    allowed[40:48] = True
    frames = list(trackers)[:20]
    session = Session(walk.qpos[:20], body, follow(localreg.leave_out(allowed), frames))
    assert session.is_finite
    assert session.errors[5:].max() < 0.15


def test_a_failed_frame_leaves_a_pose_and_a_state_to_go_on_from(localreg, trackers, walk, body):
    """A belief that has become nonsense, however that came about."""
    state = localreg.init(trackers.frame(0))
    state = localreg.step(state, trackers.frame(1))[0]
    broken = state._replace(velocity=np.full(6, np.nan), covariance=np.full((62, 62), np.nan))
    after, pose = localreg.step(broken, trackers.frame(2))
    assert pose.result is Result.FAILED
    assert np.all(np.isfinite(pose.qpos))
    frames = list(trackers)[3:14]
    session = Session(walk.qpos[3:14], body, follow(localreg, frames, after))
    assert session.is_finite
    assert session.errors[-1] < 0.02


@pytest.mark.parametrize("heading", [0.0, 2.0, np.pi])
@pytest.mark.parametrize("index", [0, 40, 80])
def test_positions_alone_tell_the_first_pose_and_which_way_it_faces(
    heading, index, localreg, trackers, walk
):
    away, everybody = np.array([1.0, 2.0, 0.0]), np.ones(6, dtype=bool)
    frame = only(moved_frame(list(trackers)[index], heading, away), everybody, ~everybody)
    truth = moved_pose(walk.qpos[index : index + 1], heading, away)[0]
    found = localreg.init(frame).qpos
    assert 2.0 * np.arccos(abs(found[3:7] @ truth[3:7])) < np.radians(10.0)
    assert np.abs(found[7:] - truth[7:]).mean() < np.radians(4.0)


def test_methods_without_a_database_begin_from_positions_too(localreg, trackers, subject):
    everybody = np.ones(6, dtype=bool)
    frame = only(trackers.frame(0), everybody, ~everybody)
    estimator = build_estimator("ik", subject)
    assert np.isfinite(estimator.init(frame).qpos).all()
