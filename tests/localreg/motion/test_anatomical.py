"""Joint angles by anatomical names: signs by known postures, and every table that holds them."""

import builtins
from dataclasses import replace

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from localreg.body.model import UPRIGHT
from localreg.body.skeleton import BODY_NAMES, DOF_COUNT, DOF_NAMES
from localreg.body.subject import canonical_subject
from localreg.errors import MotionError
from localreg.motion.anatomical import COORDINATES, JOINTS, LENGTHS, coordinates, poses
from localreg.motion.body_poses import body_points
from localreg.motion.contacts import foot_contacts
from localreg.motion.formats import read_motion, write_motion
from localreg.motion.formats.angle_tables import CONTACTS
from localreg.motion.joint_angles import bone_rotations
from localreg.motion.motion import Motion
from tests.localreg.motion.strategies import make_calm_motion, make_motion, make_subject


def posed(**degrees):
    """One frame upright with some joint angles [deg]."""
    qpos = np.zeros((1, 7 + DOF_COUNT))
    qpos[0, 3:7] = UPRIGHT
    for name, angle in degrees.items():
        qpos[0, 7 + DOF_NAMES.index(name)] = np.radians(angle)
    return qpos


def reached(subject, **degrees):
    """The bone ends, x forward, y up, z right, of coordinates [deg]."""
    values = {name: np.radians([float(angle)]) for name, angle in degrees.items()}
    qpos = poses(values, subject)
    _, ends = body_points(qpos, subject)
    x, y, z = ends[0].T
    return {
        name: np.array([-y[i], z[i], -x[i]]) - np.array([-y[0], z[0], -x[0]])
        for i, name in enumerate(BODY_NAMES)
    }


def test_names_are_unique_and_every_joint_has_three():
    assert len(set(COORDINATES)) == len(COORDINATES) == 6 + 3 * len(JOINTS) == 90


@pytest.mark.parametrize(
    ("coordinate", "bone", "axis", "sign"),
    [
        ("hip_flexion_{}", "femur", 0, 1),  # the knee goes forward
        ("hip_adduction_{}", "femur", 2, -1),  # and inwards
        ("knee_angle_{}", "tibia", 0, -1),  # the ankle goes back
        ("ankle_angle_{}", "foot", 1, 1),  # the ball goes up
        ("mtp_angle_{}", "toes", 1, 1),
        ("hip_rotation_{}", "foot", 2, -1),  # the foot points inwards
        ("arm_flex_{}", "humerus", 0, 1),
        ("arm_add_{}", "humerus", 2, -1),
        ("elbow_flex_{}", "radius", 0, 1),
        ("wrist_flex_{}", "hand", 0, 1),
        ("wrist_dev_{}", "hand", 2, -1),
        ("pro_sup_{}", "thumb", 0, 1),  # the thumb comes forward from the side
        ("clav_elevation_{}", "clavicle", 1, 1),
        ("clav_protraction_{}", "clavicle", 0, 1),
        ("lumbar_extension", "head", 0, -1),
        ("neck_bending", "head", 2, 1),
    ],
)
@pytest.mark.parametrize("side", ["l", "r"])
def test_positive_means_the_same_on_both_sides(coordinate, bone, axis, sign, side):
    subject = canonical_subject()
    bone = bone if bone == "head" else side + bone
    rest, moved = reached(subject, pelvis_tilt=0), reached(
        subject, **{coordinate.format(side): 20.0}
    )  # fmt: skip
    way = (moved[bone] - rest[bone])[axis]
    outwards = -1.0 if side == "l" and axis == 2 and bone != "head" else 1.0
    assert way * sign * outwards > 0.01


def test_hinges_are_flexions():
    subject = canonical_subject()
    values = dict(zip(COORDINATES, np.degrees(coordinates(posed(ltibiarx=70), subject)[0]),
                      strict=True))  # fmt: skip
    assert values["knee_angle_l"] == pytest.approx(70, abs=0.01)
    assert values["knee_adduction_l"] == pytest.approx(0, abs=0.01)
    assert values["knee_angle_r"] == pytest.approx(0, abs=0.01)
    # At rest the legs are spread by 20 degrees, the arms by 90, palms down.
    assert values["hip_adduction_r"] == pytest.approx(-20, abs=0.1)
    assert values["hip_flexion_r"] == pytest.approx(0, abs=0.1)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), special=st.sampled_from([0.0, 0.3]))
