"""Poses of a recorded take, solved again: the same to the last bit, or better.

With the recorded method, settings, subject and database, a take is repeated exactly. Two
things of a live run depend on the clock: which samples had come when a frame was closed, and
whether a body that was being found was found in time. The recording holds both.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.skeleton import DOF_COUNT
from localreg.body.subject import Subject
from localreg.errors import LocalregError
from localreg.live.performance import Performance
from localreg.live.performance_config import PerformanceConfig
from localreg.live.sinks import Collector, LivePose
from localreg.live.smooth import smooth
from localreg.live.take import PASSED_OVER, Take
from localreg.motion.motion import Motion, Provenance
from localreg.synthesis.estimator import AnyEstimator
from sensors.assembler import AssembledFrame

Progress = Callable[[int, int, str], None]


@dataclass(frozen=True, eq=False)
class Retake:
    """What came of it.

    Attributes:
        collected: the poses, before any placement.
        sigma: standard deviation of the joint angles of each of them [rad].
    """

    collected: Collector
    sigma: Float[ndarray, "frames 56"]

    def motion(self, take: Take, subject: Subject, path: Path, cutoff: float | None) -> Motion:
        """The poses at a steady rate, placed as they were published.

        Args:
            take: says where poses were placed, and at which rate.
            subject: whose body it is.
            path: the recording, for the motion's name.
            cutoff: smooth with this cutoff [Hz]; None for not at all.

        Raises:
            LocalregError: there is not one pose, or the cutoff cannot be.
        """
        rate = float(take.database["rate"])
        rows = self.collected.rows_on_grid()
        motion = self.collected.motion(subject, rate, path.stem)
        instants = np.arange(len(rows)) + self.collected.indices[0]
        qpos = motion.qpos.copy()
        if cutoff is not None:
            repeated = self.collected.indices[rows] != instants
            held = self.collected.held[rows] | repeated
            starts = self.collected.starts[rows] & ~repeated
            qpos = smooth(qpos, self.sigma[rows], rate, held=held, starts=starts, cutoff=cutoff)
        for row, instant in enumerate(instants):
            transform = take.placement(int(instant))
            if transform is not None:
                qpos[row, :3], qpos[row, 3:7] = transform.apply(qpos[row, :3], qpos[row, 3:7])
        return Motion(qpos, rate, subject, Provenance(path.stem, source=str(path)))


def solve_again(
    frames: Iterable[AssembledFrame],
    estimator: AnyEstimator,
    config: PerformanceConfig,
    searches: Mapping[int, str] | None,
    count: int,
    progress: Progress | None = None,
) -> Retake:
    """The poses of recorded frames.

    Args:
        frames: as they were closed.
        estimator: whose poses.
        config: when to step, when to hold.
        searches: as in a `Take`, to repeat a run exactly; None lets every frame be solved
            and every body be found at once.
        count: about how many frames there are, for the progress.
        progress: is told how many frames are done.
    """
    index = -1

    def is_found(search: Future[Any], budget: float | None) -> bool:
        return searches is None or budget is None or searches.get(index) == "found"

    performance = Performance(lambda _: estimator, _AtOnce(), config=config, wait=is_found)
    collected = Collector(count + 1)
    sigmas: list[ndarray] = []
    for done, assembled in enumerate(frames):
        if len(collected) == count:
            break
        index = assembled.index
        if searches is not None and searches.get(index) == PASSED_OVER:
            continue
        outcome = performance.take(assembled.frame)
        if outcome is not None:
            collected.publish(LivePose(index, assembled.frame, *outcome))
            sigmas.append(np.asarray(outcome.pose.predicted_sigma, dtype=float))
        if progress is not None:
            progress(done + 1, max(count, done + 1), "")
    return Retake(collected, np.array(sigmas).reshape(len(sigmas), DOF_COUNT))


def largest_difference(take: Take, retake: Retake) -> float:
    """How far a repetition is from the recorded poses at most: 0 if bit for bit the same.

    Returns:
        The largest difference of any number of any pose; infinite if other frames have
        poses.

    Raises:
        LocalregError: the take holds no poses.
    """
    if not take.indices:
        raise LocalregError("the take holds no poses to compare with")
    common = min(len(take.indices), len(retake.collected))
    if tuple(retake.collected.indices[:common].tolist()) != take.indices[:common]:
        return math.inf
    if common < len(take.indices):
        return math.inf
    return float(np.abs(retake.collected.qpos[:common] - take.qpos[:common]).max())


class _AtOnce(Executor):
    """Does what it is given in the calling thread."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(fn(*args, **kwargs))
        return future
