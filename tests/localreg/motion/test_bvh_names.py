"""BVH files under foreign names: read by two other programs, whose kinematics agree with ours."""

import numpy as np
import pybvh
import pytest
from bvh import Bvh

from localreg.body.skeleton import BODY_NAMES
from localreg.errors import MotionError
from localreg.motion.body_poses import body_points
from localreg.motion.formats import read_motion, write_motion
from localreg.motion.formats.joint_trees import FAMILIES, joint_names, joint_tree
from tests.localreg.motion.strategies import make_calm_motion, make_motion

NECESSARY = {
    "mixamo": ("mixamorig:Hips", "mixamorig:Spine2", "mixamorig:LeftHand", "mixamorig:RightFoot"),
    "vrm": ("hips", "upperChest", "leftHand", "rightFoot", "leftUpperArm", "head"),
    "cmu": ("Hips", "LeftHand", "RightFoot", "LeftUpLeg"),
}


def written(motion, folder, family):
    path = folder / f"{family}.bvh"
    write_motion(motion, path, names=family)
    return path


def expected_starts(motion, family):
    """Where the joints of a family are, in centimetres, y up, by name."""
    starts, _ = body_points(motion.qpos, motion.subject)
    places = 100.0 * np.stack([starts[..., 0], starts[..., 2], -starts[..., 1]], axis=-1)
    return {name: places[:, BODY_NAMES.index(b)] for b, name in joint_names(family).items()}


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("seed", [0, 1])
def test_pybvh_finds_every_joint_where_it_is(tmp_path, family, seed):
    motion = make_motion(seed, count=7, special=0.3)
    file = pybvh.read_bvh_file(written(motion, tmp_path, family))
    assert file.frame_count == 7
    assert file.fps == pytest.approx(120.0)
    expected = expected_starts(motion, family)
    assert set(file.joint_names) == set(expected)
    places = file.joint_positions()
    for name, path in expected.items():
        np.testing.assert_allclose(places[:, file.joint_names.index(name)], path, atol=1e-4)


@pytest.mark.parametrize("family", FAMILIES)
def test_the_bvh_package_reads_the_same_joints_and_frames(tmp_path, family):
    motion = make_calm_motion(3, count=4, rate=50.0)
    path = written(motion, tmp_path, family)
    file = Bvh(path.read_text())
    assert file.nframes == 4
    assert file.frame_time == pytest.approx(0.02)
    assert file.get_joints_names() == list(joint_tree(motion.subject, family).names)
    assert set(NECESSARY[family]) <= set(file.get_joints_names())
    height = file.frame_joint_channel(2, NECESSARY[family][0], "Yposition")
    assert height == pytest.approx(100.0 * motion.qpos[2, 2], abs=1e-5)


@pytest.mark.parametrize("family", ["mixamo", "vrm"])
def test_programs_count_from_a_t_pose(tmp_path, family):
    file = pybvh.read_bvh_file(written(make_calm_motion(4, count=1), tmp_path, family))
    names, rest = joint_names(family), file.rest_pose_positions()
    place = {body: rest[file.node_index[name]] for body, name in names.items()}
    for side, sign in (("l", 1.0), ("r", -1.0)):
        arm = place[side + "hand"] - place[side + "humerus"]
        np.testing.assert_allclose(arm / np.linalg.norm(arm), [sign, 0.0, 0.0], atol=1e-6)
        leg = place[side + "foot"] - place[side + "femur"]
        np.testing.assert_allclose(leg / np.linalg.norm(leg), [0.0, -1.0, 0.0], atol=1e-6)


@pytest.mark.parametrize(("family", "within"), [("cmu", 1e-7), ("mixamo", 2e-2), ("vrm", 2e-2)])
def test_motion_comes_back_from_every_family(tmp_path, family, within):
    motion = make_calm_motion(6, count=20)
    (back,) = read_motion(written(motion, tmp_path, family))
    here, there = (body_points(m.qpos, m.subject)[0] for m in (back, motion))
    distance = np.linalg.norm(here - there, axis=-1)
    assert distance.max() < within
    assert distance.mean() < 0.3 * within + 1e-8


def test_unknown_families_and_formats_without_any_are_refused(tmp_path):
    motion = make_calm_motion(5, count=2)
    with pytest.raises(MotionError, match="cmu, mixamo, vrm"):
        write_motion(motion, tmp_path / "x.bvh", names="biped")
    with pytest.raises(MotionError, match="names of their own"):
        write_motion(motion, tmp_path / "x.amc", names="mixamo")
    assert list(tmp_path.iterdir()) == []
