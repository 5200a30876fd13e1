"""Feet that stand, gaps that are bridged, takes that are cut, on made and on real motion."""

from dataclasses import replace

import numpy as np
import pytest

from localreg.body.skeleton import DOF_NAMES
from localreg.errors import MotionError
from localreg.evaluation.metrics import foot_skate_cm_s
from localreg.motion.body_poses import body_points, body_turns
from localreg.motion.contacts import FOOT_BODIES, FOOT_ENDS, foot_contacts
from localreg.motion.foot_lock import lock_feet
from localreg.motion.formats import read_motion
from localreg.motion.gaps import LONGEST, fill_gaps, find_jumps
from localreg.motion.trimming import trimmed
from tests.localreg.motion.strategies import make_calm_motion


def feet(motion):
    _, ends = body_points(motion.qpos, motion.subject)
    return ends[:, FOOT_ENDS]


def still(count=80, rate=40.0):
    """A motion in which nothing moves, with bent knees, so that legs have room."""
    motion = make_calm_motion(1, count=1, rate=rate)
    return replace(motion, qpos=np.repeat(motion.qpos, count, axis=0))


def sliding(count=80):
    """The same, sliding back and forth over the ground by 6 cm."""
    motion = still(count)
    qpos = motion.qpos.copy()
    qpos[:, 0] += 0.03 * np.sin(2 * np.pi * np.arange(count) / count)
    return replace(motion, qpos=qpos)


def test_sliding_feet_are_held_where_they_were():
    motion = sliding()
    contacts = np.zeros((80, 4), dtype=bool)
    contacts[20:60, 0] = contacts[10:40, 2] = True
    result = lock_feet(motion, contacts)
    before, after = feet(motion), feet(result.motion)
    assert np.ptp(before[20:60, 0], axis=0).max() > 0.04
    assert np.ptp(after[20:60, 0], axis=0).max() < 0.001
    assert np.ptp(after[10:40, 2], axis=0).max() < 0.001
    assert result.missed.max() < 0.001
    assert result.shift.max() < 0.06
    # Far from contacts nothing is touched, nor ever anything but the legs.
    np.testing.assert_array_equal(result.motion.qpos[70:], motion.qpos[70:])
    legs = [i for i, d in enumerate(DOF_NAMES) if d[1:].startswith(("femur", "tibia", "foot"))]
    others = np.setdiff1d(np.arange(63), 7 + np.array(legs))
    np.testing.assert_array_equal(result.motion.qpos[:, others], motion.qpos[:, others])
    # The way in and out is smooth: no frame moves a foot much more than it slid.
    assert np.linalg.norm(np.diff(after, axis=0), axis=-1).max() < 0.012


def test_held_feet_keep_their_orientation():
    motion = sliding()
    contacts = np.zeros((80, 4), dtype=bool)
    contacts[20:60, 0] = True
    result = lock_feet(motion, contacts)
    turned = np.swapaxes(body_turns(motion.qpos, motion.subject), -1, -2) @ body_turns(
        result.motion.qpos, motion.subject
    )
    cosine = (np.trace(turned[:, 4], axis1=1, axis2=2) - 1.0) / 2.0
    assert np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))).max() < 5.0


def test_a_tip_that_takes_over_is_held_where_it_then_is():
    motion = sliding()
    contacts = np.zeros((80, 4), dtype=bool)
    contacts[20:45, 0] = contacts[40:60, 1] = True
    after = feet(lock_feet(motion, contacts).motion)
    assert np.ptp(after[20:45, 0], axis=0).max() < 0.001
    assert np.ptp(after[45:60, 1], axis=0).max() < 0.001
    assert np.linalg.norm(np.diff(after[:, :2], axis=0), axis=-1).max() < 0.012


def test_out_of_reach_is_said():
    motion = still()
    qpos = motion.qpos.copy()
    qpos[:, 0] += np.linspace(0.0, 8.0, len(qpos))  # nobody's leg is that long
    contacts = np.zeros((80, 4), dtype=bool)
    contacts[20:60, 0] = True
    result = lock_feet(replace(motion, qpos=qpos), contacts)
    assert result.missed.max() > 0.05
    assert np.isfinite(result.motion.qpos).all()


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_few_frames_are_no_trouble(count):
    motion = make_calm_motion(2, count=count)
    assert np.isfinite(lock_feet(motion).motion.qpos).all()
    assert not find_jumps(motion).any()