def test_coordinates_hold_any_pose(seed, special):
    motion = make_motion(seed, special=special)
    values = dict(zip(COORDINATES, coordinates(motion.qpos, motion.subject).T, strict=True))
    back = poses(values, motion.subject)
    ours = bone_rotations(back[:, 7:], motion.subject.axis_frames)
    theirs = bone_rotations(motion.angles, motion.subject.axis_frames)
    np.testing.assert_allclose(ours, theirs, atol=1e-7)
    np.testing.assert_allclose(back[:, :3], motion.qpos[:, :3], atol=1e-9)
    turns = [Rotation.from_quat(q[:, 3:7], scalar_first=True) for q in (back, motion.qpos)]
    assert (turns[0].inv() * turns[1]).magnitude().max() < 1e-7


def test_a_real_walk_has_a_walk_s_angles(motions_dir):
    (walk,) = read_motion(motions_dir / "cmu/subjects/02/02_01.amc")
    frame = walk.to_dataframe()
    for side in "lr":
        assert 15 < frame[f"hip_flexion_{side}"].max() < 45
        assert -35 < frame[f"hip_flexion_{side}"].min() < -5
        assert 55 < frame[f"knee_angle_{side}"].max() < 80
        assert -5 < frame[f"knee_angle_{side}"].min() < 20
        assert np.abs(frame[f"hip_adduction_{side}"]).max() < 15
        assert frame[f"elbow_flex_{side}"].min() > 0
    assert np.abs(frame[["pelvis_tilt", "pelvis_list"]]).to_numpy().max() < 15
    # Feet take turns standing, and labels are those of the detector.
    standing = frame[list(CONTACTS)].to_numpy()
    _, ends = body_points(walk.qpos, walk.subject)
    np.testing.assert_array_equal(standing == 1, foot_contacts(ends, walk.rate))
    assert 0.3 < standing.mean() < 0.9


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("count", [1, 12])
def test_tables_hold_what_the_data_frame_does(tmp_path, suffix, count):
    motion = make_calm_motion(1, count=count, rate=50.0)
    path = tmp_path / f"x{suffix}"
    write_motion(motion, path)
    frame = motion.to_dataframe()
    read = pd.read_csv(path, comment="#") if suffix == ".csv" else pd.read_parquet(path)
    assert list(read.columns) == list(frame.columns) == ["time", *COORDINATES, *CONTACTS]
    np.testing.assert_allclose(read.to_numpy(), frame.to_numpy(), atol=1e-6)
    np.testing.assert_allclose(read["time"], np.arange(count) / 50.0)
    assert frame.attrs["rate_hz"] == "50"
    head = (
        path.read_text().splitlines()[0]
        if suffix == ".csv"
        else pq.read_schema(path).metadata[b"columns"].decode()
    )
    assert "degrees" in head


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_angles_of_a_table_and_the_subject_make_the_motion_again(tmp_path, suffix):
    motion = make_calm_motion(2, count=30)
    write_motion(motion, tmp_path / f"x{suffix}")
    path = tmp_path / f"x{suffix}"
    read = pd.read_csv(path, comment="#") if suffix == ".csv" else pd.read_parquet(path)
    values = {
        name: read[name].to_numpy() if name in LENGTHS else np.radians(read[name].to_numpy())
        for name in COORDINATES
    }
    back = replace(motion, qpos=poses(values, motion.subject))
    np.testing.assert_allclose(back.angles, motion.angles, atol=1e-5)
    _, here = body_points(back.qpos, back.subject)
    _, there = body_points(motion.qpos, motion.subject)
    np.testing.assert_allclose(here, there, atol=1e-6)


@pytest.mark.parametrize(
    "make", [Motion.to_dataframe, lambda motion: write_motion(motion, "x.parquet")]
)
def test_without_the_extra_a_sentence_says_what_to_install(tmp_path, monkeypatch, make):
    motion = make_calm_motion(3, count=2)
    real = builtins.__import__

    def refuse(name, *arguments, **more):
        if name.split(".")[0] in ("pandas", "pyarrow"):
            raise ImportError(name)
        return real(name, *arguments, **more)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(builtins, "__import__", refuse)
    with pytest.raises(MotionError, match=r"install localreg-mocap\[tables\]"):
        make(motion)
    assert list(tmp_path.iterdir()) == []


def test_people_of_any_axis_frames_have_coordinates():
    subject = make_subject(5, "random")
    motion = make_motion(6, count=3)
    values = coordinates(motion.qpos, subject)
    assert np.isfinite(values).all()
    assert isinstance(Motion(motion.qpos, 30.0, subject).to_dataframe(), pd.DataFrame)
