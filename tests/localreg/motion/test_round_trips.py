"""Every format: what is written comes back, on random people and motions and on real ones."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings

from localreg.errors import MotionError
from localreg.motion.formats import read_motion, write_motion
from localreg.motion.joint_angles import bone_rotations
from tests.localreg.motion.strategies import make_calm_motion, make_motion, recipes, turn_distance

# The formats that hold all angles; points and coordinates are tested where they are read.
SUFFIXES = (".amc", ".bvh")


def check_same(back, motion, *, angles_too):
    np.testing.assert_allclose(back.subject.offsets, motion.subject.offsets, atol=1e-7)
    np.testing.assert_allclose(back.qpos[:, :3], motion.qpos[:, :3], atol=1e-7)
    assert turn_distance(back.qpos[:, 3:7], motion.qpos[:, 3:7]).max() < 2e-7
    ours = bone_rotations(back.angles, back.subject.axis_frames)
    theirs = bone_rotations(motion.angles, motion.subject.axis_frames)
    np.testing.assert_allclose(ours, theirs, atol=2e-7)
    if angles_too:
        np.testing.assert_allclose(back.angles, motion.angles, atol=1e-6)


@pytest.mark.parametrize("suffix", SUFFIXES)
@settings(max_examples=20, deadline=None)
@given(recipe=recipes())
def test_any_motion_comes_back(tmp_path_factory, suffix, recipe):
    path = tmp_path_factory.mktemp("trip") / f"x{suffix}"
    motion = make_motion(**recipe)
    write_motion(motion, path)
    (back,) = read_motion(path)
    check_same(back, motion, angles_too=suffix == ".amc")


@settings(max_examples=15, deadline=None)
@given(recipe=recipes())
def test_acclaim_keeps_any_axis_frames(tmp_path_factory, recipe):
    path = tmp_path_factory.mktemp("trip") / "x.amc"
    motion = make_motion(**recipe, frames="random")
    write_motion(motion, path)
    (back,) = read_motion(path)
    np.testing.assert_allclose(back.subject.axis_frames, motion.subject.axis_frames, atol=1e-9)
    check_same(back, motion, angles_too=True)


@pytest.mark.parametrize("name", ["02/02_05", "49/49_18", "135/135_06"])
def test_real_motion_through_both_formats(motions_dir, tmp_path, name):
    (motion,) = read_motion(motions_dir / f"cmu/subjects/{name}.amc")
    motion = motion.first(600)
    write_motion(motion, tmp_path / "a.bvh")
    (as_bvh,) = read_motion(tmp_path / "a.bvh")
    write_motion(as_bvh, tmp_path / "b.amc")
    (back,) = read_motion(tmp_path / "b.amc")
    check_same(back, motion, angles_too=True)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_single_frame_comes_back(tmp_path, suffix):
    motion = make_calm_motion(2, count=1)
    write_motion(motion, tmp_path / f"x{suffix}")
    (back,) = read_motion(tmp_path / f"x{suffix}")
    check_same(back, motion, angles_too=True)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_motion_without_frames_is_not_written(tmp_path, suffix):
    motion = make_calm_motion(2)
    with pytest.raises(MotionError, match="no frames"):
        write_motion(replace(motion, qpos=motion.qpos[:0]), tmp_path / f"x{suffix}")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_an_impossible_place_is_an_error(tmp_path, suffix):
    with pytest.raises(MotionError, match="cannot write"):
        write_motion(make_calm_motion(2), tmp_path / "none" / f"x{suffix}")


@pytest.mark.parametrize("name", ["x.xyz", "x"])
def test_unknown_endings_list_the_known_ones(tmp_path, name):
    with pytest.raises(MotionError, match=r"\.amc, \.bvh"):
        read_motion(tmp_path / name)
    with pytest.raises(MotionError, match=r"\.amc, \.bvh"):
        write_motion(make_calm_motion(2), tmp_path / name)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_endings_may_be_upper_case(tmp_path, suffix):
    write_motion(make_calm_motion(2), tmp_path / f"x{suffix.upper()}")
    assert len(read_motion(tmp_path / f"x{suffix.upper()}")) == 1
