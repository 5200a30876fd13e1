"""Re-centring: where the performer ends up, and that nothing else changes."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from localreg.body.subject import canonical_subject
from localreg.evaluation.body_points import BodyPoints
from localreg.live.recenter import Recentering, facing_ahead, placed
from tests.localreg.live.poses import live_pose, random_qpos

SUBJECT = canonical_subject()
UPRIGHT = Rotation.from_quat([0.5**0.5, 0.5**0.5, 0.0, 0.0], scalar_first=True)


def standing(heading_deg: float, x: float = 1.5, y: float = -2.0) -> np.ndarray:
    qpos = random_qpos(0)
    turn = Rotation.from_euler("z", heading_deg, degrees=True) * UPRIGHT
    qpos[:3] = x, y, 0.95
    qpos[3:7] = turn.as_quat(scalar_first=True)
    return qpos


@pytest.mark.parametrize("heading", [0.0, 35.0, 90.0, 179.0, -120.0])
def test_the_performer_stands_at_the_origin_and_faces_ahead(heading: float):
    live = live_pose(SUBJECT, standing(heading))
    there = placed(live, facing_ahead(live.pose.qpos)).pose.qpos
    np.testing.assert_allclose(there[:3], [0.0, 0.0, 0.95], atol=1e-12)
    facing = Rotation.from_quat(there[3:7], scalar_first=True).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(facing, [1.0, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_body_and_trackers_move_as_one(seed: int):
    live = live_pose(SUBJECT, random_qpos(seed))
    there = placed(live, facing_ahead(live.pose.qpos))
    trackers = BodyPoints(SUBJECT).tracker_poses(there.pose.qpos[None])
    np.testing.assert_allclose(there.frame.positions, trackers.positions[0], atol=1e-9)
    again = Rotation.from_quat(trackers.quaternions[0], scalar_first=True)
    turns = Rotation.from_quat(there.frame.quaternions, scalar_first=True)
    assert (again.inv() * turns).magnitude().max() < 1e-7
    np.testing.assert_array_equal(there.pose.qpos[7:], live.pose.qpos[7:])


def test_somebody_on_the_back_lies_with_the_head_behind():
    lying = standing(0.0)
    turn = Rotation.from_quat(lying[3:7], scalar_first=True)
    on_back = Rotation.from_euler("z", 50.0, degrees=True) * Rotation.from_euler(
        "x", -90.0, degrees=True
    )
    lying[3:7] = (on_back * turn).as_quat(scalar_first=True)
    there = placed(live_pose(SUBJECT, lying), facing_ahead(lying)).pose.qpos
    up = Rotation.from_quat(there[3:7], scalar_first=True).apply([0.0, 1.0, 0.0])
    belly = Rotation.from_quat(there[3:7], scalar_first=True).apply([0.0, 0.0, 1.0])
    np.testing.assert_allclose(belly, [0.0, 0.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(up, [-1.0, 0.0, 0.0], atol=1e-9)


def test_nothing_moves_before_it_is_asked_for_and_all_after():
    told = []
    recentering = Recentering()
    recentering.on_change = lambda live, transform: told.append((live.instant, transform))
    poses = [live_pose(SUBJECT, standing(40.0, x=0.1 * n), n) for n in range(4)]
    assert recentering(poses[0]) is poses[0]
    recentering.request()
    held = poses[1]._replace(is_held=True)
    assert recentering(held) is held
    np.testing.assert_allclose(recentering(poses[2]).pose.qpos[:2], 0.0, atol=1e-12)
    moved = recentering(poses[3]).pose.qpos
    assert np.hypot(*moved[:2]) == pytest.approx(0.1)
    assert [instant for instant, _ in told] == [2]
    assert (recentering.count, recentering.transform) == (1, told[0][1])
