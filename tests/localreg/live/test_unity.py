"""Poses in Unity's terms: signs, T-pose, and the way back to our own kinematics."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BODY_NAMES, BONE_NAMES, BONES, DOF_NAMES, QPOS_SIZE
from localreg.body.subject import Subject, canonical_subject
from localreg.live.body_frames import ForwardKinematics
from localreg.live.unity import (
    HUMAN_BONES,
    HUMAN_PARENTS,
    Humanoid,
)
from localreg.motion.joint_angles import joint_angles
from localreg.motion.postures import t_pose
from sensors.protocols import unity
from tests.localreg.live.poses import random_qpos

SUBJECT = canonical_subject()
UPRIGHT = np.array([0.5, 0.5, 0.5, 0.5])
NAMES = list(HUMAN_BONES)


def upright(**degrees: float) -> np.ndarray:
    qpos = np.zeros(QPOS_SIZE)
    qpos[2], qpos[3:7] = 1.0, UPRIGHT
    for name, value in degrees.items():
        qpos[7 + DOF_NAMES.index(name)] = np.radians(value)
    return qpos


def in_t_pose(subject: Subject) -> np.ndarray:
    """Somebody who stands in Unity's T-pose, from the turns of the bones."""
    turns = t_pose(subject)
    parents = [BODY_NAMES.index(bone.parent) for bone in BONES]
    local = np.swapaxes(turns[parents], 1, 2) @ turns[1:]
    qpos = upright()
    qpos[7:] = joint_angles(local[None], subject.axis_frames)[0][0]
    return qpos


def human(qpos: np.ndarray, subject: Subject = SUBJECT):
    return Humanoid(subject)(ForwardKinematics(subject)(qpos))


def test_the_t_pose_is_all_identities():
    pose = human(in_t_pose(SUBJECT))
    np.testing.assert_allclose(np.abs(pose.quaternions[:, 3]), 1.0, atol=1e-9)
    for side in ("Left", "Right"):
        leg = [pose.world_positions[NAMES.index(side + bone)] for bone in
               ("UpperLeg", "LowerLeg", "Foot")]  # fmt: skip
        np.testing.assert_allclose([p[0] for p in leg], leg[0][0], atol=1e-4)
        arm = [pose.world_positions[NAMES.index(side + bone)] for bone in
               ("UpperArm", "LowerArm", "Hand")]  # fmt: skip
        np.testing.assert_allclose([p[1] for p in arm], arm[0][1], atol=1e-6)


def test_left_is_at_minus_x_up_at_y_and_forward_at_z():
    place = dict(zip(NAMES, human(upright()).world_positions, strict=True))
    assert place["LeftHand"][0] < -0.5 < 0.5 < place["RightHand"][0]
    assert place["Head"][1] > place["Hips"][1] > place["LeftFoot"][1]
    assert place["LeftToes"][2] > place["LeftFoot"][2] + 0.1


@pytest.mark.parametrize(
    ("dofs", "bone", "expected"),
    [
        # A knee bends back: in Unity's left-handed axes a positive turn about x.
        ({"ltibiarx": 90.0}, "LeftFoot", [0.0, 0.5, -0.5]),
        # The head turns to its left, which is towards -x.
        ({"headry": 90.0}, "Head", None),
    ],
)
def test_joints_turn_the_right_way(dofs: dict[str, float], bone: str, expected: list[float] | None):
    before = human(in_t_pose(SUBJECT))
    qpos = in_t_pose(SUBJECT)
    for name, degrees in dofs.items():
        qpos[7 + DOF_NAMES.index(name)] += np.radians(degrees)
    after = human(qpos)
    index = NAMES.index(bone)
    if expected is None:
        nose = Rotation.from_quat(after.world_quaternions[index]).apply([0.0, 0.0, 1.0])
        np.testing.assert_allclose(nose, [-1.0, 0.0, 0.0], atol=1e-6)
        return
    moved = after.world_positions[index] - before.world_positions[index]
    np.testing.assert_allclose(moved, expected, atol=0.05)


@pytest.mark.parametrize("seed", range(5))
def test_a_receiver_that_chains_local_poses_finds_our_world_positions(seed: int):
    rng = np.random.default_rng(seed)
    offsets = SUBJECT.offsets * rng.uniform(0.8, 1.2, (30, 1)) + rng.normal(0.0, 0.01, (30, 3))
    subject = Subject.from_offsets("someone", offsets)
    qpos = random_qpos(seed)
    frames = ForwardKinematics(subject)(qpos)
    pose = human(qpos, subject)
    places: dict[str, np.ndarray] = {}
    turns: dict[str, Rotation] = {}
    for name, p, q in zip(NAMES, pose.positions, pose.quaternions, strict=True):
        parent = HUMAN_PARENTS.get(name)
        own = Rotation.from_quat(q)
        places[name] = p if parent is None else places[parent] + turns[parent].apply(p)
        turns[name] = own if parent is None else turns[parent] * own
        ours = frames.positions[BODY_NAMES.index(HUMAN_BONES[name])]
        np.testing.assert_allclose(places[name], [-ours[1], ours[2], ours[0]], atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_limbs_lie_along_their_turned_t_pose_axes(seed: int):
    """An avatar with bones of its own, straight limbs, points them where ours point."""
    qpos = random_qpos(seed)
    pose = human(qpos)
    for name, child, axis in (
        ("LeftUpperLeg", "LeftLowerLeg", [0.0, -1.0, 0.0]),
        ("RightLowerLeg", "RightFoot", [0.0, -1.0, 0.0]),
        ("LeftUpperArm", "LeftLowerArm", [-1.0, 0.0, 0.0]),
        ("RightUpperArm", "RightLowerArm", [1.0, 0.0, 0.0]),
    ):
        start, end = (pose.world_positions[NAMES.index(n)] for n in (name, child))
        along = Rotation.from_quat(pose.world_quaternions[NAMES.index(name)]).apply(axis)
        np.testing.assert_allclose(along, (end - start) / np.linalg.norm(end - start), atol=1e-9)


def test_every_bone_has_a_parent_that_comes_before_it():
    for index, name in enumerate(NAMES[1:], start=1):
        assert NAMES.index(HUMAN_PARENTS[name]) < index
        assert HUMAN_BONES[name] in BONE_NAMES


def test_euler_angles_are_those_of_unity():
    turns = Rotation.random(200, rng=np.random.default_rng(1))
    x, y, z = unity.quaternion_to_euler(turns.as_quat(scalar_first=True)).T
    again = (
        Rotation.from_rotvec(np.outer(y, [0.0, 1.0, 0.0]))
        * Rotation.from_rotvec(np.outer(x, [1.0, 0.0, 0.0]))
        * Rotation.from_rotvec(np.outer(z, [0.0, 0.0, 1.0]))
    )
    assert (turns.inv() * again).magnitude().max() < 1e-7


@pytest.mark.parametrize("straight", [90.0, -90.0])
def test_euler_angles_hold_where_x_is_a_right_angle(straight: float):
    turns = Rotation.from_euler("YXZ", [[30.0, straight, 20.0]], degrees=True)
    x, y, z = unity.quaternion_to_euler(turns.as_quat(scalar_first=True)).T
    again = Rotation.from_euler("YXZ", np.stack([y, x, z], axis=1))
    assert (turns.inv() * again).magnitude().max() < 1e-6
