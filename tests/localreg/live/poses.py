"""Published poses for tests of sinks: random bodies, random trackers, exact kinematics."""

import numpy as np

from localreg.body.skeleton import QPOS_SIZE, joint_limits
from localreg.body.subject import Subject
from localreg.evaluation.body_points import BodyPoints
from localreg.live.sinks import LivePose
from localreg.synthesis.estimator import Pose, Result
from sensors.pose import TrackerFrame


def random_qpos(seed: int) -> np.ndarray:
    """A pose within the joint limits, anywhere, turned anyhow."""
    rng = np.random.default_rng(seed)
    qpos = np.zeros(QPOS_SIZE)
    qpos[:3] = rng.uniform(-3.0, 3.0, 3)
    quaternion = rng.normal(size=4)
    qpos[3:7] = quaternion / np.linalg.norm(quaternion)
    limits = joint_limits()
    qpos[7:] = rng.uniform(limits[:, 0], limits[:, 1])
    return qpos


def live_pose(
    subject: Subject, qpos: np.ndarray, n: int = 0, rate: float = 40.0, held: bool = False
) -> LivePose:
    """The pose published as frame n, with the trackers where they belong."""
    J = len(subject.trackers)
    poses = BodyPoints(subject).tracker_poses(qpos[None])
    mask = np.ones(J, dtype=np.bool_)
    frame = TrackerFrame(
        100.0 + n / rate, poses.positions[0], poses.quaternions[0], mask, mask.copy()
    )
    pose = Pose(
        frame.time, qpos, np.zeros(J), np.zeros(J), 1.0, np.full(56, 0.05), 1, Result.SOLVED
    )
    return LivePose(n, frame, pose, held, n == 0)
