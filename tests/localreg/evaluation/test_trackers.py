"""Simulated trackers: statistics of the noise, masks, and independence of everything else."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from localreg.body.kinematics import Kinematics, tracker_poses_batch
from localreg.errors import SynthesisError
from localreg.evaluation.trackers import (
    MEAN_GAP,
    Loss,
    SimulatedTrackers,
    TrackerQuality,
    simulate_trackers,
)
from localreg.motion.motion import Motion
from tests.localreg.database.made_motion import make_motion


@pytest.fixture(scope="module")
def motion() -> Motion:
    return make_motion(3, 2000, rate=40.0)


@pytest.fixture(scope="module")
def trackers(motion: Motion) -> SimulatedTrackers:
    return simulate_trackers(motion)


def turns(trackers: SimulatedTrackers) -> np.ndarray:
    """Rotation vectors of the orientation errors in the trackers' own frames."""
    true = Rotation.from_quat(trackers.true_quaternions.reshape(-1, 4), scalar_first=True)
    seen = Rotation.from_quat(trackers.quaternions.reshape(-1, 4), scalar_first=True)
    return (true.inv() * seen).as_rotvec().reshape(*trackers.positions.shape[:2], 3)


def test_truth_is_that_of_our_own_kinematics(motion: Motion, trackers: SimulatedTrackers) -> None:
    own = tracker_poses_batch(Kinematics.from_subject(motion.subject), motion.qpos[:50])
    np.testing.assert_allclose(trackers.true_positions[:50], own.positions, atol=1e-9)
    alike = np.abs(np.sum(trackers.true_quaternions[:50] * np.asarray(own.quaternions), axis=-1))
    np.testing.assert_allclose(alike, 1.0, atol=1e-9)


def test_noise_has_the_size_that_is_said(trackers: SimulatedTrackers) -> None:
    shifts = trackers.positions - trackers.true_positions
    angles = np.degrees(turns(trackers))
    for noise, sigma in ((shifts, 0.003), (angles, 0.5)):
        # 2000 frames: the standard error of a deviation is 1.6 percent.
        np.testing.assert_allclose(noise.std(axis=0), sigma, rtol=0.08)
        np.testing.assert_allclose(noise.mean(axis=0), 0.0, atol=0.1 * sigma)
        flat = noise.reshape(len(noise), -1) / sigma
        covariance = flat.T @ flat / len(flat)
        assert np.abs(covariance - np.eye(len(covariance))).max() < 0.12
        follows = np.sum(flat[1:] * flat[:-1]) / flat.size
        assert abs(follows) < 0.02, "noise of one frame tells that of the next"
    np.testing.assert_allclose(np.linalg.norm(trackers.quaternions, axis=-1), 1.0, atol=1e-12)
    assert trackers.position_mask.all()
    assert trackers.orientation_mask.all()


def test_noise_depends_on_seed_clip_and_tracker_alone(
    motion: Motion, trackers: SimulatedTrackers
) -> None:
    again = simulate_trackers(motion)
    np.testing.assert_array_equal(again.positions, trackers.positions)
    head = simulate_trackers(motion.first(30))
    np.testing.assert_array_equal(head.quaternions, trackers.quaternions[:30])
    names = ("rhand", "head")
    fewer = replace(motion, subject=motion.subject.with_trackers(names))
    columns = [motion.subject.trackers.index(name) for name in names]
    np.testing.assert_allclose(
        simulate_trackers(fewer).positions, trackers.positions[:, columns], atol=1e-12
    )
    other_clip = replace(motion, provenance=replace(motion.provenance, name="another"))
    for other in (simulate_trackers(motion, seed=1), simulate_trackers(other_clip)):
        assert np.abs(other.positions - trackers.positions).min(axis=(1, 2)).max() > 0.0
        assert not np.isclose(other.positions, trackers.positions, atol=1e-6).all(axis=-1).any()


def test_the_same_noise_in_every_process() -> None:
    # A fixed number: hash() of a string would differ from run to run.
    trackers = simulate_trackers(make_motion(1, 10, rate=40.0))
    noise = trackers.positions[0, 0] - trackers.true_positions[0, 0]
    np.testing.assert_allclose(noise, [0.0023251501, 0.0005352203, 0.0011801315], atol=1e-9)


@pytest.mark.parametrize(
    ("signals", "has_position", "has_orientation"),
    [("both", True, True), ("position", True, False), ("orientation", False, True)],
)
def test_what_is_not_measured_is_masked_and_tells_nothing(
    motion: Motion,
    trackers: SimulatedTrackers,
    signals: str,
    has_position: bool,
    has_orientation: bool,
) -> None:
    some = simulate_trackers(motion, TrackerQuality(signals=signals))
    assert (some.position_mask == has_position).all()
    assert (some.orientation_mask == has_orientation).all()
    if has_position:
        np.testing.assert_array_equal(some.positions, trackers.positions)
    else:
        assert (some.positions == 0.0).all()
    if has_orientation:
        np.testing.assert_array_equal(some.quaternions, trackers.quaternions)
    else:
        assert (some.quaternions == [1.0, 0.0, 0.0, 0.0]).all()
    np.testing.assert_array_equal(some.true_positions, trackers.true_positions)


