"""The poses: they say what they are, differ from each other, and tell much."""

import numpy as np
import pytest

from calibration.anthropometry import GROUPS
from calibration.eigen_skeleton import average_subject, subject_of
from calibration.observability import expected_deviations, information, length_information
from calibration.pictures import SHEET, draw_poses, grounded
from calibration.poses import EIGHT_POSES, NAIVE_POSES, mirrored, with_swapped
from calibration.posture import Limb, Posture
from calibration.sticks import Sticks
from localreg.body.skeleton import BODY_NAMES, BONES, DOF_BONES, joint_limits
from localreg.errors import LocalregError
from localreg.evaluation.body_points import BodyPoints
from tests.calibration.people import PRIOR

POINTS = BodyPoints(average_subject(PRIOR))


def direction(ends, bone):
    parent = BONES[BODY_NAMES.index(bone) - 1].parent
    along = ends[BODY_NAMES.index(bone)] - ends[BODY_NAMES.index(parent)]
    return along / np.linalg.norm(along)


@pytest.mark.parametrize("seed", range(6))
def test_limbs_point_where_a_posture_says(seed):
    rng = np.random.default_rng(seed)

    def limb():
        return Limb(tuple(rng.normal(size=3)), tuple(rng.normal(size=3)))

    arms, legs = (limb(), limb()), (limb(), limb())
    trunk = {"lowerbackrx": 20.0, "thoraxry": -15.0}
    posture = Posture(arms[0], arms[1], legs[0], legs[1], trunk, lean=25.0)
    qpos = np.zeros(63)
    qpos[3:7] = posture.root.as_quat(scalar_first=True)
    qpos[7:] = posture.angles()
    ends = POINTS.bone_ends(qpos[None])[0]
    for side, arm, leg in (("l", arms[0], legs[0]), ("r", arms[1], legs[1])):
        flip = np.array([1.0 if side == "l" else -1.0, 1.0, 1.0])
        for limb_, upper, lower in ((arm, "humerus", "radius"), (leg, "femur", "tibia")):
            for bone, wanted in ((upper, limb_.upper), (lower, limb_.lower)):
                wanted = np.array(wanted) * flip / np.linalg.norm(wanted)
                np.testing.assert_allclose(direction(ends, side + bone), wanted, atol=2e-3)


def test_names_are_unique_and_every_pose_has_words():
    assert len({pose.name for pose in EIGHT_POSES}) == 8
    assert all(word.endswith(".") for pose in EIGHT_POSES for word in pose.words)


def test_poses_are_within_what_joints_can_do():
    limits = joint_limits()
    # Three angles of a ball joint are a chart whose borders say little about the joint.
    hinges = [i for i, bone in enumerate(DOF_BONES) if DOF_BONES.count(bone) < 3]
    for pose in EIGHT_POSES:
        beyond = np.maximum(limits[:, 0] - pose.angles, pose.angles - limits[:, 1])[hinges]
        assert np.degrees(beyond.max()) < 10.0, pose.name


def test_standing_feet_can_stay_where_they_are():
    """Nobody must be asked for legs that need other footprints, whatever their proportions."""
    shares = np.array([{"femur": 0.8, "tibia": 1.3}.get(group, 1.0) for group in GROUPS])
    points = BodyPoints(subject_of("with long shanks", shares * PRIOR.lengths))
    widths = []
    for pose in EIGHT_POSES:
        if all(pose.planted):
            ends = points.bone_ends(pose.qpos()[None])[0]
            ankles = ends[[BODY_NAMES.index("ltibia"), BODY_NAMES.index("rtibia")]]
            widths.append(np.linalg.norm(ankles[0] - ankles[1]))
            assert abs(ankles[0, 2] - ankles[1, 2]) < 1e-6
    assert len(widths) == 6
    assert np.ptp(widths) < 1e-3


def test_a_mirrored_pose_is_the_mirror_image():
    qpos = EIGHT_POSES[1].qpos()
    other = qpos.copy()
    other[7:] = mirrored(qpos[7:])
    image = POINTS.bone_ends(other[None])[0]
    ends = POINTS.bone_ends(qpos[None])[0] * [-1.0, 1.0, 1.0]
    left = [BODY_NAMES.index("l" + b) for b in ("hand", "tibia")]
    right = [BODY_NAMES.index("r" + b) for b in ("hand", "tibia")]
    np.testing.assert_allclose(image[right], ends[left], atol=1e-6)
    np.testing.assert_allclose(image[left], ends[right], atol=1e-6)


def test_three_poses_tell_left_from_right():
    unlike = [p.name for p in EIGHT_POSES if np.abs(mirrored(p.angles) - p.angles).max() > 0.3]
    assert unlike == ["twist", "side bend", "heel"]
    swapped = with_swapped(EIGHT_POSES[1].angles, "arms")
    assert np.abs(swapped - EIGHT_POSES[1].angles).max() > 1.0
    np.testing.assert_array_equal(with_swapped(EIGHT_POSES[0].angles, "legs")[:8],
                                  EIGHT_POSES[0].angles[:8])  # fmt: skip


def test_the_eight_poses_tell_more_than_naive_ones():
    told, believed = information(EIGHT_POSES, PRIOR)
    naive, _ = information(NAIVE_POSES, PRIOR)
    ours = expected_deviations(believed + told.sum(axis=0), PRIOR)
    theirs = expected_deviations(believed + naive.sum(axis=0), PRIOR)
    assert np.all(ours < 1.1 * theirs)
    assert ours.mean() < 0.5 * theirs.mean()
    # Every single pose is worth holding.
    for index in range(8):
        rest = believed + np.delete(told, index, axis=0).sum(axis=0)
        assert expected_deviations(rest, PRIOR).mean() > 1.005 * ours.mean()


def test_information_of_lengths_is_the_inverse_of_their_covariance():
    told, believed = information(EIGHT_POSES, PRIOR)
    total = believed + told.sum(axis=0)
    lengths = length_information(total, PRIOR)
    L = np.linalg.cholesky(PRIOR.covariance)
    covariance = L @ np.linalg.inv(total)[:18, :18] @ L.T
    np.testing.assert_allclose(lengths @ covariance, np.eye(18), atol=1e-6)


def test_pictures_are_drawn(tmp_path):
    files, _ = draw_poses(EIGHT_POSES[:2], tmp_path / "out")
    assert [f.name for f in files] == ["1-T.png", "2-twist.png", SHEET]
    assert all(f.read_bytes().startswith(b"\x89PNG") for f in files)
    (tmp_path / "file").touch()
    with pytest.raises(LocalregError, match="cannot write"):
        draw_poses(EIGHT_POSES[:1], tmp_path / "file")


def test_a_drawn_person_stands_on_the_floor():
    subject = average_subject(PRIOR)
    for pose in EIGHT_POSES:
        lowest = POINTS.bone_ends(grounded(pose, subject)[None])[0][:, 2].min()
        assert 0.0 < lowest < 0.05


def test_stick_figures_differ():
    sticks = Sticks()
    figures = [sticks.draw(pose) for pose in EIGHT_POSES]
    assert len(set(figures)) == 8
    assert all(8 < figure.count("\n") < 17 for figure in figures)
