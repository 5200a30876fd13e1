"""C3D by ezc3d; OpenSim's tables and model by a parser that follows OpenSim's layout alone."""

import itertools
import sys
from dataclasses import replace
from xml.etree import ElementTree as ET

import ezc3d
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from localreg.errors import MotionError
from localreg.motion.anatomical import COORDINATES, LENGTHS, poses
from localreg.motion.body_poses import body_points
from localreg.motion.formats import c3d_write, read_motion, write_motion
from localreg.motion.markers import POINTS, points
from tests.localreg.motion.strategies import make_calm_motion, make_motion, make_subject

MOTIONS = {
    "one": lambda: make_calm_motion(0, count=1),
    "calm": lambda: make_calm_motion(1, count=50, rate=59.94),
    "wild": lambda: make_motion(2, count=7, special=0.3),
}


@pytest.fixture(params=MOTIONS)
def motion(request):
    return MOTIONS[request.param]()


def ground(world):
    """OpenSim's ground, x forward, y up, z right, of our world, seen from who faces -y."""
    x, y, z = np.moveaxis(world, -1, 0)
    return np.stack([-y, z, -x], axis=-1)


def test_ezc3d_reads_every_point(motion, tmp_path):
    write_motion(motion, tmp_path / "x.c3d")
    file = ezc3d.c3d(str(tmp_path / "x.c3d"))
    point = file["parameters"]["POINT"]
    assert point["LABELS"]["value"] == list(POINTS)
    assert point["UNITS"]["value"] == ["mm"]
    assert point["RATE"]["value"] == [pytest.approx(motion.rate)]
    assert file["header"]["points"]["size"] == len(POINTS)
    places = file["data"]["points"][:3].transpose(2, 1, 0) / 1000.0
    np.testing.assert_allclose(places, points(motion), atol=1e-6)
    assert np.all(file["data"]["meta_points"]["residuals"] >= 0.0)


def test_feet_coming_down_and_leaving_are_events(motions_dir, tmp_path):
    (walk,) = read_motion(motions_dir / "cmu/subjects/02/02_01.amc")
    write_motion(walk, tmp_path / "x.c3d")
    event = ezc3d.c3d(str(tmp_path / "x.c3d"))["parameters"]["EVENT"]
    labels, contexts = event["LABELS"]["value"], event["CONTEXTS"]["value"]
    minutes, seconds = event["TIMES"]["value"]
    assert event["USED"]["value"] == [len(labels)]
    assert set(minutes) == {0.0}
    assert list(seconds) == sorted(seconds)
    assert 0.0 < seconds[0] < seconds[-1] < walk.seconds
    for side in ("Left", "Right"):
        own = [label for label, context in zip(labels, contexts, strict=True) if context == side]
        assert 4 <= len(own) <= 10  # two or three steps
        assert all(a != b for a, b in itertools.pairwise(own))  # down, up, down, ...


def test_more_events_than_a_parameter_holds_go_on_in_the_next(tmp_path, monkeypatch):
    motion = make_calm_motion(6, count=1300)
    blinking = np.zeros((1300, 4), dtype=bool)
    blinking[::4] = True
    monkeypatch.setattr(c3d_write, "settled_contacts", lambda ends, rate: blinking)
    write_motion(motion, tmp_path / "x.c3d")
    event = ezc3d.c3d(str(tmp_path / "x.c3d"))["parameters"]["EVENT"]
    counts = [len(event[f"LABELS{number}"]["value"]) for number in ("", "2", "3", "4", "5", "6")]
    assert counts == [255] * 5 + [23]
    assert event["USED"]["value"] == [1298]
    assert event["TIMES6"]["value"].shape == (2, 23)


def test_more_frames_than_c3d_can_count_are_refused(tmp_path):
    motion = make_calm_motion(5, count=2)
    long = replace(motion, qpos=np.tile(motion.qpos, (32_768, 1)))
    with pytest.raises(MotionError, match="65535; cut it"):
        write_motion(long, tmp_path / "x.c3d")
    assert list(tmp_path.iterdir()) == []


def test_joint_centres_are_where_bones_meet(motion):
    starts, ends = body_points(motion.qpos, motion.subject)
    found = dict(zip(POINTS, points(motion).transpose(1, 0, 2), strict=True))
    for name, places in {
        "PELVIS": starts[:, 0], "LKJC": starts[:, 3], "LAJC": starts[:, 4],
        "LTOE_END": ends[:, 5], "RKJC": starts[:, 8], "HEAD_END": ends[:, 16],
    }.items():  # fmt: skip
        np.testing.assert_allclose(found[name], places, atol=1e-12)


def test_markers_mirror_and_lie_outside():
    subject = make_subject(3)
    still = poses({name: np.zeros(1) for name in COORDINATES}, subject)
    found = dict(zip(POINTS, ground(points_of(still, subject))[0], strict=True))
    for marker, joint in (("KNE", "KJC"), ("ANK", "AJC"), ("ELB", "EJC")):
        assert found["R" + marker][2] > found["R" + joint][2] + 0.03
        assert found["L" + marker][2] < found["L" + joint][2] - 0.03
    assert found["LTOE"][0] > found["LHEE"][0] + 0.15
    assert found["CLAV"][0] > found["C7"][0] + 0.1
    assert found["RASI"][2] > 0.1 > -0.1 > found["LASI"][2]


def points_of(qpos, subject):
    motion = make_calm_motion(0, count=1)
    return points(type(motion)(qpos, 100.0, subject))


