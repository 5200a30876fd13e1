"""Lengths and mounts from ordinary motion, by who moves like the database and who does not."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calibration.anthropometry import GROUP_COUNT
from calibration.calibrate import calibrate
from calibration.eigen_skeleton import lengths_of
from calibration.knowledge import Knowledge
from calibration.marginal import log_volume, newton_step
from calibration.motion_fit import MotionFit, MotionSettings, SeenFrames, fit_motion
from calibration.motion_mounts import apart
from calibration.pose_prior import PosePriors, nearest
from calibration.poses import EIGHT_POSES
from calibration.refinement import Stretch, refine
from calibration.report import motion_lines
from calibration.result import nine_lengths
from calibration.screening import Finding, Kind
from calibration.with_motion import with_motion
from localreg.body.skeleton import DOF_COUNT
from localreg.database.store import PoseDatabase
from localreg.errors import LocalregError
from localreg.evaluation.body_points import BodyPoints
from localreg.motion.motion import Motion
from localreg.synthesis.estimator import Estimator, Pose, Result
from sensors.pose import TrackerFrame
from tests.calibration.people import PRIOR, TRACKERS, lengths, somebody

SEED = 1
FRAMES = 120
SPREAD = np.radians(2.0)


@pytest.fixture(scope="module")
def calibrated():
    """Somebody's calibration."""
    return calibrate(somebody(SEED)[2], TRACKERS, PRIOR).result


def moving(seed, count=FRAMES):
    """Poses between some of the eight, each a little of its own."""
    rng = np.random.default_rng(seed)
    base = np.array([pose.qpos() for pose in EIGHT_POSES[:5]])
    shares = rng.dirichlet(np.full(len(base), 0.6), count)
    qpos = shares @ base
    qpos[:, 7:] += rng.normal(0.0, SPREAD, (count, DOF_COUNT))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    qpos[:, :3] += rng.normal(0.0, 0.3, (count, 3))
    return shares @ base[:, 7:], qpos


def seen_by(person, qpos, seed=0):
    rng = np.random.default_rng(seed)
    truth = BodyPoints(person).tracker_poses(qpos)
    mask = np.ones(truth.positions.shape[:2], bool)
    noise = rng.normal(0.0, 0.003, truth.positions.shape)
    return SeenFrames(truth.positions + noise, truth.quaternions, mask, mask, qpos)


def priors_at(means, spread=SPREAD):
    return PosePriors(means, np.tile(spread**2 * np.eye(DOF_COUNT), (len(means), 1, 1)))


def errors(subject, person):
    lengths_ = nine_lengths(lengths_of(subject)) / nine_lengths(lengths(SEED)) - 1.0
    mounts = [apart(a, b) for a, b in zip(subject.mounts, person.mounts, strict=True)]
    return np.abs(lengths_).mean(), *np.mean(mounts, axis=0)


def guessed(seen, means):
    """What one begins with: the poses that the database knows, and roots a little off."""
    qpos = seen.qpos.copy()
    qpos[:, 7:] = means
    qpos[:, :3] += 0.02
    return replace(seen, qpos=qpos)


def test_motion_makes_lengths_and_mounts_better_and_says_by_how_much(calibrated):
    person = somebody(SEED)[0]
    means, qpos = moving(3)
    seen = guessed(seen_by(person, qpos), means)
    settings = MotionSettings(alike=1.0)
    found = fit_motion(calibrated.subject, calibrated.knowledge, seen, priors_at(means), settings)
    before, after = errors(calibrated.subject, person), errors(found.subject, person)
    assert after[0] < before[0]
    assert after[1] < 0.6 * before[1]
    assert after[2] < 0.6 * before[2]
    away = [
        np.array(a.position) - np.array(b.position)
        for a, b in zip(found.subject.mounts, person.mounts, strict=True)
    ]
    scores = np.array(away) / found.knowledge.position_sd
    assert 0.4 < np.sqrt(np.mean(scores**2)) < 1.7
    assert np.all(found.knowledge.position_sd < calibrated.knowledge.position_sd)
    assert found.habit < np.radians(0.6)  # there is none
    assert np.abs(found.angles - qpos[:, 7:]).mean() < np.abs(means - qpos[:, 7:]).mean()


def test_a_habit_is_no_mount(calibrated):
    """What the person always does otherwise than the database must not go into the mounts."""
    person = somebody(SEED)[0]
    means, qpos = moving(3)
    habit = np.random.default_rng(5).normal(0.0, np.radians(5.0), DOF_COUNT)
    seen = guessed(seen_by(person, qpos), means - habit)
    settings = MotionSettings(alike=1.0)
    priors = priors_at(means - habit)
    found = fit_motion(calibrated.subject, calibrated.knowledge, seen, priors, settings)
    assert np.degrees(found.habit) == pytest.approx(5.0, rel=0.4)
    before, after = errors(calibrated.subject, person), errors(found.subject, person)
    assert after[1] < 1.1 * before[1]
    assert after[2] < 1.1 * before[2]


