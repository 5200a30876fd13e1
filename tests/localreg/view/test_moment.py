"""Moments: measured against predicted, masks, and the trails behind."""

import pickle

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from localreg.body.model import build_model, tracker_site
from localreg.view.moment import Heard, Moment, Observer
from tests.localreg.body.random_body import random_poses, random_subject


def test_predictions_are_mujocos_and_errors_are_what_was_put_in() -> None:
    subject = random_subject(3)
    pose = random_poses(4, 1)[0]
    model = build_model(subject)
    data = mujoco.MjData(model)
    data.qpos[:] = pose
    mujoco.mj_kinematics(model, data)
    observer = Observer(subject)
    frame = observer.worn(1.5, pose)
    rng = np.random.default_rng(0)
    offsets = rng.normal(scale=0.05, size=frame.positions.shape)
    turns = Rotation.from_rotvec(rng.normal(scale=0.3, size=frame.positions.shape))
    turned = turns * Rotation.from_quat(frame.quaternions, scalar_first=True)
    # The same rotation, written with the other sign.
    quaternions = -turned.as_quat(scalar_first=True)
    frame = frame._replace(positions=frame.positions + offsets, quaternions=quaternions)
    moment = observer.observe(1.5, pose, frame)
    assert [tracker.name for tracker in moment.trackers] == list(subject.trackers)
    for tracker, offset, turn in zip(moment.trackers, offsets, turns, strict=True):
        site = data.site(tracker_site(tracker.name))
        np.testing.assert_allclose(tracker.predicted_position, site.xpos, atol=1e-12)
        assert tracker.distance == pytest.approx(np.linalg.norm(offset))
        assert tracker.angle == pytest.approx(turn.magnitude(), abs=1e-6)
        assert tracker.status == "measured"


def test_what_was_not_measured_has_no_error() -> None:
    subject = random_subject(3, trackers=4)
    pose = random_poses(5, 1)[0]
    observer = Observer(subject)
    frame = observer.worn(0.0, pose)._replace(
        position_mask=np.array([True, True, False, False]),
        orientation_mask=np.array([True, False, True, False]),
    )
    heard = {subject.trackers[1]: Heard(rate=60.0, age=0.01)}
    moment = observer.observe(0.0, pose, frame, heard=heard)
    statuses = [tracker.status for tracker in moment.trackers]
    assert statuses == ["measured", "position only", "orientation only", "masked"]
    assert [tracker.is_masked for tracker in moment.trackers] == [False, False, False, True]
    assert np.isnan([tracker.distance for tracker in moment.trackers]).tolist() == [
        False, False, True, True,
    ]  # fmt: skip
    assert np.isnan([tracker.angle for tracker in moment.trackers]).tolist() == [
        False, True, False, True,
    ]  # fmt: skip
    assert (moment.trackers[1].rate, moment.trackers[1].age) == (60.0, 0.01)
    assert np.isnan(moment.trackers[0].rate)


def test_trails_go_back_so_far_and_end_at_jumps() -> None:
    subject = random_subject(6, trackers=3)
    observer = Observer(subject, trail_seconds=0.5, trail_of=subject.trackers[:2])
    poses = random_poses(6, 1).repeat(100, axis=0)
    poses[:, 0] = np.arange(100) / 40.0

    def observe(index: int, **how: bool) -> Moment:
        return observer.observe(index / 40.0, poses[index], **how)

    assert observe(0).trails == ()
    for index in range(1, 60):
        moment = observe(index)
    assert len(moment.trails) == 2
    for trail in moment.trails:
        assert len(trail) <= 20
        # One metre a second for at most half a second, up to now, in order.
        assert 0.4 < trail[-1, 0] - trail[0, 0] <= 0.5
        assert np.all(np.diff(trail[:, 0]) > 0)
    assert observe(60, is_start=True).trails == ()
    assert len(observe(61).trails[0]) == 2
    assert observe(10).trails == (), "backwards is a jump"
    assert observe(90).trails == (), "and so is a leap"


def test_a_body_that_is_elsewhere_at_once_leaves_no_trail() -> None:
    """As where a clip follows another; a sprinter leaves one."""
    subject = random_subject(8, trackers=6)
    observer = Observer(subject)
    qpos = random_poses(8, 1)[0]
    for index in range(10):
        qpos[0] += 10.0 / 40.0  # a sprinter's 10 m/s
        assert len(observer.observe(index / 40.0, qpos).trails) == (6 if index else 0)
    qpos[1] += 1.5
    assert observer.observe(10 / 40.0, qpos).trails == ()


def test_moments_go_to_other_processes() -> None:
    subject = random_subject(1)
    pose = random_poses(1, 1)[0]
    observer = Observer(subject)
    moment = observer.observe(2.0, pose, observer.worn(2.0, pose))
    copy = pickle.loads(pickle.dumps(moment))  # noqa: S301
    np.testing.assert_array_equal(copy.qpos, moment.qpos)
    assert copy.trackers[0].distance == moment.trackers[0].distance
