"""Bones in NumPy against MuJoCo's, and the postures that rotations are counted from."""

import mujoco
import numpy as np
import pytest

from localreg.body.model import build_model, end_site
from localreg.body.skeleton import BODY_NAMES, BONE_NAMES
from localreg.motion.body_poses import body_points, body_turns, rest_starts
from localreg.motion.postures import standing, t_pose
from tests.localreg.motion.strategies import make_motion, make_subject


def test_bones_are_where_mujoco_has_them():
    motion = make_motion(0, count=4, frames="random")
    model = build_model(motion.subject)
    data = mujoco.MjData(model)
    turns = body_turns(motion.qpos, motion.subject)
    starts, ends = body_points(motion.qpos, motion.subject)
    for frame, qpos in enumerate(motion.qpos):
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        for body, name in enumerate(BODY_NAMES):
            np.testing.assert_allclose(starts[frame, body], data.body(name).xpos, atol=1e-9)
            np.testing.assert_allclose(ends[frame, body], data.site(end_site(name)).xpos, atol=1e-9)
            np.testing.assert_allclose(turns[frame, body].ravel(), data.body(name).xmat, atol=1e-9)


def test_at_rest_bones_start_where_their_parents_end():
    subject = make_subject(1)
    starts = rest_starts(subject)
    assert not starts[0].any()
    hand, wrist = BODY_NAMES.index("lhand"), BODY_NAMES.index("lwrist")
    offset = subject.offsets[BONE_NAMES.index("lwrist")]
    np.testing.assert_allclose(starts[hand] - starts[wrist], offset)


@pytest.mark.parametrize("frames", ["canonical", "random"])
@pytest.mark.parametrize("posture", [t_pose, standing])
def test_postures_straighten_the_limbs(posture, frames):
    subject = make_subject(2, frames)
    turns = posture(subject)
    np.testing.assert_allclose(turns @ np.swapaxes(turns, 1, 2), np.tile(np.eye(3), (31, 1, 1)),
                               atol=1e-9)  # fmt: skip
    assert np.all(np.linalg.det(turns) > 0.0)

    def direction(bone):
        index = BONE_NAMES.index(bone)
        return turns[index + 1] @ subject.directions[index]

    for side, sign in (("l", 1.0), ("r", -1.0)):
        for bone in ("femur", "tibia"):
            np.testing.assert_allclose(direction(side + bone), [0, -1, 0], atol=1e-9)
        arm = [sign, 0.0, 0.0] if posture is t_pose else [0.0, -1.0, 0.0]
        for bone in ("humerus", "radius", "wrist", "hand", "fingers"):
            np.testing.assert_allclose(direction(side + bone), arm, atol=1e-9)


def test_standing_has_its_hinges_from_side_to_side():
    subject = make_subject(3)
    turns = standing(subject)
    for side in "lr":
        for bone, sign in (("tibia", 1.0), ("radius", -1.0), ("fingers", -1.0)):
            index = BONE_NAMES.index(side + bone)
            hinge = turns[index + 1] @ subject.axis_frames[index][:, 0]
            assert hinge[0] * sign > 0.85
