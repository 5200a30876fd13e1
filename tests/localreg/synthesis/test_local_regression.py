"""The default prior: it knows what it knows, and learns how the step lately misled."""

from dataclasses import replace

import numpy as np
import pytest
from numpy import ndarray

from localreg.body import chain
from localreg.body.skeleton import DOF_NAMES
from localreg.evaluation.trackers import simulate_trackers
from localreg.motion.motion import Motion, Provenance
from localreg.synthesis.attention import observe
from localreg.synthesis.local_regression import LocalRegression
from localreg.synthesis.look_ahead import Drift
from localreg.synthesis.state import State, blank_state, remember
from localreg.synthesis.synthesizer import Synthesizer
from tests.localreg.database.made_motion import make_motion
from tests.localreg.synthesis.sessions import RATE, Session, follow, only, without

ALL, NONE = np.ones(6, dtype=bool), np.zeros(6, dtype=bool)


class Forgetful(LocalRegression):
    """Never remembers how the step misled."""

    def conclude(self, expectation, qpos, covariance):
        return None


@pytest.fixture
def prior(localreg: Synthesizer) -> LocalRegression:
    assert isinstance(localreg.prior, LocalRegression)
    return localreg.prior


def knowing(motion: Motion, index: int) -> State:
    """The state of one who knows the last three poses exactly."""
    state = blank_state(3, 6)
    for frame in motion.qpos[index - 3 : index]:
        state = remember(state, frame)
    return state._replace(covariance=1e-8 * np.eye(62))


def step_errors(
    localreg: Synthesizer, prior: LocalRegression, motion: Motion, *, remembering: bool
) -> ndarray:
    """How far off joints are expected ahead of every frame, when each is told the truth."""
    trackers = simulate_trackers(motion)
    drift, errors = None, []
    for index in range(3, 40):
        state = knowing(motion, index)._replace(drift=drift if remembering else None)
        query = localreg._query(state, observe(trackers.frame(index)))[0]
        expected = prior.expect(query, state)
        now = motion.qpos[index]
        errors.append(now[7:] - expected.belief.qpos[7:])
        drift = prior.conclude(expected, now, 1e-8 * np.eye(62))
    return np.array(errors)


def with_steps_too_short(prior: LocalRegression, joint: int, amount: float) -> LocalRegression:
    """One that has learned one joint to turn by the same amount too little in every step."""
    steps = prior.experience.steps
    angles = np.array(steps.angles, dtype=float)
    angles[:, joint] -= amount * np.arange(len(angles))
    short = replace(steps, angles=angles.astype(np.float32))
    return replace(prior, experience=replace(prior.experience, steps=short))


def test_a_constant_error_of_the_step_is_learned(localreg, prior, walk):
    """Of a joint whose steps are not sure anyway."""
    joint = int(np.argmax(np.diagonal(prior.experience.step_growth)[6:]))
    misled = with_steps_too_short(prior, joint, np.radians(4.0))
    learned, forgot = (
        step_errors(localreg, misled, walk, remembering=remembering)[:, joint]
        for remembering in (True, False)
    )
    assert forgot[5:].mean() == pytest.approx(np.radians(4.0), rel=0.4)
    assert abs(learned[5:].mean()) < 0.6 * abs(forgot[5:].mean())
    # Nothing is known of it in the first frame.
    assert learned[0] == forgot[0]


def test_remembering_helps_on_a_walk(localreg, prior, walk, body):
    """In a session with noise, as against a prior that forgets every time."""
    forgetful = Forgetful(**{name: getattr(prior, name) for name in prior.__dataclass_fields__})
    frames = list(simulate_trackers(walk))
    learned, forgot = (
        Session(walk.qpos, body, follow(replace(localreg, prior=each), frames)).errors[5:].mean()
        for each in (prior, forgetful)
    )
    assert learned < 1.05 * forgot


def test_what_is_remembered_is_a_covariance(localreg, trackers):
    state = localreg.init(trackers.frame(0))
    assert state.drift is None
    for index in range(12):
        state = localreg.step(state, trackers.frame(index))[0]
        drift = state.drift
        assert isinstance(drift, Drift)
        whole = np.block([[state.covariance, drift.cross], [drift.cross.T, drift.covariance]])
        scale = 1.0 / np.sqrt(np.diagonal(whole))
        correlations = scale[:, None] * whole * scale
        np.testing.assert_allclose(correlations, correlations.T, atol=1e-6)
        assert np.linalg.eigvalsh(correlations)[0] > -1e-5  # regressions are single precision


def test_a_drift_that_is_not_finite_is_forgotten(localreg, prior, trackers):
    state = localreg.init(trackers.frame(0))
    expected = prior.expect(localreg._query(state, observe(trackers.frame(1)))[0], state)
    assert expected.drift is not None
    qpos = np.full(63, np.nan)
    assert prior.conclude(expected, qpos, np.eye(62)) is None
    assert prior.conclude(expected._replace(drift=None), trackers_pose(state), np.eye(62)) is None


