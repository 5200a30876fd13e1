"""Frames made worse on purpose, sessions over them, and how far those are from the truth."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.database.neighbours import Query
from localreg.evaluation.body_points import BodyPoints
from localreg.synthesis.estimator import Pose
from localreg.synthesis.prior import Acquisition, Expectation, Prior
from localreg.synthesis.state import State
from localreg.synthesis.synthesizer import Synthesizer
from sensors.pose import TrackerFrame

RATE = 40.0


@dataclass(frozen=True, eq=False)
class Session:
    """Synthesized poses, frame by frame, and the true ones."""

    truth: ndarray
    body: BodyPoints
    poses: Sequence[Pose]

    @property
    def qpos(self) -> ndarray:
        return np.array([pose.qpos for pose in self.poses])

    @property
    def errors(self) -> ndarray:
        """Mean distance of the bone ends in every frame [m]."""
        ends = self.body.bone_ends(self.qpos) - self.body.bone_ends(self.truth)
        return np.linalg.norm(ends, axis=-1).mean(axis=1)

    @property
    def joint_speeds(self) -> ndarray:
        """The fastest joint angle in every frame but the first [rad/s]."""
        return RATE * np.abs(np.diff(self.qpos[:, 7:], axis=0)).max(axis=1)

    @property
    def is_finite(self) -> bool:
        sigma = np.array([pose.predicted_sigma for pose in self.poses])
        return bool(np.all(np.isfinite(self.qpos)) & np.all(np.isfinite(sigma)))


def follow(
    estimator: Synthesizer, frames: Iterable[TrackerFrame], state: State | None = None
) -> list[Pose]:
    """The poses of some frames, from the first alone or from a state."""
    poses = []
    for frame in frames:
        if state is None:
            state = estimator.init(frame)
        state, pose = estimator.step(state, frame)
        poses.append(pose)
    return poses


@dataclass(frozen=True, eq=False)
class Watched(Prior):
    """A prior that tells every question and answer."""

    prior: Prior
    tell: Callable[[Query, State, Expectation], None]

    def expect(self, query: Query, state: State) -> Expectation:
        answer = self.prior.expect(query, state)
        self.tell(query, state, answer)
        return answer

    def conclude(self, expectation: Expectation, qpos: ndarray, covariance: ndarray) -> Any:
        return self.prior.conclude(expectation, qpos, covariance)

    def acquire(self, query: Query) -> Acquisition:
        return self.prior.acquire(query)


def watched(
    estimator: Synthesizer, tell: Callable[[Query, State, Expectation], None]
) -> Synthesizer:
    """The estimator, telling what its prior is asked and answers in every step."""
    return replace(estimator, prior=Watched(estimator.prior, tell))


def only(frame: TrackerFrame, positions: ndarray, orientations: ndarray) -> TrackerFrame:
    """The frame with only some trackers measured, and nonsense for the others."""
    return frame._replace(
        positions=np.where(positions[:, None], frame.positions, 123.0),
        quaternions=np.where(orientations[:, None], frame.quaternions, [0.6, 0.0, 0.8, 0.0]),
        position_mask=frame.position_mask & positions,
        orientation_mask=frame.orientation_mask & orientations,
    )


def without(frame: TrackerFrame, *trackers: int) -> TrackerFrame:
    kept = ~np.isin(np.arange(len(frame.positions)), trackers)
    return only(frame, kept, kept)


def moved_frame(frame: TrackerFrame, heading: float, away: ndarray) -> TrackerFrame:
    """What the trackers would say elsewhere in the room."""
    turn = Rotation.from_rotvec([0.0, 0.0, heading])
    turned = turn * Rotation.from_quat(frame.quaternions, scalar_first=True)
    return frame._replace(
        positions=turn.apply(frame.positions) + away,
        quaternions=turned.as_quat(scalar_first=True),
    )


def moved_pose(qpos: ndarray, heading: float, away: ndarray) -> ndarray:
    """Poses (frames, 63) elsewhere in the room."""
    turn = Rotation.from_rotvec([0.0, 0.0, heading])
    root = turn * Rotation.from_quat(qpos[:, 3:7], scalar_first=True)
    return np.hstack([turn.apply(qpos[:, :3]) + away, root.as_quat(scalar_first=True), qpos[:, 7:]])
