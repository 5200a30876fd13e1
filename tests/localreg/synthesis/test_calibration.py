"""Predicted deviations against the errors that are made, on walks the database lacks.

History and trackers are the true ones, so that the regressions alone are judged. The step
is judged before `step_spread` and its floor widen it on purpose, to make up for errors of
consecutive frames that are alike.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy import ndarray

from localreg.body.kinematics import difference
from localreg.evaluation.trackers import TrackerQuality, simulate_trackers
from localreg.synthesis.prior import Examples, LocalRegression, Question
from localreg.synthesis.regression import kernel_weights
from localreg.synthesis.state import State, blank_state
from localreg.synthesis.synthesizer import _observe
from tests.localreg.synthesis.sessions import follow

HELD_OUT = ("16_27", "16_31", "16_58", "69_04", "69_28", "69_33")
STILL = np.radians(0.2)  # angles expected to move less are the set's clamped ones


class Standardized(NamedTuple):
    """Errors over predicted deviations, all frames and angles that are not clamped."""

    pose: ndarray
    step: ndarray


@eqx.filter_jit
def predicted(
    prior: LocalRegression, examples: Examples, question: Question, state: State
) -> tuple[jax.Array, ...]:
    examples = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype=float), examples)
    weights = kernel_weights(examples.squared_distances)
    pose = prior._pose(examples, question, weights)
    step, covariance = prior._step(examples, question, weights, state)
    sigmas = (jnp.sqrt(jnp.diagonal(part)) for part in (pose.covariance, covariance))
    return pose.mean, step, *sigmas


@pytest.fixture(scope="module")
def standardized(localreg, walks) -> dict[str, Standardized]:
    """By clip."""
    prior = eqx.tree_at(
        lambda p: (p.step_spread, p.step_floor),
        localreg.prior,
        (jnp.ones(()), jnp.zeros(62)),
    )
    found = {}
    for name in HELD_OUT:
        motion = walks[name]
        exact = TrackerQuality(noise_position=0.0, noise_orientation=0.0)
        trackers = simulate_trackers(motion, exact)
        poses, steps = [], []
        for index in range(3, len(motion), 2):
            state = blank_state(3)._replace(
                qpos=motion.qpos[index - 1],
                history=motion.angles[index - 3 : index][::-1].copy(),
                history_valid=np.ones(3, dtype=bool),
            )
            examples, question = localreg._ask(state, _observe(trackers.frame(index)))
            pose, step, sigma, step_sigma = map(
                np.asarray, predicted(prior, examples, question, state)
            )
            now, before = motion.qpos[index], motion.qpos[index - 1]
            moved = np.asarray(difference(jnp.asarray(before), jnp.asarray(now)))
            bent, stepped = sigma > STILL, step_sigma > STILL
            poses.append((now[7:] - pose)[bent] / sigma[bent])
            steps.append((moved - step)[stepped] / step_sigma[stepped])
        found[name] = Standardized(np.concatenate(poses), np.concatenate(steps))
    return found


def deviation(values: ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_errors_are_as_large_as_the_step_regression_predicts(standardized):
    parts = [clip.step for clip in standardized.values()]
    assert 0.8 < deviation(np.concatenate(parts)) < 1.25, [deviation(part) for part in parts]


def test_the_pose_regression_is_not_overconfident_with_its_floor(standardized):
    """Without its floor, errors on walks unlike the few known ones are twice as large."""
    parts = [clip.pose for clip in standardized.values()]
    assert 0.4 < deviation(np.concatenate(parts)) < 1.25, [deviation(part) for part in parts]


@pytest.mark.parametrize("which", ["pose", "step"])
@pytest.mark.parametrize("clip", HELD_OUT)
def test_no_walk_is_far_from_what_is_predicted(which, clip, standardized):
    assert 0.25 < deviation(getattr(standardized[clip], which)) < 2.5


def test_poses_are_within_what_they_say(localreg, walks):
    """The whole loop with noise: never overconfident, and not wide beyond use."""
    errors = []
    for name in HELD_OUT[:4]:
        motion = walks[name].first(80)
        poses = follow(localreg, simulate_trackers(motion))
        for pose, qpos in list(zip(poses, motion.qpos, strict=True))[5:]:
            errors.append((pose.qpos[7:] - qpos[7:]) / pose.predicted_sigma)
    assert 0.5 < deviation(np.concatenate(errors)) < 1.25
