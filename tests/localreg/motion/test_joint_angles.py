"""Joint angles from rotations: exact where the hinges can, nearest where they cannot."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BONES, DOF_BONES, DOF_NAMES, default_axis_frames
from localreg.motion.joint_angles import (
    axis_rotations,
    bone_rotations,
    continuous_zyx,
    euler_zyx,
    joint_angles,
    nearest_to_rest,
)
from tests.localreg.motion.strategies import make_calm_motion, make_motion, recipes

FEW_HINGES = [i for i, bone in enumerate(BONES) if 0 < len(bone.dofs) < 3]
FEW_HINGED_DOFS = [
    i for i, b in enumerate(DOF_BONES) if len(BONES[[x.name for x in BONES].index(b)].dofs) < 3
]


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_axis_rotations_are_scipys(axis):
    angles = np.linspace(-7.0, 7.0, 12).reshape(3, 4)
    expected = Rotation.from_euler(axis, angles.reshape(-1, 1)).as_matrix().reshape(3, 4, 3, 3)
    np.testing.assert_allclose(axis_rotations(axis, angles), expected, atol=1e-14)


def test_bone_rotations_follow_the_formula():
    motion = make_motion(3, frames="random")
    turns = bone_rotations(motion.angles, motion.subject.axis_frames)
    for index, bone in enumerate(BONES):
        product = Rotation.identity(len(motion))
        for dof in bone.dofs:
            column = DOF_NAMES.index(f"{bone.name}r{dof}")
            product = product * Rotation.from_euler(dof, motion.angles[:, [column]])
        C = Rotation.from_matrix(motion.subject.axis_frames[index])
        np.testing.assert_allclose(turns[:, index], (C * product * C.inv()).as_matrix(), atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(recipes(), st.sampled_from(["canonical", "random"]))
def test_rotations_made_by_the_hinges_are_found_again(recipe, frames):
    motion = make_motion(**recipe, frames=frames)
    turns = bone_rotations(motion.angles, motion.subject.axis_frames)
    angles, residuals = joint_angles(turns, motion.subject.axis_frames)
    assert residuals.max() < 1e-7
    again = bone_rotations(angles, motion.subject.axis_frames)
    np.testing.assert_allclose(again, turns, atol=1e-7)
    # One or two hinges have but one solution.
    turned = np.exp(1j * angles[:, FEW_HINGED_DOFS])
    np.testing.assert_allclose(turned, np.exp(1j * motion.angles[:, FEW_HINGED_DOFS]), atol=1e-7)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_angles_inside_the_anatomical_ranges_come_back_as_they_were(seed):
    motion = make_calm_motion(seed)
    frames = motion.subject.axis_frames
    angles, _ = joint_angles(bone_rotations(motion.angles, frames), frames)
    # A shoulder may pass a quarter turn either way; every other bone has one natural way.
    others = [i for i, bone in enumerate(DOF_BONES) if "humerus" not in bone]
    np.testing.assert_allclose(angles[:, others], motion.angles[:, others], atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_what_hinges_cannot_take_is_least_squares(seed):
    rng = np.random.default_rng(seed)
    frames = default_axis_frames()
    turns = Rotation.random(30, rng=rng).as_matrix()[None]
    angles, residuals = joint_angles(turns, frames)
    best = bone_rotations(angles, frames)[0]
    relative = Rotation.from_matrix(np.swapaxes(best, 1, 2) @ turns[0])
    np.testing.assert_allclose(residuals[0], relative.magnitude(), atol=1e-9)
    grid = np.linspace(-np.pi, np.pi, 181)
    for index in FEW_HINGES:
        axes = BONES[index].dofs
        wanted = frames[index].T @ turns[0, index] @ frames[index]
        tried = axis_rotations(axes[0], grid)
        if len(axes) == 2:
            tried = tried[:, None] @ axis_rotations(axes[1], grid)
        costs = np.sum((tried - wanted) ** 2, axis=(-2, -1))
        found = np.sum((best[index] - turns[0, index]) ** 2)
        assert found <= costs.min() + 1e-9


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6))
def test_euler_angles_are_continuous_through_every_jump(seed):
    rng = np.random.default_rng(seed)
    times = np.linspace(0.0, 1.0, 400)[:, None]
    waves = rng.uniform(-1, 1, (1, 3)) + rng.uniform(2, 6, (1, 3)) * np.sin(
        2 * np.pi * times * rng.uniform(0.3, 1.0, (1, 3)) + rng.uniform(0, 6, (1, 3))
    )
    turns = Rotation.from_euler("ZYX", waves).as_matrix()
    angles = continuous_zyx(turns)
    np.testing.assert_allclose(Rotation.from_euler("ZYX", angles).as_matrix(), turns, atol=1e-9)
    # Either way of the three angles moves as fast as the waves do.
    assert np.abs(np.diff(angles, axis=0)).max() < np.abs(np.diff(waves, axis=0)).max() + 0.05


@pytest.mark.parametrize("y", [np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-12, 0.0, np.pi])
def test_euler_angles_at_a_quarter_turn(y):
    turns = Rotation.from_euler("ZYX", [[0.3, y, -0.8], [2.9, y, 1.7]]).as_matrix()
    again = Rotation.from_euler("ZYX", euler_zyx(turns)).as_matrix()
    np.testing.assert_allclose(again, turns, atol=1e-9)


def test_no_frames_make_no_angles():
    angles, residuals = joint_angles(np.zeros((0, 30, 3, 3)), default_axis_frames())
    assert angles.shape == (0, 56)
    assert residuals.shape == (0, 30)


def test_angles_nearest_to_rest_are_the_same_turns():
    """From another way of writing every joint: whole turns away, or the second way there is."""
    motion = make_calm_motion(5)
    frames = default_axis_frames()
    far = motion.angles.copy()
    far[:, DOF_NAMES.index("ltibiarx")] += 2.0 * np.pi
    zyx = [DOF_NAMES.index(f"rhumerusr{axis}") for axis in "zyx"]
    far[:, zyx] = far[:, zyx] * [1.0, -1.0, 1.0] + np.pi
    near = nearest_to_rest(far)
    np.testing.assert_allclose(near, nearest_to_rest(motion.angles), atol=1e-12)
    np.testing.assert_allclose(bone_rotations(near, frames), bone_rotations(far, frames), atol=1e-9)
    assert np.abs(near).mean() < np.abs(far).mean()
    np.testing.assert_array_equal(nearest_to_rest(near), near)
    assert nearest_to_rest(near[:0]).shape == (0, 56)
