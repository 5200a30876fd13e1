"""Compiles an estimator before the first real frame, on frames that nobody wears."""

import time

import numpy as np

from localreg.body.skeleton import QPOS_SIZE
from localreg.body.subject import Subject
from localreg.evaluation.body_points import BodyPoints
from localreg.synthesis.estimator import AnyEstimator
from localreg.synthesis.synthesizer import LOST_AFTER
from sensors.pose import TrackerFrame

_UPRIGHT = (0.5**0.5, 0.5**0.5, 0.0, 0.0)
_JUMP = 2.0
_ROUNDS = LOST_AFTER + 1  # after which a body has been sought anew


def warm_up(estimator: AnyEstimator, *, halves: bool = True) -> float:
    """Run everything a live frame can run: finding, following, blindness and losing track.

    Args:
        estimator: its copies with other poses left out share what is compiled.
        halves: whether streams may begin with positions only, or orientations only, which
            are rehearsed as such: half a second each, if that is not kept from an earlier
            start.

    Returns:
        How long it took [s].
    """
    begun = time.monotonic()
    period = 1.0 / estimator.rate
    rest = resting_frame(estimator.subject)
    away = rest._replace(positions=rest.positions + _JUMP)
    blind = masked(rest, np.zeros(len(rest.position_mask), dtype=np.bool_))
    one_lost = np.ones(len(rest.position_mask), dtype=np.bool_)
    one_lost[-1] = False
    state = estimator.init(rest)
    sequence = [rest, masked(rest, one_lost), blind, rest, *[away] * _ROUNDS, *[rest] * _ROUNDS]
    for number, frame in enumerate(sequence):
        state, _ = estimator.step(state, frame._replace(time=number * period))
    if halves:
        nothing = np.zeros(len(rest.position_mask), dtype=np.bool_)
        for half in (rest._replace(orientation_mask=nothing), rest._replace(position_mask=nothing)):
            estimator.step(estimator.init(half), half)
    estimator.init(rest)
    return time.monotonic() - begun


def resting_frame(subject: Subject) -> TrackerFrame:
    """What the trackers of a subject report that stands upright in its rest pose."""
    qpos = np.zeros((1, QPOS_SIZE))
    qpos[0, 2], qpos[0, 3:7] = 1.0, _UPRIGHT
    poses = BodyPoints(subject).tracker_poses(qpos)
    mask = np.ones(len(subject.trackers), dtype=np.bool_)
    return TrackerFrame(0.0, poses.positions[0], poses.quaternions[0], mask, mask.copy())


def masked(frame: TrackerFrame, mask: np.ndarray) -> TrackerFrame:
    """The frame with only the trackers of a mask (J,) measured."""
    return frame._replace(position_mask=mask, orientation_mask=mask.copy())
