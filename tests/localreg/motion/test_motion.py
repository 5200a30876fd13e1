"""Motions: what they refuse, resampling, and mirroring checked by kinematics."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from localreg.body.kinematics import Kinematics, bone_ends_batch
from localreg.body.skeleton import BODY_NAMES, BONES, mirror_name
from localreg.body.subject import canonical_subject
from localreg.errors import MotionError
from localreg.motion.formats import read_motion
from localreg.motion.formats.sample import read_sample
from localreg.motion.motion import MIRROR_DOFS, MIRROR_SIGNS, Motion, Provenance
from tests.localreg.motion.strategies import (
    make_calm_motion,
    make_motion,
    recipes,
    turn_distance,
)

SWAPPED = [BODY_NAMES.index(mirror_name(name)) for name in BODY_NAMES]


def bone_ends(motion):
    return np.asarray(
        bone_ends_batch(Kinematics.from_subject(motion.subject), jnp.asarray(motion.qpos))
    )


def check_mirror_by_kinematics(motion):
    mirrored = motion.mirrored()
    expected = bone_ends(motion)[:, SWAPPED] * [-1.0, 1.0, 1.0]
    np.testing.assert_allclose(bone_ends(mirrored), expected, atol=1e-9)


@settings(max_examples=25, deadline=None)
@given(recipes())
def test_mirror_image_of_any_motion_by_kinematics(recipe):
    check_mirror_by_kinematics(make_motion(**recipe, frames="random"))


def test_mirror_image_of_sample_motion_by_kinematics():
    check_mirror_by_kinematics(read_sample()[3].first(40))


def test_mirror_image_of_real_motion_by_kinematics(motions_dir):
    (motion,) = read_motion(motions_dir / "cmu/subjects/49/49_18.amc")
    check_mirror_by_kinematics(motion.first(40))


@settings(max_examples=25, deadline=None)
@given(recipes())
def test_mirroring_twice_gives_the_motion_back(recipe):
    motion = make_motion(**recipe)
    twice = motion.mirrored().mirrored()
    np.testing.assert_array_equal(twice.qpos, motion.qpos)
    np.testing.assert_allclose(twice.subject.offsets, motion.subject.offsets, atol=1e-15)
    assert twice.provenance == motion.provenance


def test_mirroring_names_itself():
    mirrored = make_calm_motion(1).mirrored()
    assert mirrored.provenance.name == "calm-mirrored"
    assert mirrored.provenance.mirrored


def test_mirror_table_is_an_involution_of_like_hinges():
    np.testing.assert_array_equal(MIRROR_DOFS[MIRROR_DOFS], np.arange(56))
    np.testing.assert_array_equal(MIRROR_SIGNS[MIRROR_DOFS], MIRROR_SIGNS)
    assert sum(MIRROR_SIGNS > 0) == sum("x" in bone.dofs for bone in BONES)


@pytest.mark.parametrize("factor", [1, 2, 3, 7])
def test_whole_number_reduction_keeps_frames_untouched(factor):
    motion = make_motion(5, count=20, rate=120.0)
    reduced = motion.resampled(120.0 / factor)
    np.testing.assert_array_equal(reduced.qpos, motion.qpos[::factor])
    assert reduced.rate == 120.0 / factor


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6), st.floats(7.0, 400.0))
def test_resampling_keeps_duration_grid_and_unit_quaternions(seed, rate):
    motion = make_calm_motion(seed)
    resampled = motion.resampled(rate)
    assert resampled.rate == rate
    assert motion.seconds - 1.0 / rate - 1e-6 <= resampled.seconds <= motion.seconds + 1e-6
    np.testing.assert_allclose(resampled.qpos[0], motion.qpos[0], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(resampled.qpos[:, 3:7], axis=1), 1.0, atol=1e-9)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([40.0, 50.0, 90.0, 100.0, 144.0]))
def test_resampling_agrees_with_the_same_motion_made_at_that_rate(seed, rate):
    motion = make_calm_motion(seed, count=120, rate=120.0)
    resampled = motion.resampled(rate)
    truth = make_calm_motion(seed, count=len(resampled), rate=rate)
    np.testing.assert_allclose(resampled.angles, truth.angles, atol=1e-4)
    np.testing.assert_allclose(resampled.qpos[:, :3], truth.qpos[:, :3], atol=1e-9)
    assert turn_distance(resampled.qpos[:, 3:7], truth.qpos[:, 3:7]).max() < 1e-6


def test_resampling_crosses_the_jump_of_angles_and_quaternions():
    count = 30
    turns = Rotation.from_euler("z", np.linspace(0.0, 4.0 * np.pi, count)[:, None])
    qpos = np.zeros((count, 63))
    qpos[:, 3:7] = turns.as_quat(scalar_first=True) * np.where(np.arange(count) % 2, 1, -1)[:, None]
    wound = np.linspace(0.0, 4.0 * np.pi, count)
    qpos[:, 7] = (wound + np.pi) % (2.0 * np.pi) - np.pi
    motion = Motion(qpos, 30.0, canonical_subject()).resampled(100.0)
    times = np.arange(len(motion)) / 100.0
    expected = times * 30.0 * 4.0 * np.pi / (count - 1)
    np.testing.assert_allclose(motion.qpos[:, 7], expected, atol=1e-9)
    truth = Rotation.from_euler("z", expected[:, None]).as_quat(scalar_first=True)
    assert turn_distance(motion.qpos[:, 3:7], truth).max() < 1e-6


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_the_shortest_motions_can_be_resampled(count):
    motion = make_calm_motion(2, count=count).resampled(50.0)
    assert len(motion) >= 1
    assert np.all(np.isfinite(motion.qpos))


def test_sample_clips_resample_to_forty_hertz():
    motion = read_sample()[0]
    resampled = motion.resampled(40.0)
    assert len(resampled) == int(motion.seconds * 40.0 + 1e-6) + 1
    # Every fifth frame of the original meets every sixth of the new rate.
    np.testing.assert_allclose(resampled.qpos[::6, :3], motion.qpos[::5, :3], atol=1e-9)
    assert turn_distance(resampled.qpos[::6, 3:7], motion.qpos[::5, 3:7]).max() < 1e-6


def test_first_frames_and_duration():
    motion = make_calm_motion(3, count=13, rate=60.0)
    assert len(motion) == 13
    assert motion.seconds == pytest.approx(0.2)
    assert len(motion.first(4)) == 4
    assert len(motion.first(99)) == 13
    assert motion.first(0).seconds == 0.0


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        (0, np.nan, "frame 2 has a number that is not finite"),
        (40, np.inf, "frame 2 has a number that is not finite"),
        (3, 7.0, "not of unit length"),
    ],
)
def test_bad_numbers_are_refused(column, value, message):
    motion = make_calm_motion(3, count=5)
    qpos = motion.qpos.copy()
    qpos[2, column] = value
    with pytest.raises(MotionError, match=message):
        Motion(qpos, 120.0, motion.subject, Provenance("bad"))


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf")])
def test_bad_rates_are_refused(rate):
    motion = make_calm_motion(3, count=5)
    with pytest.raises(MotionError, match="rate"):
        Motion(motion.qpos, rate, motion.subject)