def test_wild_trackers_and_unseen_ones_do_no_harm(calibrated):
    person = somebody(SEED)[0]
    means, qpos = moving(3)
    clean = guessed(seen_by(person, qpos), means)
    settings = MotionSettings(alike=1.0)
    known, subject = calibrated.knowledge, calibrated.subject
    good = fit_motion(subject, known, clean, priors_at(means), settings).subject
    rng = np.random.default_rng(1)
    positions = clean.positions.copy()
    wild = rng.random(positions.shape[:2]) < 0.05
    positions[wild] += rng.normal(0.0, 0.5, (int(wild.sum()), 3))
    mask = rng.random(positions.shape[:2]) > 0.1
    positions[~mask] = 7.0
    seen = replace(clean, positions=positions, position_mask=mask, orientation_mask=mask)
    found = fit_motion(subject, known, seen, priors_at(means), settings).subject
    assert errors(found, person)[1] < errors(good, person)[1] + 0.002


def test_left_and_right_may_differ_as_in_the_file(calibrated):
    means, qpos = moving(3)
    longer = calibrated.subject.lengths.copy()
    longer[:5] *= 1.02  # the left leg
    uneven = replace(calibrated.subject, lengths=longer)
    seen = seen_by(uneven, qpos)
    found = fit_motion(uneven, calibrated.knowledge, seen, priors_at(means)).subject
    np.testing.assert_allclose(
        found.lengths[:5] / found.lengths[5:10], longer[:5] / longer[5:10], rtol=1e-6
    )
    np.testing.assert_allclose(found.lengths, longer, rtol=0.04)


@pytest.fixture(scope="module")
def database():
    """Poses that wander about the same ones."""
    means, _ = moving(8, 900)
    rng = np.random.default_rng(8)
    qpos = np.tile(EIGHT_POSES[0].qpos(), (900, 1))
    qpos[:, 7:] = means + rng.normal(0.0, SPREAD, means.shape)
    return PoseDatabase.build([Motion(qpos, 40.0, somebody(SEED)[0])], mirror=False)


def test_neighbors_are_the_nearest_poses(database, monkeypatch):
    monkeypatch.setattr("calibration.pose_prior._CHUNK", 100)
    angles = moving(4, 7)[1][:, 7:]
    allowed = np.arange(len(database)) % 3 > 0
    rows = nearest(angles, database, allowed, 20)
    apart_ = np.linalg.norm(angles[:, None] - np.asarray(database.angles)[None], axis=2)
    apart_[:, ~allowed] = np.inf
    for found, far in zip(rows, apart_, strict=True):
        assert set(found.tolist()) == set(np.argsort(far)[:20].tolist())
    assert nearest(angles, database, None, 10_000).shape == (7, len(database))


def test_a_pose_unlike_its_neighbors_has_a_wide_prior(database):
    angles = moving(4, 2)[1][:, 7:]
    odd = angles + np.radians(40.0)
    usual = PosePriors.near(angles, database, None, neighbors=60, floor=SPREAD)
    wide = PosePriors.near(odd, database, None, neighbors=60, floor=SPREAD)
    assert np.trace(wide.covariances[0]) > 20.0 * np.trace(usual.covariances[0])


class Guessing(Estimator[None]):
    """Knows every pose up to a random error."""

    rate = 40.0

    def __init__(self, subject, qpos):
        self.subject = subject
        self._qpos = qpos
        self.hidden = 0

    def init(self, frame):
        return None

    def step(self, state, frame) -> tuple[None, Pose]:
        index = round(frame.time * 40.0)
        self.hidden += int(not frame.position_mask[2])
        qpos = self._qpos[index].copy()
        qpos[7:] += np.random.default_rng(index).normal(0.0, np.radians(2.0), DOF_COUNT)
        nothing: Any = np.full(6, np.nan)
        return None, Pose(frame.time, qpos, nothing, nothing, 1.0, np.zeros(56), 1, Result.SOLVED)


