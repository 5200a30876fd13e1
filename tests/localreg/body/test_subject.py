"""Subjects: the TOML round trip, and what is refused in which words."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BONE_NAMES, default_offsets
from localreg.body.subject import (
    DEFAULT_TRACKERS,
    CalibrationRecord,
    Mount,
    Subject,
    canonical_subject,
    read_subject,
    write_subject,
)
from localreg.errors import SubjectError


def make_subject(seed, name="Zoë Müller"):
    rng = np.random.default_rng(seed)
    offsets = default_offsets() * rng.uniform(0.5, 1.5, (30, 1))
    turn = Rotation.random(rng=rng).as_quat(scalar_first=True)
    mounts = (
        Mount("front", "head", tuple(rng.normal(size=3).tolist()), tuple(turn.tolist())),
        Mount("belt", "root", (0.0, 0.1, 0.0)),
    )
    frames = Rotation.random(30, rng=rng).as_matrix()
    plain = Subject.from_offsets(name, offsets, frames)
    return Subject(name, plain.lengths, plain.directions, frames, mounts)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), name=st.text(min_size=0, max_size=12).map(str.strip))
def test_toml_round_trip_is_exact(tmp_path_factory, seed, name):
    path = tmp_path_factory.mktemp("subject") / "subject.toml"
    subject = make_subject(seed, name)
    write_subject(subject, path)
    back = read_subject(path)
    assert (back.name, back.mounts) == (subject.name, subject.mounts)
    for field in ("lengths", "directions", "axis_frames"):
        np.testing.assert_array_equal(getattr(back, field), getattr(subject, field))


def test_what_a_file_leaves_out_keeps_its_default(tmp_path):
    path = tmp_path / "short.toml"
    path.write_text('version = 1\nname = "short"\n[bones.lfemur]\nlength = 0.5\n')
    subject, canonical = read_subject(path), canonical_subject()
    index = BONE_NAMES.index("lfemur")
    assert subject.lengths[index] == 0.5
    np.testing.assert_array_equal(
        np.delete(subject.lengths, index), np.delete(canonical.lengths, index)
    )
    assert subject.trackers == tuple(DEFAULT_TRACKERS)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("version = 1\n[bones.tail]\nlength = 1.0\n", "unknown bones tail"),
        ("version = 2\n", "version 2"),
        ("", "version None"),
        ("version = 1\n[bones\n", "not a subject file"),
        ("version = 1\nbones = 3\n", "not a valid subject"),
        ("version = 1\n[bones.head]\nlength = 'long'\n", "not a valid subject"),
        ("version = 1\n[bones.head]\nlength = -0.1\n", "no length"),
        ("version = 1\n[bones.head]\nlength = nan\n", "no length"),
        ("version = 1\n[bones.head]\ndirection = [0.0, 2.0, 0.0]\n", "direction not of unit"),
        ("version = 1\n[bones.head]\ndirection = [nan, 0.0, 0.0]\n", "direction not of unit"),
        ("version = 1\n[bones.head]\ndirection = [0.0, 1.0]\n", "not a valid subject"),
        (
            "version = 1\n[bones.head]\naxis_frame = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]\n",
            "axis frame of bone head",
        ),
        (
            "version = 1\n[bones.lhand]\naxis_frame = [[2, 0, 0], [0, 1, 0], [0, 0, 1]]\n",
            "axis frame of bone lhand",
        ),
        ("version = 1\n[[mounts]]\ntracker = 't'\n", "bone"),
        (
            "version = 1\n[[mounts]]\ntracker='t'\nbone='tail'\nposition=[0, 0, 0]\n",
            "unknown bone 'tail'",
        ),
        ("version = 1\n[[mounts]]\ntracker='t'\nbone='head'\nposition=[0, 0]\n", "3 numbers"),
        ("version = 1\n[[mounts]]\ntracker='t'\nbone='head'\nposition=[0, 0, inf]\n", "finite"),
        (
            "version = 1\n[[mounts]]\ntracker='t'\nbone='head'\nposition=[0, 0, 0]\n"
            "quaternion=[1, 1, 0, 0]\n",
            "unit length",
        ),
        (
            "version = 1\n" + "[[mounts]]\ntracker='t'\nbone='head'\nposition=[0, 0, 0]\n" * 2,
            "twice",
        ),
    ],
)
def test_a_faulty_file_is_refused_by_name(tmp_path, text, message):
    path = tmp_path / "faulty.toml"
    path.write_text(text)
    with pytest.raises(SubjectError, match=message) as caught:
        read_subject(path)
    assert str(path) in str(caught.value)


def test_a_missing_file_and_an_impossible_place_are_errors(tmp_path):
    with pytest.raises(SubjectError, match="cannot read"):
        read_subject(tmp_path / "none.toml")
    with pytest.raises(SubjectError, match="cannot write"):
        write_subject(canonical_subject(), tmp_path / "none" / "subject.toml")


def test_bytes_that_are_no_text_are_refused(tmp_path):
    path = tmp_path / "binary.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SubjectError, match="not a subject file"):
        read_subject(path)


def test_default_mounts_sit_at_bone_ends():
    subject = make_subject(4)
    plain = Subject(subject.name, subject.lengths, subject.directions, subject.axis_frames)
    for mount in plain.mounts:
        np.testing.assert_allclose(mount.position, plain.offsets[BONE_NAMES.index(mount.bone)])


def test_trackers_can_be_chosen_and_ordered():
    subject = canonical_subject().with_trackers(("rhand", "head"))
    assert subject.trackers == ("rhand", "head")
    with pytest.raises(SubjectError, match="no tracker named tail"):
        subject.with_trackers(("tail",))
    with pytest.raises(SubjectError, match="none given"):
        subject.with_trackers(())


def test_mirrored_twice_is_the_same_body():
    subject = make_subject(8)
    assert subject.mirrored().mirrored().same_proportions(subject)
    assert not subject.mirrored().same_proportions(subject)


def test_the_canonical_body_is_its_own_mirror_image():
    assert canonical_subject().mirrored().same_proportions(canonical_subject())


def test_a_bone_of_no_length_keeps_the_usual_direction():
    offsets = default_offsets()
    offsets[3] = 0.0
    subject = Subject.from_offsets("flat", offsets)
    np.testing.assert_allclose(subject.directions[3], canonical_subject().directions[3])
    assert subject.lengths[3] == 0.0


def test_what_a_calibration_says_survives_the_file(tmp_path):
    record = CalibrationRecord(
        date="2026-01-02T03:04:05+00:00",
        method="eight poses",
        poses=("T", "bow"),
        pose_error=0.05,
        chi_square=1.1,
        lengths_from="published table",
        length_sd={"lfemur": 0.004, "head": 0.01},
        position_sd={"front": (0.001, 0.002, 0.003)},
        orientation_sd={"front": (0.01, 0.02, 0.03), "belt": (0.1, 0.2, 0.3)},
        observable=("lfemur",),
        notes=("pose T was mirrored",),
    )
    subject = replace(make_subject(2), calibration=record)
    path = tmp_path / "calibrated.toml"
    write_subject(subject, path)
    back = read_subject(path).calibration
    assert back is not None
    assert back.pose_error == pytest.approx(record.pose_error)
    for tracker, deviations in record.orientation_sd.items():
        assert back.orientation_sd[tracker] == pytest.approx(deviations)
    same = {"pose_error": record.pose_error, "orientation_sd": record.orientation_sd}
    assert replace(back, **same) == record
    assert "length_sd" in path.read_text()
    assert subject.mirrored().calibration is None


def test_a_file_without_a_calibration_has_none(tmp_path):
    path = tmp_path / "plain.toml"
    write_subject(make_subject(3), path)
    assert read_subject(path).calibration is None
    path.write_text("version = 1\n[calibration]\nmethod = 'no date'\n")
    with pytest.raises(SubjectError, match="date"):
        read_subject(path)