def test_outliers_come_as_often_and_as_far_as_said(
    motion: Motion, trackers: SimulatedTrackers
) -> None:
    quality = TrackerQuality(outliers=0.1, outlier_position=0.5, outlier_orientation=1.0)
    wild = simulate_trackers(motion, quality)
    moved = np.linalg.norm(wild.positions - trackers.positions, axis=-1)
    is_outlier = moved > 1e-9
    assert is_outlier.mean() == pytest.approx(0.1, abs=0.01)
    np.testing.assert_allclose(moved[is_outlier], 0.5, atol=1e-9)
    angle = np.linalg.norm(turns(wild), axis=-1)
    assert (angle[is_outlier] > 0.9).all()
    assert (angle[~is_outlier] < 0.1).all()
    assert wild.position_mask.all()


def test_trackers_drop_out_in_gaps_but_not_at_the_start(motion: Motion) -> None:
    away = ~simulate_trackers(motion, TrackerQuality(dropout=0.25)).position_mask
    assert away.mean() == pytest.approx(0.25, abs=0.05)
    assert not away[0].any()
    begins = (away[1:] & ~away[:-1]).sum()
    assert away.sum() / begins / motion.rate == pytest.approx(MEAN_GAP, rel=0.2)
    most = ~simulate_trackers(motion, TrackerQuality(dropout=0.95)).position_mask
    assert most.mean() == pytest.approx(0.95, abs=0.03)


def test_frames_are_what_estimators_are_given(trackers: SimulatedTrackers) -> None:
    frames = list(trackers)
    assert len(frames) == len(trackers) == 2000
    assert frames[40].time == pytest.approx(1.0)
    np.testing.assert_array_equal(frames[40].positions, trackers.positions[40])
    assert frames[40].position_mask.shape == (6,)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"signals": "all"}, "choose one of both, position, orientation"),
        ({"noise_position": -0.1}, "noise_position is -0.1"),
        ({"noise_orientation": float("nan")}, "noise_orientation is nan"),
        ({"outliers": 1.5}, "from 0 to 1"),
        ({"dropout": 1.0}, "below 1"),
        ({"dropout_seconds": 0.0}, "gaps last 0.0 s; give more than 0"),
        ({"time_jitter": -1.0}, "time_jitter is -1.0"),
        ({"slip_position": float("inf")}, "slip_position is inf; give a size of 0 or more"),
    ],
)
def test_impossible_qualities_are_refused(wrong: dict, message: str) -> None:
    with pytest.raises(SynthesisError, match=message):
        TrackerQuality(**wrong)


def test_gaps_last_as_long_as_is_said(motion: Motion) -> None:
    quality = TrackerQuality(dropout=0.3, dropout_seconds=1.0)
    away = ~simulate_trackers(motion, quality).position_mask
    begins = (away[1:] & ~away[:-1]).sum()
    assert away.sum() / begins / motion.rate == pytest.approx(1.0, rel=0.3)


def test_a_loss_is_where_and_when_it_is_said(motion: Motion, trackers: SimulatedTrackers) -> None:
    quality = TrackerQuality(losses=(Loss("rhand", 1.5, 0.5), Loss("head", 3.0, 1.0)))
    seen = simulate_trackers(motion, quality)
    names = motion.subject.trackers
    expected = np.ones_like(seen.position_mask)
    expected[60:80, names.index("rhand")] = False
    expected[120:160, names.index("head")] = False
    np.testing.assert_array_equal(seen.position_mask, expected)
    np.testing.assert_array_equal(seen.orientation_mask, expected)
    assert (seen.positions[~expected] == 0.0).all()
    np.testing.assert_array_equal(seen.positions[expected], trackers.positions[expected])


def test_a_tracker_that_slips_stays_where_it_slid_on_the_bone(
    motion: Motion, trackers: SimulatedTrackers
) -> None:
    quality = TrackerQuality(
        noise_position=0.0, noise_orientation=0.0, slip_position=0.05, slip_orientation=0.3
    )
    slipped = simulate_trackers(motion, quality)
    true = Rotation.from_quat(slipped.true_quaternions.reshape(-1, 4), scalar_first=True)
    moved = (slipped.positions - slipped.true_positions).reshape(-1, 3)
    in_own_axes = true.inv().apply(moved).reshape(*slipped.positions.shape)
    turned = turns(slipped)
    for tracker in range(6):
        size = np.linalg.norm(in_own_axes[:, tracker], axis=1)
        first = int(np.argmax(size > 1e-9))
        assert 0 < first < 800
        assert (size[:first] < 1e-9).all()
        np.testing.assert_allclose(size[first:], 0.05, atol=1e-9)
        np.testing.assert_allclose(
            in_own_axes[first:, tracker] - in_own_axes[first, tracker], 0.0, atol=1e-9
        )
        np.testing.assert_allclose(np.linalg.norm(turned[first:, tracker], axis=1), 0.3, atol=1e-6)
    assert len({int(np.argmax(np.any(in_own_axes[:, t] > 1e-9, axis=1))) for t in range(6)}) > 3


def test_samples_at_other_instants_are_off_by_speed_times_time(motion: Motion) -> None:
    exact = {"noise_position": 0.0, "noise_orientation": 0.0}
    late = simulate_trackers(motion, TrackerQuality(time_jitter=0.005, **exact))
    moved = np.linalg.norm(late.positions - late.true_positions, axis=-1)[1:-1]
    speed = np.linalg.norm(np.gradient(late.true_positions, axis=0) * motion.rate, axis=-1)[1:-1]
    # E|N(0, 1)| = 0.798.
    assert moved.mean() == pytest.approx(0.798 * 0.005 * speed.mean(), rel=0.1)
    assert np.linalg.norm(turns(late), axis=-1).max() > 1e-3
    np.testing.assert_allclose(np.linalg.norm(late.quaternions, axis=-1), 1.0, atol=1e-9)