def test_a_stretch_of_motion_refines(calibrated, database):
    person = somebody(SEED)[0]
    _, qpos = moving(9, 400)
    seen = seen_by(person, qpos)
    frames = [
        TrackerFrame(i / 40.0, seen.positions[i], seen.quaternions[i], mask, mask)
        for i, mask in enumerate(seen.position_mask)
    ]
    estimator = Guessing(calibrated.subject, qpos)
    told = []
    found = refine(
        calibrated.subject, calibrated.knowledge, [Stretch(frames)], lambda _: estimator, database,
        ignored=["lhand"], settings=MotionSettings(spacing=0.1),
        progress=lambda done, total, what: told.append((done, total, what)),
    )  # fmt: skip
    assert estimator.hidden == 400
    assert told[0] == (1, 400, "synthesizing")
    assert told[-1] == (2, 2, "fitting")
    before, after = errors(calibrated.subject, person), errors(found.subject, person)
    assert after[1] < before[1]
    assert after[2] < before[2]
    record = found.subject.calibration
    assert record is not None
    assert record.method == "eight poses, refined by motion"
    assert record.position_sd["head"] == pytest.approx(found.knowledge.position_sd[0])
    shank = found.subject.lengths[2] * np.sqrt(found.knowledge.log_lengths[2, 2])
    assert record.length_sd["ltibia"] == pytest.approx(shank)
    assert found.knowledge.covariance.shape == (GROUP_COUNT + 36, GROUP_COUNT + 36)
    short = [Stretch(frames[:40])]
    vague = Knowledge.of_record(calibrated.subject, PRIOR)
    with pytest.raises(LocalregError, match="too little"):
        refine(calibrated.subject, vague, short, lambda _: estimator, database)


def test_a_calibration_says_what_motion_added(calibrated, database, monkeypatch):
    """Everything a report shows is of both; a mount that moved too far is named."""
    known = calibrated.knowledge
    half = Knowledge(known.trackers, 0.25 * known.covariance)
    mounts = list(calibrated.subject.mounts)
    x, y, z = mounts[2].position
    mounts[2] = replace(mounts[2], position=(x + 0.2, y, z))
    moved = replace(
        calibrated.subject, mounts=tuple(mounts), lengths=1.01 * calibrated.subject.lengths
    )
    asked = []

    def refine_(subject, knowledge, stretches, build, poses, **more):
        asked.append([len(stretch.frames) for stretch in stretches])
        return MotionFit(moved, half, np.zeros((1, DOF_COUNT)), 0.0)

    monkeypatch.setattr("calibration.with_motion.refine", refine_)
    mask = np.ones(6, bool)
    still = np.tile([1.0, 0.0, 0.0, 0.0], (6, 1))
    slow = tuple(TrackerFrame(i / 20.0, np.zeros((6, 3)), still, mask, mask) for i in range(41))
    better = with_motion(calibrated, (slow, slow[:21]), database)
    assert asked == [[80, 40]]  # brought to the database's rate
    record = better.subject.calibration
    assert record is not None
    assert record.method == "eight poses and 3 s of motion"
    assert any("lhand sat elsewhere" in note for note in record.notes)
    assert sum("sat elsewhere" in note for note in record.notes) == 1
    (shown,) = motion_lines(better, [])
    assert shown.startswith("tracker lhand sat elsewhere")
    assert motion_lines(better, [Finding(Kind.SLIPPED, shown)]) == []
    assert motion_lines(calibrated, []) == []
    for before, after in zip(calibrated.lengths, better.lengths, strict=True):
        assert after.value == pytest.approx(1.01 * before.value)
        assert after.deviation == pytest.approx(0.5 * 1.01 * before.deviation, rel=1e-3)
        assert after.told_by_trackers > before.told_by_trackers
    for before, after in zip(calibrated.mounts, better.mounts, strict=True):
        np.testing.assert_allclose(after.position_sd, 0.5 * np.array(before.position_sd), rtol=1e-3)
        # A quarter of what beliefs told is what they still tell.
        left = 0.25 * (1.0 - np.array(before.told_by_trackers))
        np.testing.assert_allclose(1.0 - np.array(after.told_by_trackers), left, atol=2e-3)
    assert better.knowledge is half


def test_a_log_volume_moves_the_solution():
    rng = np.random.default_rng(2)
    root = rng.normal(size=(4, 4))
    covariance = root @ root.T
    slope = np.array([1.0, 0.0, -2.0, 0.5])
    step = newton_step(covariance, lambda s: float(slope @ s))
    np.testing.assert_allclose(step, -covariance @ slope, atol=1e-9)
    some = newton_step(covariance, lambda s: float(slope @ s), [0, 2])
    np.testing.assert_allclose(some, -covariance @ [1.0, 0.0, -2.0, 0.0], atol=1e-9)
    assert log_volume(np.tile(4.0 * np.eye(3), (2, 1, 1))) == pytest.approx(6.0 * np.log(2.0))