@pytest.mark.parametrize("name", ["02/02_01", "55/55_02", "135/135_06"])
def test_real_feet_skate_less_and_bodies_look_the_same(motions_dir, name):
    (motion,) = read_motion(motions_dir / f"cmu/subjects/{name}.amc")
    motion = motion.resampled(40.0).first(400)
    result = lock_feet(motion)
    assert result.contacts.mean() > 0.2
    before, after = (
        foot_skate_cm_s(body_points(m.qpos, m.subject)[1], result.contacts, 40.0)
        for m in (motion, result.motion)
    )
    assert after < 0.5 * before
    # Whatever is held does not move at all while it is.
    held = result.contacts[:-1, 0] & result.contacts[1:, 0]
    steps = np.linalg.norm(np.diff(feet(result.motion)[:, 0], axis=0), axis=1)
    assert np.median(steps[held]) < 1e-5
    assert np.linalg.norm(feet(result.motion) - feet(motion), axis=-1).mean() < 0.03


def test_contacts_of_a_standing_person_are_all_there_is():
    motion = still()
    _, ends = body_points(motion.qpos, motion.subject)
    assert foot_contacts(ends, motion.rate).all()
    result = lock_feet(motion)
    np.testing.assert_array_equal(result.motion.qpos, motion.qpos)
    assert result.contacts.shape == (80, len(FOOT_BODIES))


@pytest.mark.parametrize("length", [1, 2, 9])
def test_a_jump_away_and_back_is_found_and_bridged(length):
    motion = make_calm_motion(3, count=120)
    broken = motion.qpos.copy()
    broken[50 : 50 + length, 7:] += 1.5
    wrong = find_jumps(replace(motion, qpos=broken))
    np.testing.assert_array_equal(np.flatnonzero(wrong), np.arange(50, 50 + length))
    mended = fill_gaps(replace(motion, qpos=broken), wrong)
    np.testing.assert_allclose(mended.qpos, motion.qpos, atol=2e-3)
    assert not find_jumps(mended).any()


def test_fast_motion_and_a_cut_between_takes_are_left_alone():
    motion = make_calm_motion(4, count=120)
    assert not find_jumps(motion).any()
    joined = motion.qpos.copy()
    joined[60:, 7:] += 1.5
    assert not find_jumps(replace(motion, qpos=joined)).any()


def test_gaps_are_filled_through_any_turn_of_the_root():
    motion = make_calm_motion(5, count=60)
    missing = np.zeros(60, dtype=bool)
    missing[10:14] = missing[30] = True
    holes = motion.qpos.copy()
    holes[missing] = motion.qpos[0]
    holes[20:, 3:7] *= -1.0  # the same rotations
    mended = fill_gaps(replace(motion, qpos=holes), missing)
    _, here = body_points(mended.qpos, motion.subject)
    _, there = body_points(motion.qpos, motion.subject)
    np.testing.assert_allclose(here, there, atol=1e-3)
    np.testing.assert_array_equal(mended.qpos[~missing], holes[~missing])


@pytest.mark.parametrize(
    ("first", "last", "message"),
    [(0, 3, "at an end"), (56, 60, "at an end"), (10, 50, f"longer than {LONGEST:g} s")],
)
def test_gaps_that_cannot_be_filled_say_where_they_are(first, last, message):
    motion = make_calm_motion(6, count=60)
    missing = np.zeros(60, dtype=bool)
    missing[first:last] = True
    with pytest.raises(MotionError, match=message) as error:
        fill_gaps(motion, missing)
    assert f"frames {first} to {last - 1}" in str(error.value)


def test_real_jumps_are_found(motions_dir):
    (climb,) = read_motion(motions_dir / "cmu/subjects/01/01_06.amc")
    part = climb.first(4900)
    wrong = find_jumps(part)
    assert np.flatnonzero(wrong).tolist() == [4755, 4756, 4757, 4758, 4759]
    _, ends = body_points(fill_gaps(part, wrong).qpos, part.subject)
    speed = np.linalg.norm(np.diff(ends[4700:4800], axis=0), axis=-1).max() * part.rate
    assert speed < 8.0


def test_takes_are_cut_at_frames():
    motion = make_calm_motion(7, count=121, rate=120.0)
    cut = trimmed(motion, 0.1, 0.5)
    np.testing.assert_array_equal(cut.qpos, motion.qpos[12:61])
    np.testing.assert_array_equal(trimmed(motion).qpos, motion.qpos)
    np.testing.assert_array_equal(trimmed(motion, end=0.0).qpos, motion.qpos[:1])
    with pytest.raises(MotionError, match="it lasts 1 s"):
        trimmed(motion, 3.0, 4.0)
