"""mink, the inverse kinematics that people would use instead, behind the estimator interface.

mink solves a quadratic program for a small step of the joints, again and again: one task for
each tracker, weighted by the same deviations as everywhere else, hard joint limits from
anatomy, and a posture task that draws towards a posture.
"""

import logging
import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import mink
import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.model import build_model, tracker_site
from localreg.body.skeleton import DOF_COUNT
from localreg.body.subject import Subject
from localreg.synthesis.estimator import Estimator, Pose, Result
from sensors.pose import TrackerFrame

_FIRST_ROUNDS: Final = 100  # steps from each start of the first frame
_ENOUGH: Final = 1e-4  # a step smaller than this, root and joints alike, changes nothing


class MinkSettings(NamedTuple):
    """What is tuned.

    Attributes:
        posture: standard deviation of the joints about the posture [rad].
        is_previous: whether the posture is the previous pose; else the standing one.
        rounds: steps a frame, at most.
        damping: of the quadratic program.
    """

    posture: float = float(np.radians(6.0))
    is_previous: bool = True
    rounds: int = 5
    damping: float = 1e-6


class MinkState(NamedTuple):
    """The last pose."""

    qpos: Float[ndarray, "63"]


@dataclass(frozen=True, eq=False)
class MinkEstimator(Estimator[MinkState]):
    """mink over a subject's trackers.

    Attributes:
        subject: whose body is moved.
        rate: frames a second [Hz].
        starts: joint angles that the first frame is tried from; the first is the standing
            posture [rad].
        settings: what is tuned.
        sigma_position: what a tracker's position is believed to be off by [m].
        sigma_orientation: the same for orientation [rad].
    """

    subject: Subject
    rate: float
    starts: Float[ndarray, "S 56"]
    settings: MinkSettings
    sigma_position: float = 0.005
    sigma_orientation: float = float(np.radians(1.0))

    def init(self, frame: TrackerFrame) -> MinkState:
        """The best of all starts, each placed where the trackers are."""
        found = []
        for angles in self.starts:
            start = self._placed(angles, frame)
            # Nothing is known of before, so the pull is to the standing posture.
            found.append(self._solve(start, self.starts[0], frame, _FIRST_ROUNDS)[0])
        costs = [self._cost(qpos, frame) for qpos in found]
        return MinkState(found[int(np.argmin(costs))])

    def init_at(self, qpos: Float[ndarray, "63"]) -> MinkState:
        """Begin from a known pose."""
        return MinkState(qpos.copy())

    def step(self, state: MinkState, frame: TrackerFrame) -> tuple[MinkState, Pose]:
        """From the last pose towards the trackers."""
        posture = state.qpos[7:] if self.settings.is_previous else self.starts[0]
        qpos, rounds = self._solve(state.qpos, posture, frame, self.settings.rounds)
        positions, _ = self._trackers_of(qpos)
        distance = np.linalg.norm(positions - frame.positions, axis=1)
        pose = Pose(
            time=frame.time,
            qpos=qpos,
            position_residuals=np.where(frame.position_mask, distance, np.nan),
            orientation_residuals=np.full(len(distance), np.nan),
            confidence=float("nan"),
            predicted_sigma=np.full(DOF_COUNT, np.nan),
            steps=rounds,
            result=Result.SOLVED,
        )
        return MinkState(qpos), pose

    @cached_property
    def _problem(self) -> tuple[Any, list[Any], Any, list[Any]]:
        """Configuration, tracker tasks, posture task, limits: made once, targets change."""
        model = build_model(self.subject)
        tasks = [
            mink.FrameTask(tracker_site(name), "site", position_cost=1.0, orientation_cost=1.0)
            for name in self.subject.trackers
        ]
        posture = mink.PostureTask(model, cost=1.0 / self.settings.posture)
        return mink.Configuration(model), tasks, posture, [mink.ConfigurationLimit(model)]

    def _solve(
        self,
        start: Float[ndarray, "63"],
        posture: Float[ndarray, "56"],
        frame: TrackerFrame,
        rounds: int,
    ) -> tuple[Float[ndarray, "63"], int]:
        configuration, tasks, posture_task, limits = self._problem
        low, high = configuration.model.jnt_range[1:].T
        configuration.update(np.concatenate([start[:7], np.clip(start[7:], low, high)]))
        posture_task.set_target(np.concatenate([start[:7], posture]))
        for index, task in enumerate(tasks):
            task.set_position_cost(frame.position_mask[index] / self.sigma_position)
            task.set_orientation_cost(frame.orientation_mask[index] / self.sigma_orientation)
            pose = np.concatenate([frame.quaternions[index], frame.positions[index]])
            task.set_target(mink.SE3(pose))
        done = 0
        while done < rounds:
            done += 1
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    velocity = mink.solve_ik(
                        configuration, [*tasks, posture_task], 1.0, "daqp",
                        damping=self.settings.damping, limits=limits,
                    )  # fmt: skip
            except mink.NoSolutionFound:
                break
            configuration.integrate_inplace(velocity, 1.0)
            if np.abs(velocity).max() < _ENOUGH:
                break
        return configuration.q.copy(), done

    def _cost(self, qpos: Float[ndarray, "63"], frame: TrackerFrame) -> float:
        """Squared deviations from trackers and standing posture, all in their sigmas."""
        positions, rotations = self._trackers_of(qpos)
        turn = rotations.inv() * Rotation.from_quat(frame.quaternions, scalar_first=True)
        position = np.linalg.norm(positions - frame.positions, axis=1) / self.sigma_position
        orientation = turn.magnitude() / self.sigma_orientation
        posture = (qpos[7:] - self.starts[0]) / self.settings.posture
        return float(
            np.sum(position[frame.position_mask] ** 2)
            + np.sum(orientation[frame.orientation_mask] ** 2)
            + np.sum(posture**2)
        )

    def _placed(self, angles: Float[ndarray, "56"], frame: TrackerFrame) -> Float[ndarray, "63"]:
        """A posture moved rigidly to where the trackers are (Wahba's problem)."""
        qpos = np.concatenate([np.zeros(3), [1.0, 0.0, 0.0, 0.0], angles])
        positions, rotations = self._trackers_of(qpos)
        seen = frame.position_mask
        here, there = positions[seen], frame.positions[seen]
        pairs: list[tuple[ndarray, ndarray, float]] = []
        if seen.any():
            arms = zip(there - there.mean(axis=0), here - here.mean(axis=0), strict=True)
            pairs += [(to, of, 1.0) for to, of in arms]
        measured = Rotation.from_quat(frame.quaternions, scalar_first=True)
        for index in np.flatnonzero(frame.orientation_mask).tolist():
            axes = zip(measured[index].as_matrix().T, rotations[index].as_matrix().T, strict=True)
            pairs += [(to, of, 0.1) for to, of in axes]
        to, of, weights = (np.array(part) for part in zip(*pairs, strict=True))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # one arm alone leaves a turn free
            turn = Rotation.align_vectors(to, of, weights=weights)[0]
        root = np.zeros(3)
        if seen.any():
            root = there.mean(axis=0) - turn.apply(here.mean(axis=0))
        return np.concatenate([root, turn.as_quat(scalar_first=True), angles])

    def _trackers_of(self, qpos: Float[ndarray, "63"]) -> tuple[Float[ndarray, "J 3"], Rotation]:
        model, data, sites = self._scratch
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        matrices = data.site_xmat[sites].reshape(-1, 3, 3)
        return data.site_xpos[sites].copy(), Rotation.from_matrix(matrices)

    @cached_property
    def _scratch(self) -> tuple[Any, Any, list[int]]:
        """A body of its own to ask for trackers, so that mink's is left alone."""
        model = build_model(self.subject)
        sites = [model.site(tracker_site(name)).id for name in self.subject.trackers]
        return model, mujoco.MjData(model), sites


logging.getLogger("mink").setLevel(logging.ERROR)
