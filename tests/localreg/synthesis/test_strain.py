"""Which errors make the belief fade, and what that saves."""

from dataclasses import replace

import numpy as np
import pytest

from localreg.body.skeleton import DOF_NAMES
from localreg.evaluation.trackers import simulate_trackers
from localreg.synthesis.attention import observe
from localreg.synthesis.observation import Observation
from localreg.synthesis.strain import Strain
from tests.localreg.synthesis.sessions import Session, follow

SIGMAS = (0.005, 0.01)
BEARABLE = 9.0
ALL = np.ones(2, dtype=bool)
STILL = Observation(np.zeros((2, 3)), np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)), ALL, ALL)


def strained(errors, observations=None):
    """The strain after each frame, the second tracker's position being off by so much [m]."""
    strain, found = Strain.none(2), []
    for index, error in enumerate(errors):
        said = STILL if observations is None else observations[index]
        off = np.zeros((2, 2, 3))
        off[0, 1] = error if np.ndim(error) else (error, 0.0, 0.0)
        strain = strain.after(said, (off[0], off[1]), SIGMAS, BEARABLE)
        found.append(strain)
    return found


def moved(x):
    positions = np.zeros((2, 3))
    positions[1, 0] = x
    return STILL._replace(positions=positions)


@pytest.mark.parametrize("times", [1.0, 4.0])
def test_noise_is_no_strain(times):
    """Not even where it is larger than expected."""
    noise = times * SIGMAS[0] * np.random.default_rng(0).normal(size=(400, 3))
    fading = [strain.fading(BEARABLE) for strain in strained(noise)]
    assert max(fading) < 1.5
    assert np.mean(fading) < 1.01


def test_an_outlier_is_no_strain():
    for strain in strained([0.004, 0.3] + [0.004] * 20 + [0.3] + [0.004] * 20):
        assert strain.fading(BEARABLE) == 1.0
        lorentzian = np.full((2, 2), 9.0)
        assert strain.widened(lorentzian, STILL, BEARABLE) is lorentzian


def test_an_error_that_lasts_is_and_goes_again():
    frames = strained([0.004] + 80 * [0.3] + 80 * [0.004])
    fading = np.array([strain.fading(BEARABLE) for strain in frames])
    assert fading[3] > 1.0
    assert np.all(np.diff(fading[:81]) >= 0.0)
    assert fading[80] == pytest.approx(60.0**2 / BEARABLE * (1.0 - 3.0 / 15.0), rel=1e-3)
    assert np.all(np.diff(fading[81:]) <= 0.0)
    assert fading[-1] == 1.0
    wider = frames[80].widened(np.full((2, 2), 9.0), STILL, BEARABLE)
    np.testing.assert_allclose(wider, [[9.0, 9.0], [9.0 * fading[80], 9.0]])
    away = frames[80].widened(np.full((2, 2), 9.0), moved(0.3), BEARABLE)
    np.testing.assert_allclose(away, 9.0)


def test_an_error_that_a_jump_has_brought_is_not_until_it_has_ended():
    there_and_back = [moved(0.0)] * 3 + [moved(0.3)] * 20 + [moved(0.0)] * 3
    frames = strained([0.004] * 3 + [0.3] * 20 + [0.004] * 3, there_and_back)
    assert all(strain.fading(BEARABLE) == 1.0 for strain in frames)
    np.testing.assert_array_equal(frames[10].believed.positions, 0.0)


def test_an_outlier_does_not_make_a_lasting_error_a_jump():
    said = [moved(0.0)] * 40 + [moved(0.3)] + [moved(0.0)] * 40
    frames = strained([0.2] * 40 + [0.5] + [0.2] * 40, said)
    fading = [strain.fading(BEARABLE) for strain in frames]
    assert fading[39] > 100.0
    assert 50.0 < fading[40] < fading[39]
    assert fading[-1] == pytest.approx(fading[39], rel=0.02)


def test_what_is_not_measured_strains_nothing():
    nothing = STILL._replace(position_mask=np.zeros(2, dtype=bool))
    frames = strained([0.3] * 100, [STILL] * 20 + [nothing] * 80)
    assert frames[19].fading(BEARABLE) > 100.0
    assert frames[-1].fading(BEARABLE) == 1.0


def test_covariances_never_grow_without_bound():
    assert strained([50.0] * 60)[-1].fading(BEARABLE) == 1000.0


@pytest.fixture(scope="module")
def salute(walk):
    """The walk, but both arms go where they are in none of the walks."""
    qpos = walk.qpos[:100].copy()
    raised = np.radians(140.0) * np.clip((np.arange(100) - 15) / 30.0, 0.0, 1.0)
    for name, side in (("lhumerusrz", 1.0), ("rhumerusrz", -1.0)):
        qpos[:, 7 + DOF_NAMES.index(name)] += side * raised
    return replace(walk, qpos=qpos)


def test_motion_that_the_database_lacks_is_followed_all_the_same(salute, localreg, body):
    frames = list(simulate_trackers(salute, truth=body.tracker_poses(salute.qpos)))
    session = Session(salute.qpos, body, follow(localreg, frames))
    residuals = np.array([pose.position_residuals for pose in session.poses])
    assert residuals[60:].mean(axis=0).max() < 0.01
    assert session.errors[60:].mean() < 0.02


def test_a_strained_belief_is_wider(localreg, walk):
    frames = list(simulate_trackers(walk))[:10]
    state = localreg.init(frames[0])
    for frame in frames[1:9]:
        state, _ = localreg.step(state, frame)
    query = localreg._query(state, observe(frames[9]))[0]
    strained = state._replace(strain=state.strain._replace(worst=10.0 * BEARABLE))
    assert state.strain.fading(BEARABLE) == 1.0
    calm, tense = (localreg.prior.expect(query, each).belief for each in (state, strained))
    assert np.trace(tense.information) < 0.2 * np.trace(calm.information)
    assert tense.limits.sigma == pytest.approx(10.0**0.5 * calm.limits.sigma)
