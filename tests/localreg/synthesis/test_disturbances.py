"""Bad days on a real walk: the body stays with the trackers, and returns to them soon."""

from dataclasses import replace

import numpy as np
import pytest

from localreg.evaluation.playback import play
from localreg.evaluation.trackers import TrackerQuality, simulate_trackers
from localreg.synthesis.estimator import Result
from localreg.synthesis.methods import METHODS, build_synthesizer
from tests.localreg.synthesis.sessions import (
    RATE,
    Session,
    follow,
    moved_frame,
    moved_pose,
    without,
)

BEGIN, SECOND = 30, round(RATE)
TORSO, LHAND, RHAND, LANKLE = 1, 2, 3, 4
FASTEST = 30.0  # joint speed [rad/s]; this walk's own fastest is 16


def test_undisturbed_it_is_near_the_truth_and_sure(undisturbed):
    assert undisturbed.is_finite
    assert undisturbed.errors[5:].mean() < 0.01
    assert undisturbed.joint_speeds.max() < FASTEST
    assert {pose.result for pose in undisturbed.poses} == {Result.SOLVED}
    assert np.mean([pose.confidence for pose in undisturbed.poses]) > 0.9


@pytest.mark.parametrize("tracker", [TORSO, RHAND, LANKLE])
def test_a_lost_tracker_is_missed_little(tracker, localreg, trackers, walk, body, undisturbed):
    end = BEGIN + SECOND
    frames = list(trackers)[: end + 12]
    frames[BEGIN:end] = [without(frame, tracker) for frame in frames[BEGIN:end]]
    session = Session(walk.qpos[: len(frames)], body, follow(localreg, frames))
    assert session.is_finite
    assert session.errors[BEGIN:end].max() < 0.08
    assert session.joint_speeds.max() < FASTEST
    after = session.errors[end + 5 :]
    assert np.all(after < undisturbed.errors[end + 5 : len(frames)] + 0.005)


def test_without_any_tracker_it_walks_on(localreg, trackers, walk, body, undisturbed):
    end = BEGIN + SECOND // 2
    frames = list(trackers)[: end + 12]
    frames[BEGIN:end] = [without(frame, *range(6)) for frame in frames[BEGIN:end]]
    session = Session(walk.qpos[: len(frames)], body, follow(localreg, frames))
    assert session.is_finite
    assert session.errors[BEGIN : BEGIN + 5].max() < 0.05
    assert session.errors[BEGIN:end].max() < 0.4
    assert session.joint_speeds[: end - 1].max() < FASTEST
    after = session.errors[end + 5 :]
    assert np.all(after < undisturbed.errors[end + 5 : len(frames)] + 0.005)


@pytest.mark.parametrize("heading", [0.0, np.pi], ids=["ahead", "turned round"])
def test_a_body_that_is_suddenly_elsewhere_is_found(heading, localreg, trackers, walk, body):
    away = np.array([2.8, -1.0, 0.0])
    frames = list(trackers)[: BEGIN + 20]
    frames[BEGIN:] = [moved_frame(frame, heading, away) for frame in frames[BEGIN:]]
    truth = walk.qpos[: len(frames)].copy()
    truth[BEGIN:] = moved_pose(truth[BEGIN:], heading, away)
    session = Session(truth, body, follow(localreg, frames))
    assert session.is_finite
    assert session.errors[BEGIN + 10 :].max() < 0.03


@pytest.mark.parametrize(
    ("tracker", "within"), [(0, 0.015), (TORSO, 0.02), (LHAND, 0.08), (LANKLE, 0.03)]
)
def test_a_tracker_that_jumps_does_not_drag_the_body(
    tracker, within, localreg, trackers, walk, body
):
    """30 cm off for a second: the bones at the tracker's may follow a little, no others."""
    end = BEGIN + SECOND
    frames = list(trackers)[: end + 20]
    for index in range(BEGIN, end):
        positions = frames[index].positions.copy()
        positions[tracker, 0] += 0.3
        frames[index] = frames[index]._replace(positions=positions)
    session = Session(walk.qpos[: len(frames)], body, follow(localreg, frames))
    assert session.is_finite
    assert session.errors[BEGIN:end].max() < within
    assert session.errors[end + 15 :].max() < 0.02


@pytest.mark.parametrize("away", [1.0, 5.0, 100.0])
@pytest.mark.parametrize("tracker", [TORSO, RHAND])
def test_a_tracker_that_reports_another_place_does_not_tear_the_body(
    tracker, away, localreg, trackers, walk, body
):
    """As when a lost tracker reports the corner of the room, or worse, for half a second."""
    end = BEGIN + SECOND // 2
    frames = list(trackers)[: end + 20]
    for index in range(BEGIN, end):
        positions = frames[index].positions.copy()
        positions[tracker, 1] -= away
        frames[index] = frames[index]._replace(positions=positions)
    session = Session(walk.qpos[: len(frames)], body, follow(localreg, frames))
    assert session.is_finite
    assert session.errors[BEGIN:end].max() < 0.2
    assert session.joint_speeds.max() < 60.0
    assert session.errors[end + 15 :].max() < 0.03


@pytest.mark.parametrize("heading", [0.0, 2.0, np.pi])
def test_a_cold_start_far_from_everything_needs_a_few_frames(
    heading, localreg, trackers, walk, body
):
    away = np.array([40.0, -7.0, 0.0])
    frames = [moved_frame(frame, heading, away) for frame in list(trackers)[20:35]]
    truth = moved_pose(walk.qpos[20:35], heading, away)
    session = Session(truth, body, follow(localreg, frames))
    assert session.errors[10:].max() < 0.03


def test_a_start_that_is_wrong_is_mended(localreg, trackers, walk, body):
    """Told to be elsewhere, turned half round, in a pose half a second old."""
    wrong = moved_pose(walk.qpos[20:21], np.pi, np.array([3.0, 0.0, 0.5]))[0]
    poses = follow(localreg, list(trackers)[40:55], localreg.init_at(wrong))
    session = Session(walk.qpos[40:55], body, poses)
    assert session.is_finite
    assert session.errors[10:].max() < 0.03


def test_noisy_trackers_are_followed_better_once_that_is_known(walk, database):
    start = walk.first(80)
    quality = TrackerQuality(noise_position=0.02, noise_orientation=np.radians(3.0))
    trackers, errors = simulate_trackers(start, quality), []
    knowing = replace(METHODS["localreg"], sigma_position=0.02, sigma_orientation=np.radians(3.0))
    for settings in (METHODS["localreg"], knowing):
        found = play(build_synthesizer(settings, walk.subject, database), trackers).qpos
        errors.append(np.abs(found - start.qpos)[5:, 7:].mean())
    assert errors[1] < 0.9 * errors[0]
