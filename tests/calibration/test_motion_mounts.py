"""Mounts read from motion, with an estimator that is told the truth or a habit off it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.motion_mounts import HABIT, apart, check_mounts, read_mount, with_readings
from calibration.poses import EIGHT_POSES
from localreg.body.skeleton import DOF_NAMES
from localreg.body.subject import CalibrationRecord, Mount, canonical_subject
from localreg.errors import LocalregError
from localreg.evaluation.body_points import BodyPoints
from localreg.synthesis.estimator import Estimator, Pose, Result
from sensors.pose import TrackerFrame

FRAMES = 120
TRUE = canonical_subject()


def poses():
    """A body that swings between two of the poses."""
    share = 0.5 - 0.5 * np.cos(np.linspace(0.0, 4.0 * np.pi, FRAMES))[:, None]
    return (1.0 - share) * EIGHT_POSES[0].qpos() + share * EIGHT_POSES[3].qpos()


QPOS = poses()
QPOS[:, 3:7] /= np.linalg.norm(QPOS[:, 3:7], axis=1, keepdims=True)


def frames(person, seed=0):
    seen = BodyPoints(person).tracker_poses(QPOS)
    rng = np.random.default_rng(seed)
    mask = np.ones(6, bool)
    return [
        TrackerFrame(
            i / 40.0, seen.positions[i] + rng.normal(0.0, 0.003, (6, 3)), seen.quaternions[i],
            mask, mask,
        )
        for i in range(FRAMES)
    ]  # fmt: skip


class Knowing(Estimator[None]):
    """Knows the pose of every instant up to a constant habit; looks at no tracker."""

    rate = 40.0

    def __init__(self, subject, habit=0.0):
        self.subject = subject
        self._habit = habit

    def init(self, frame):
        return None

    def step(self, state, frame) -> tuple[None, Pose]:
        qpos = QPOS[round(frame.time * 40.0)].copy()
        qpos[7 + DOF_NAMES.index("lhandrx")] += self._habit
        nothing: Any = np.full(6, np.nan)
        return None, Pose(frame.time, qpos, nothing, nothing, 1.0, np.zeros(56), 1, Result.SOLVED)


def slipped(distance=0.0, degrees=0.0, tracker=2):
    mounts = list(TRUE.mounts)
    old = mounts[tracker]
    turn = Rotation.from_euler("y", degrees, degrees=True).as_quat(scalar_first=True)
    x, y, z = old.position
    mounts[tracker] = Mount(old.tracker, old.bone, (x + distance, y, z), tuple(turn.tolist()))
    return replace(TRUE, mounts=tuple(mounts))


def test_a_mount_is_read_where_it_is():
    person = slipped(0.03, 20.0)
    reading = read_mount(Knowing(TRUE), frames(person), "lhand")
    distance, turn = reading.away(person.mounts[2])
    assert distance < 0.002
    assert turn < np.radians(0.5)
    assert reading.position_sd >= HABIT[0]
    assert reading.turn_sd >= HABIT[1]


def test_who_has_not_slipped_is_left_alone():
    checks = check_mounts(TRUE, Knowing, frames(TRUE))
    assert [check.tracker for check in checks] == list(TRUE.trackers)
    assert not any(check.has_slipped for check in checks)
    with_habit = check_mounts(TRUE, lambda s: Knowing(s, habit=np.radians(8.0)), frames(TRUE))
    assert not any(check.has_slipped for check in with_habit)


@pytest.mark.parametrize(("distance", "degrees"), [(0.0, 35.0), (0.12, 0.0), (0.1, 40.0)])
def test_a_slipped_tracker_is_named(distance, degrees):
    checks = check_mounts(TRUE, Knowing, frames(slipped(distance, degrees)))
    assert [check.tracker for check in checks if check.has_slipped] == ["lhand"]
    lhand = checks[2]
    assert lhand.distance == pytest.approx(distance, abs=0.003)
    assert np.degrees(lhand.turn) == pytest.approx(degrees, abs=1.0)


def test_two_slipped_trackers_are_both_named():
    person = slipped(0.0, 40.0)
    mounts = list(person.mounts)
    mounts[5] = slipped(0.15, 0.0, tracker=5).mounts[5]
    checks = check_mounts(TRUE, Knowing, frames(replace(person, mounts=tuple(mounts))))
    assert [check.tracker for check in checks if check.has_slipped] == ["lhand", "rankle"]


def test_slipped_trackers_are_read_anew_and_the_rest_left_alone():
    person = slipped(0.12, 40.0)
    begun = with_readings(TRUE, Knowing, frames(person), ["lhand"])
    distance, turn = apart(begun.mounts[2], person.mounts[2])
    assert distance < 0.003
    assert turn < np.radians(1.0)
    assert begun.mounts[:2] == TRUE.mounts[:2]
    assert begun.mounts[3:] == TRUE.mounts[3:]
    assert with_readings(TRUE, Knowing, [], []) is TRUE


def test_what_the_file_knows_badly_is_no_slip():
    vague = CalibrationRecord(
        date="2026-01-01",
        position_sd=dict.fromkeys(TRUE.trackers, (0.1, 0.1, 0.1)),
        orientation_sd=dict.fromkeys(TRUE.trackers, (0.5, 0.5, 0.5)),
    )
    seen = frames(slipped(0.12, 40.0))
    assert check_mounts(TRUE, Knowing, seen)[2].has_slipped
    assert not check_mounts(replace(TRUE, calibration=vague), Knowing, seen)[2].has_slipped


def test_too_little_motion_and_hidden_trackers_are_said():
    with pytest.raises(LocalregError, match="too few"):
        read_mount(Knowing(TRUE), frames(TRUE)[:20], "lhand")
    hidden = [f._replace(position_mask=np.arange(6) != 2) for f in frames(TRUE)]
    with pytest.raises(LocalregError, match="hardly seen"):
        read_mount(Knowing(TRUE), hidden, "lhand")
