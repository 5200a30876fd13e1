"""The canonical skeleton: what it is made of, and that it is its own mirror image."""

import numpy as np
import pytest

from localreg.body.skeleton import (
    BODY_NAMES,
    BONE_NAMES,
    BONES,
    DOF_BONES,
    DOF_COUNT,
    DOF_NAMES,
    QPOS_SIZE,
    TANGENT_SIZE,
    axis_frames,
    default_axis_frames,
    default_offsets,
    joint_limits,
    mirror_name,
)
from localreg.body.subject import canonical_subject
from localreg.motion.motion import MIRROR_DOFS, MIRROR_SIGNS

REFLECT = np.array([-1.0, 1.0, 1.0])


def test_counts() -> None:
    assert (len(BONES), len(BODY_NAMES), DOF_COUNT) == (30, 31, 56)
    assert (QPOS_SIZE, TANGENT_SIZE) == (63, 62)
    assert len(set(BONE_NAMES)) == 30
    assert len(set(DOF_NAMES)) == len(DOF_BONES) == 56


def test_parents_come_before_their_children() -> None:
    for index, bone in enumerate(BONES):
        assert bone.parent in BODY_NAMES[: index + 1]


def test_dofs_turn_from_the_parent_outwards_as_z_y_x() -> None:
    for bone in BONES:
        assert bone.dofs in ("", "x", "y", "zx", "zy", "zyx")
        assert len(bone.limits_deg) == len(bone.dofs)
    assert DOF_NAMES[:4] == ("lfemurrz", "lfemurry", "lfemurrx", "ltibiarx")
    assert DOF_NAMES[-3:] == ("rfingersrx", "rthumbrz", "rthumbrx")


def test_names_mirror() -> None:
    assert mirror_name("lfemur") == "rfemur"
    assert mirror_name("rthumb") == "lthumb"
    for name in ("root", "lowerback", "lowerneck", "upperneck", "head", "thorax"):
        assert mirror_name(name) == name
    for name in BODY_NAMES:
        assert mirror_name(mirror_name(name)) == name
        assert mirror_name(name) in BODY_NAMES


def test_the_skeleton_is_its_own_mirror_image() -> None:
    offsets, frames, limits = default_offsets(), default_axis_frames(), joint_limits()
    for index, bone in enumerate(BONES):
        other = BONE_NAMES.index(mirror_name(bone.name))
        assert BONES[other].parent == mirror_name(bone.parent)
        assert BONES[other].dofs == bone.dofs
        np.testing.assert_allclose(offsets[other], offsets[index] * REFLECT, atol=1e-12)
        mirrored = np.diag(REFLECT) @ frames[index] @ np.diag(REFLECT)
        np.testing.assert_allclose(frames[other], mirrored, atol=1e-12)
    signed = np.sort(limits[MIRROR_DOFS] * MIRROR_SIGNS[:, None], axis=1)
    np.testing.assert_allclose(signed, limits, atol=1e-12)
    assert canonical_subject().mirrored().same_proportions(canonical_subject())


def test_limits_hold_the_rest_pose() -> None:
    lower, upper = joint_limits().T
    assert np.all(lower <= 0.0)
    assert np.all(upper >= 0.0)
    assert np.all(upper - lower > np.radians(30.0))


def test_axis_frames_are_rotations_about_x_then_y_then_z() -> None:
    frames = default_axis_frames()
    np.testing.assert_allclose(
        frames @ frames.transpose(0, 2, 1), np.tile(np.eye(3), (30, 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(frames), 1.0)
    a, b, c = np.radians([10.0, 20.0, 30.0])
    x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    np.testing.assert_allclose(axis_frames(np.array([[10.0, 20.0, 30.0]]))[0], z @ y @ x)


def test_proportions_are_a_persons() -> None:
    lengths = dict(zip(BONE_NAMES, np.linalg.norm(default_offsets(), axis=1), strict=True))
    assert 0.40 < lengths["lfemur"] < 0.55
    assert lengths["ltibia"] == pytest.approx(lengths["rtibia"])
    assert 0.25 < lengths["lhumerus"] < 0.40
