"""A method run over the trackers of a clip, frame by frame, as it would run live."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.evaluation.trackers import SimulatedTrackers
from localreg.synthesis.estimator import AnyEstimator, Pose


@dataclass(frozen=True, eq=False)
class Playback:
    """What a method made of a clip.

    Attributes:
        poses: one for every frame; where the true first pose was given it is not among
            them, and `qpos` has it.
        qpos: the poses' `qpos`, one for every frame.
        step_ms: how long each step took [ms].
    """

    poses: tuple[Pose, ...]
    qpos: Float[ndarray, "frames 63"]
    step_ms: Float[ndarray, " steps"]


def play(
    estimator: AnyEstimator,
    trackers: SimulatedTrackers,
    *,
    true_start: Float[ndarray, "63"] | None = None,
    progress: Callable[[int, int, str], None] | None = None,
) -> Playback:
    """Run an estimator from the first frame to the last.

    Without a true start it finds the first pose by itself; the pose of that frame is what
    a step with the same frame makes of it, whose state is then forgotten, so that the
    second frame is still the second.

    Args:
        estimator: for the subject that wears the trackers.
        trackers: at least one frame.
        true_start: the pose of the first frame, given to the method.
        progress: is told after every frame how many are done, of how many.
    """
    poses, qpos, step_ms = [], [], []
    first = trackers.frame(0)
    if true_start is None:
        state = estimator.init(first)
        pose = estimator.step(state, first)[1]
        poses.append(pose)
        qpos.append(pose.qpos)
    else:
        state = estimator.init_at(true_start)
        qpos.append(true_start)
    for index in range(1, len(trackers)):
        frame = trackers.frame(index)
        begin = time.perf_counter()
        state, pose = estimator.step(state, frame)
        step_ms.append(1e3 * (time.perf_counter() - begin))
        poses.append(pose)
        qpos.append(pose.qpos)
        if progress is not None:
            progress(index + 1, len(trackers), "")
    return Playback(tuple(poses), np.array(qpos, dtype=float), np.array(step_ms))


def warm_up(estimator: AnyEstimator, trackers: SimulatedTrackers) -> None:
    """Let everything compile that the frames of a clip need, so that no step is timed cold."""
    frame = trackers.frame(0)
    state = estimator.init(frame)
    for _ in range(2):
        state, _ = estimator.step(state, frame)