def read_trc(path):
    """Units in metres, times and marker places of a TRC file, checked against its own head."""
    lines = path.read_text().split("\n")
    assert lines[0].split("\t")[:3] == ["PathFileType", "4", "(X/Y/Z)"]
    fields = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=True))
    assert set(fields) == {
        "DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units", "OrigDataRate",
        "OrigDataStartFrame", "OrigNumFrames",
    }  # fmt: skip
    titles = lines[3].split("\t")
    assert titles[:2] == ["Frame#", "Time"]
    names = titles[2::3]
    assert len(names) == int(fields["NumMarkers"])
    assert all(title == "" for i, title in enumerate(titles[2:]) if i % 3)
    axes = lines[4].split("\t")
    assert axes[:2] == ["", ""]
    assert axes[2:] == [f"{a}{n}" for n in range(1, len(names) + 1) for a in "XYZ"]
    assert lines[5] == ""
    rows = np.array([[float(word) for word in line.split("\t")] for line in lines[6:] if line])
    assert len(rows) == int(fields["NumFrames"])
    np.testing.assert_array_equal(rows[:, 0], np.arange(1, len(rows) + 1))
    unit = {"mm": 1e-3, "m": 1.0}[fields["Units"]]
    places = unit * rows[:, 2:].reshape(len(rows), -1, 3)
    return float(fields["DataRate"]), rows[:, 1], names, places


def read_mot(path):
    """Times and columns in radians and metres of a MOT file, checked against its own head."""
    lines = path.read_text().split("\n")
    end = lines.index("endheader")
    fields = dict(line.split("=") for line in lines[1:end] if "=" in line)
    assert fields["version"] == "1"
    names = lines[end + 1].split("\t")
    assert names[0] == "time"
    assert len(names) == int(fields["nColumns"])
    rows = np.array([[float(w) for w in line.split("\t")] for line in lines[end + 2 :] if line])
    assert rows.shape == (int(fields["nRows"]), len(names))
    assert fields["inDegrees"] == "yes"
    columns = {
        name: rows[:, i] if name in LENGTHS else np.radians(rows[:, i])
        for i, name in enumerate(names[1:], start=1)
    }
    return rows[:, 0], columns


def test_trc_holds_every_point_in_opensims_ground(motion, tmp_path):
    write_motion(motion, tmp_path / "x.trc")
    rate, times, names, places = read_trc(tmp_path / "x.trc")
    assert rate == pytest.approx(motion.rate)
    assert names == list(POINTS)
    np.testing.assert_allclose(times, np.arange(len(motion)) / motion.rate, atol=1e-7)
    np.testing.assert_allclose(places, ground(points(motion)), atol=1e-7)


def test_mot_and_the_subject_make_the_motion_again(motion, tmp_path):
    write_motion(motion, tmp_path / "x.mot")
    times, columns = read_mot(tmp_path / "x.mot")
    assert list(columns) == list(COORDINATES)
    np.testing.assert_allclose(times, np.arange(len(motion)) / motion.rate, atol=1e-7)
    back = poses(columns, motion.subject)
    here, there = (body_points(q, motion.subject)[1] for q in (back, motion.qpos))
    np.testing.assert_allclose(here, there, atol=1e-6)


def test_the_model_moved_by_its_table_has_the_markers_of_the_other(motion, tmp_path):
    write_motion(motion, tmp_path / "x.osim")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["x.mot", "x.osim", "x.trc"]
    model = ET.parse(tmp_path / "x.osim").getroot()[0]  # noqa: S314
    _, columns = read_mot(tmp_path / "x.mot")
    *_, names, places = read_trc(tmp_path / "x.trc")
    frames = move(model, columns)
    for marker in model.iter("Marker"):
        turn, start = frames[marker.findtext("socket_parent_frame")]
        place = start + turn @ vector(marker.findtext("location"))
        column = names.index(marker.get("name"))
        np.testing.assert_allclose(place, places[:, column], atol=1e-6)
    assert {c.get("name") for c in model.iter("Coordinate")} == set(columns)
    assert all(float(body.findtext("mass")) > 0 for body in model.iter("Body"))


def move(model, columns):
    """The turn and place of every body by OpenSim's custom joints: R1 R2 R3, then the axes."""
    frames = {"/ground": (np.eye(3), np.zeros(3))}
    for joint in model.iter("CustomJoint"):
        above, child = (frame.findtext("socket_parent") for frame in joint.find("frames"))
        turn, start = frames[above]
        start = start + turn @ vector(joint.find("frames")[0].findtext("translation"))
        own, shift = np.eye(3), 0.0
        for axis in joint.find("SpatialTransform"):
            name = axis.findtext("coordinates")
            if not name:
                continue
            value = columns[name][:, None] * vector(axis.findtext("axis"))
            if axis.get("name").startswith("rotation"):
                own = own @ Rotation.from_rotvec(value).as_matrix()
            else:
                shift = shift + value
        if np.ndim(shift):
            start = start + shift
        frames[child] = (turn @ own, start)
    return frames


def vector(text):
    return np.array([float(word) for word in text.split()])


def test_without_ezc3d_a_sentence_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ezc3d", None)
    with pytest.raises(MotionError, match=r"install localreg-mocap\[c3d\]"):
        write_motion(make_calm_motion(4, count=2), tmp_path / "x.c3d")
    assert list(tmp_path.iterdir()) == []