def trackers_pose(state: State) -> ndarray:
    return np.asarray(state.qpos, dtype=float)


def test_the_belief_is_a_sound_gaussian(localreg, prior, trackers):
    """Symmetric, positive definite, and no wider than the past alone."""
    state = localreg.init(trackers.frame(0))
    for index in range(1, 8):
        query = localreg._query(state, observe(trackers.frame(index)))[0]
        belief = prior.expect(query, state).belief
        np.testing.assert_allclose(belief.information, belief.information.T)
        assert np.linalg.eigvalsh(belief.information)[0] > 0.0
        carried = prior.expect(query, state).drift.covariance
        ahead = np.diagonal(np.linalg.inv(belief.information))
        assert np.all(ahead <= np.diagonal(carried) * (1.0 + 1e-9))
        state = localreg.step(state, trackers.frame(index))[0]


def confidences(localreg: Synthesizer, motion: Motion, frames: int = 30) -> ndarray:
    poses = follow(localreg, list(simulate_trackers(motion))[:frames])
    return np.array([pose.confidence for pose in poses])


def test_motion_unlike_the_database_is_told_by_less_confidence(localreg, walk):
    made = replace(make_motion(3, 40, RATE, amplitude=0.5), subject=walk.subject)
    familiar, strange = confidences(localreg, walk), confidences(localreg, made)
    assert np.all((strange >= 0.0) & (strange <= familiar.max()) & (familiar <= 1.0))
    assert familiar[5:].mean() > 0.8
    assert strange[5:].mean() < 0.4


def test_the_prior_trusts_itself_less_on_motion_unlike_the_database(localreg, prior, walk):
    """Its deviations grow as its errors do."""
    made = replace(make_motion(3, 40, RATE, amplitude=0.5), subject=walk.subject)
    spreads = []
    for motion in (walk, made):
        state = knowing(motion, 20)
        query = localreg._query(state, observe(simulate_trackers(motion).frame(20)))[0]
        spreads.append(np.diagonal(prior.expect(query, state).drift.covariance))
    assert np.sqrt(spreads[1]).mean() > 2.0 * np.sqrt(spreads[0]).mean()


def test_what_hardly_moves_in_the_database_may_move_on_motion_unlike_it(localreg, prior, walk):
    """Collar bones are still in walks, and arms keep to a narrow range."""
    made = replace(make_motion(3, 40, RATE, amplitude=0.5), subject=walk.subject)
    stiff = replace(prior, settings=replace(prior.settings, strangeness=0.0))
    collar = 6 + DOF_NAMES.index("lclaviclery")
    deviations, limits = np.empty((2, 2)), []
    for column, motion in enumerate((walk, made)):
        state = knowing(motion, 20)
        query = localreg._query(state, observe(simulate_trackers(motion).frame(20)))[0]
        for row, each in enumerate((prior, stiff)):
            expected = each.expect(query, state)
            past = np.linalg.inv(expected.drift.covariance)
            told = (expected.belief.information - past)[collar, collar]
            deviations[row, column] = 1.0 / np.sqrt(told)
        limits.append(expected.belief.limits.sigma)
    assert limits[0] == pytest.approx(prior.limits.sigma, rel=0.1)
    assert limits[1] > 2.0 * limits[0]
    assert deviations[0, 0] == pytest.approx(deviations[1, 0], rel=0.05)
    assert deviations[0, 1] > 2.0 * deviations[1, 1]


@pytest.mark.parametrize("signal", ["positions", "orientations", "three", "nothing"])
def test_what_is_not_measured_costs_confidence(localreg, trackers, signal):
    worse = {
        "positions": lambda frame: only(frame, ALL, NONE),
        "orientations": lambda frame: only(frame, NONE, ALL),
        "three": lambda frame: without(frame, 0, 2, 3),
        "nothing": lambda frame: without(frame, *range(6)),
    }[signal]
    state = localreg.init(trackers.frame(0))
    for index in range(6):
        frame = trackers.frame(index)
        less = localreg.step(state, worse(frame))[1].confidence
        state, pose = localreg.step(state, frame)
        assert less <= min(0.5, pose.confidence)
        assert (less == 0.0) == (signal == "nothing")


def test_a_still_person_is_expected_to_stay(localreg, walk):
    """Two seconds in one pose of a walk: the body neither walks on nor drifts."""
    away = np.empty((3, 62))
    for row, frame in zip(away, (30, 50, 70), strict=True):
        qpos = np.repeat(walk.qpos[frame : frame + 1], 80, axis=0)
        still = Motion(qpos, RATE, walk.subject, Provenance("still"))
        poses = follow(localreg, simulate_trackers(still))
        chain.difference(qpos[0], poses[-1].qpos, row)
    assert np.linalg.norm(away[:, :3], axis=1).mean() < 0.01
    assert np.sqrt(np.mean(away[:, 6:] ** 2, axis=1)).mean() < np.radians(4.0)
