"""Every method by its name, other trackers than the usual, and errors that help."""

from dataclasses import replace

import numpy as np
import pytest

from localreg.body.subject import Mount
from localreg.errors import SynthesisError
from localreg.evaluation.trackers import simulate_trackers
from localreg.synthesis.methods import METHODS, build_estimator
from localreg.synthesis.settings import Settings
from localreg.synthesis.synthesizer import Synthesizer
from tests.localreg.synthesis.sessions import Session, follow


@pytest.mark.parametrize(
    ("method", "within"), [("localreg", 0.01), ("paper", 0.03), ("joint", 0.03), ("ik", 0.04)]
)
def test_methods_follow_a_walk(method, within, estimator_of, trackers, walk, body):
    """Given the true first pose; how well they start by themselves is another matter."""
    estimator: Synthesizer = estimator_of(method)
    state = estimator.init_at(walk.qpos[0])
    session = Session(walk.qpos[1:50], body, follow(estimator, list(trackers)[1:50], state))
    assert session.is_finite
    assert session.errors.mean() < within
    assert session.joint_speeds.max() < 60.0
    residuals = np.array([pose.position_residuals for pose in session.poses])
    assert residuals.mean() < 0.015
    has_database = METHODS[method].prior != "ik"
    assert all(np.isfinite(pose.confidence) == has_database for pose in session.poses)


def test_inverse_kinematics_starts_by_itself(estimator_of, trackers, walk, body):
    session = Session(walk.qpos[:5], body, follow(estimator_of("ik"), list(trackers)[:5]))
    assert session.errors[-1] < 0.08


def test_inverse_kinematics_has_nothing_to_leave_out(estimator_of):
    estimator = estimator_of("ik")
    assert estimator.leave_out(np.zeros(3, dtype=bool)) is estimator


def test_two_trackers_on_any_bones(walk, database, body):
    """A belt and a wrist, turned anyhow: none of the usual six."""
    mounts = (
        Mount("wrist", "rradius", (0.05, 0.01, -0.02), (0.5, -0.5, 0.5, 0.5)),
        Mount("belt", "root", (0.0, 0.1, 0.12), (0.0, 0.6, 0.0, 0.8)),
    )
    subject = replace(walk.subject, mounts=mounts)
    estimator = build_estimator("localreg", subject, database)
    frames = list(simulate_trackers(replace(walk, subject=subject)))[:40]
    session = Session(walk.qpos[:40], body, follow(estimator, frames))
    assert session.is_finite
    assert session.errors[5:].mean() < 0.1
    residuals = np.array([pose.position_residuals for pose in session.poses])
    assert residuals.shape == (40, 2)
    assert residuals[5:].mean() < 0.02


def test_an_unknown_method_is_told_which_there_are(walk, database):
    with pytest.raises(SynthesisError) as caught:
        build_estimator("magic", walk.subject, database)
    for name in ("magic", "localreg", "paper", "joint", "ik"):
        assert name in str(caught.value)


@pytest.mark.parametrize("method", ["localreg", "paper", "joint"])
def test_a_method_that_learns_needs_a_database(method, walk):
    with pytest.raises(SynthesisError, match="needs a database; build one first"):
        build_estimator(method, walk.subject)


def test_settings_that_contradict_themselves_are_refused():
    with pytest.raises(SynthesisError, match="choose one of localreg, paper, joint, ik"):
        Settings(prior="magic")
    with pytest.raises(SynthesisError, match="one weight for each of the 3 past poses"):
        Settings(metric_history=(1.0, 0.5))
