"""SMPL archives, MVNX, points in C3D and TRC, OpenSim's MOT, and our own recordings."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BODY_NAMES, DOF_NAMES
from localreg.body.subject import canonical_subject, write_subject
from localreg.errors import MotionError
from localreg.motion.body_poses import body_points, body_turns
from localreg.motion.formats import ReadOptions, read_motion, write_motion
from localreg.motion.formats.c3d_file import read_c3d
from localreg.motion.formats.smpl_npz import JOINTS, usual_rest
from localreg.motion.markers import PLUG_IN_GAIT
from localreg.motion.postures import t_pose
from localreg.motion.sources import read_sources
from sensors.recording import Recorder
from tests.localreg.motion.strategies import make_calm_motion


@pytest.fixture(scope="module")
def walk():
    """Half a second of calm motion of a person of usual proportions."""
    calm = make_calm_motion(5, count=20, rate=40.0)
    qpos = calm.qpos.copy()
    qpos[:, 7:] *= 0.4
    for side in "lr":
        qpos[:, 7 + DOF_NAMES.index(side + "tibiarx")] += 0.5
        qpos[:, 7 + DOF_NAMES.index(side + "radiusrx")] += 0.6
    return replace(calm, qpos=qpos, subject=canonical_subject())


def read_one(path, **options):
    (motion,) = read_motion(path, ReadOptions(**options))
    return motion


def joints_apart(a, b):
    """Mean distance of the joints of two motions [m]."""
    ours, theirs = (body_points(m.qpos, m.subject)[0] for m in (a, b))
    return float(np.linalg.norm(ours - theirs, axis=2).mean())


def smpl_arrays(motion):
    """The rotation vectors and places of an SMPL model that moves as a motion."""
    bodies = [BODY_NAMES.index(bone) for _, _, bone in JOINTS]
    turns = body_turns(motion.qpos, motion.subject)[:, bodies]
    turns = turns @ np.swapaxes(t_pose(motion.subject)[bodies], 1, 2)
    local = turns.copy()
    for joint, (_, parent, _) in enumerate(JOINTS):
        if parent >= 0:
            local[:, joint] = np.swapaxes(turns[:, parent], 1, 2) @ turns[:, joint]
    vectors = Rotation.from_matrix(local.reshape(-1, 3, 3)).as_rotvec()
    hands = np.zeros((len(motion), 90))
    return np.hstack([vectors.reshape(len(motion), -1), hands]), motion.qpos[:, :3] - usual_rest()[
        0
    ]


def test_an_archive_as_amass_has_them(tmp_path, walk):
    poses, trans = smpl_arrays(walk)
    gender = np.array("neutral", dtype=object)
    np.savez(tmp_path / "x.npz", poses=poses, trans=trans, mocap_framerate=40.0, gender=gender)
    read = read_one(tmp_path / "x.npz")
    assert (read.provenance.skeleton, read.rate, len(read)) == ("SMPL", 40.0, len(walk))
    assert "usual proportions" in " ".join(read.provenance.notes)
    assert read.provenance.joint_error < 2e-3
    assert joints_apart(read, walk) < 0.03
    np.savez(tmp_path / "y.npz", root_orient=poses[:, :3], pose_body=poses[:, 3:66], trans=trans,
             fps=40, J=1.1 * usual_rest())  # fmt: skip
    again = read_one(tmp_path / "y.npz")
    ratio = again.subject.lengths / read.subject.lengths
    assert np.median(ratio) == pytest.approx(1.1, abs=0.01)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"a": np.zeros(3)}, "no `poses`"),
        ({"poses": np.zeros((4, 60))}, "at least 66 numbers"),
        ({"poses": np.zeros((4, 156))}, "no places `trans`"),
        ({"poses": np.full((4, 156), np.nan), "trans": np.zeros((4, 3))}, "not finite"),
        ({"poses": np.array([{}])}, "no archive of NumPy arrays"),
    ],
)
def test_faulty_archives_say_what_they_lack(tmp_path, arrays, message):
    np.savez(tmp_path / "x.npz", **arrays)
    with pytest.raises(MotionError, match=message):
        read_one(tmp_path / "x.npz")


def write_mvnx(path, motion, *, drop="", extra=""):
    """An MVNX file of a motion: segments in a T pose at rest, x forward and z up."""
    segments = {
        "Pelvis": "root", "L5": "lowerback", "L3": "lowerback", "T12": "upperback", "T8": "thorax",
        "Neck": "lowerneck", "Head": "head",
    }  # fmt: skip
    for side, word in (("r", "Right"), ("l", "Left")):
        for name, bone in (("Shoulder", "clavicle"), ("UpperArm", "humerus"), ("ForeArm", "radius"),
                           ("Hand", "hand"), ("UpperLeg", "femur"), ("LowerLeg", "tibia"),
                           ("Foot", "foot"), ("Toe", "toes")):  # fmt: skip
            segments[word + name] = side + bone
    bodies = [BODY_NAMES.index(bone) for bone in segments.values()]
    axes = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    rest = t_pose(motion.subject)[bodies]
    turns = body_turns(motion.qpos, motion.subject)[:, bodies] @ np.swapaxes(rest, 1, 2) @ axes
    places = body_points(motion.qpos, motion.subject)[0][:, bodies]
    labels = "".join(
        f'<segment label="{name}" id="{i}"/>' for i, name in enumerate(segments, 1) if name != drop
    )
    frames = ""
    for place, turn in zip(places, turns, strict=True):
        quaternion = Rotation.from_matrix(turn).as_quat(scalar_first=True)
        frames += (
            f'<frame type="normal"><orientation>{words(quaternion)}</orientation>'
            f"<position>{words(place)}</position></frame>"
        )
    path.write_text(
        f'<?xml version="1.0"?>{extra}<mvnx xmlns="http://example.org/mvnx"><subject '
        f'frameRate="{motion.rate:g}"><segments>{labels}</segments><frames>'
        f'<frame type="identity"/>{frames}</frames></subject></mvnx>'
    )


def words(numbers):
    return " ".join(f"{value:.6f}" for value in np.ravel(numbers))


def test_mvnx(tmp_path, walk):
    write_mvnx(tmp_path / "x.mvnx", walk)
    read = read_one(tmp_path / "x.mvnx")
    assert (read.provenance.skeleton, read.rate, len(read)) == ("Xsens", 40.0, len(walk))
    assert read.provenance.joint_error < 5e-3
    assert joints_apart(read, walk) < 0.02


def test_faulty_mvnx(tmp_path, walk):
    path = tmp_path / "x.mvnx"
    write_mvnx(path, walk, drop="LeftFoot")
    with pytest.raises(MotionError, match="lacks places or turns of its 22 segments"):
        read_one(path)
    write_mvnx(path, walk, extra='<!DOCTYPE x [<!ENTITY a "b">]>')
    with pytest.raises(MotionError, match="XML entities"):
        read_one(path)
    write_mvnx(path, walk)
    path.write_text(path.read_text()[:-20])
    with pytest.raises(MotionError, match="no sound XML"):
        read_one(path)
    path.write_text("<a>" * 200 + "</a>" * 200)
    with pytest.raises(MotionError, match="nests deeper"):
        read_one(path)


@pytest.mark.parametrize("suffix", [".c3d", ".trc"])
def test_joint_centers_come_back(tmp_path, walk, suffix):
    write_motion(walk, tmp_path / f"x{suffix}")
    read = read_one(tmp_path / f"x{suffix}")
    assert read.provenance.skeleton == "joint centers"
    assert (read.rate, len(read)) == (40.0, len(walk))
    assert read.provenance.joint_error < 1e-3
    assert joints_apart(read, walk) < 2e-3


def write_markers(path, motion, *, lost=""):
    """A C3D file of the Plug-in Gait markers alone, with a prefix and a gap."""
    import ezc3d

    write_motion(motion, path)
    file = ezc3d.c3d(str(path))
    labels = file["parameters"]["POINT"]["LABELS"]["value"]
    names = [point.name for point in PLUG_IN_GAIT if point.name != lost]
    places = file["data"]["points"][:, [labels.index(name) for name in names]].copy()
    places[:3, 4, 5:9] = np.nan
    out = ezc3d.c3d()
    out["parameters"]["POINT"]["RATE"]["value"] = [motion.rate]
    out["parameters"]["POINT"]["LABELS"]["value"] = [f"Subject:{name}" for name in names]
    out["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    out["data"]["points"] = places
    out.write(str(path))


def test_a_skeleton_is_fitted_to_plug_in_gait_markers(tmp_path, walk):
    write_markers(tmp_path / "x.c3d", walk)
    read = read_one(tmp_path / "x.c3d")
    assert read.provenance.skeleton == "Plug-in Gait markers"
    assert "were missing and were bridged" in " ".join(read.provenance.notes)
    assert read.provenance.joint_error < 0.01
    # Joints as the regressions place them, against those that the markers were made of.
    assert joints_apart(read, walk) < 0.02


def test_markers_that_lack_say_which(tmp_path, walk):
    write_markers(tmp_path / "x.c3d", walk, lost="LKNE")
    with pytest.raises(MotionError, match=r"lacking LKNE\)"):
        read_one(tmp_path / "x.c3d")


def test_c3d_in_all_three_kinds_of_numbers(tmp_path):
    places = np.array([[[100.0, -250.0, 1800.0], [1.0, 2.0, 3.0]]] * 3)
    for processor in (84, 85, 86):
        for width in (2, 4):
            path = tmp_path / f"{processor}_{width}.c3d"
            path.write_bytes(c3d_bytes(places, processor, width))
            file = read_c3d(path)
            assert (file.labels, file.unit, file.rate) == (("A", "B"), "mm", 50.0)
            np.testing.assert_allclose(file.places[:, 0], places[:, 0])
            assert np.isnan(file.places[:, 1]).all()  # marked as not seen


def c3d_bytes(places, processor, width):
    """A small C3D file by hand; the second point is marked as not seen."""
    order = ">" if processor == 86 else "<"

    def real(value):
        data = np.array([value], order + "f4").tobytes()
        if processor == 85:  # VAX: exponent greater by two, halves exchanged
            data = np.array([4.0 * value], "<f4").tobytes()
            data = data[2:] + data[:2]
        return data

    def whole(value):
        return np.array([value], order + "i2").tobytes()

    def parameter(group, name, kind, shape, data):
        body = bytes([kind & 0xFF, len(shape), *shape]) + data + b"\0"
        head = bytes([len(name), group & 0xFF]) + name.encode()
        return head + whole(len(body) + 2) + body

    scale = -1.0 if width == 4 else 0.5
    parameters = bytes([1, 0x50, 1, processor])
    parameters += bytes([5, 0xFF]) + b"POINT" + whole(3) + b"\0"
    parameters += parameter(1, "LABELS", -1, (4, 2), b"A   B   ")
    parameters += parameter(1, "UNITS", -1, (2, 1), b"mm")
    parameters += parameter(1, "RATE", 4, (), real(50.0))
    parameters += parameter(1, "SCALE", 4, (), real(scale)) + b"\0\0"
    frames, count = places.shape[:2]
    head = bytes([2, 0x50]) + whole(count) + whole(0) + whole(1) + whole(frames) + whole(0)
    head += real(scale) + whole(3) + whole(0) + real(50.0)
    body = b""
    for frame in places:
        for point, place in enumerate(frame):
            residual = 0.0 if point == 0 else -1.0
            for value in (*place, residual):
                if width == 4:
                    body += real(value)
                else:
                    body += whole(int(value if value == -1.0 else value / scale))
    return head.ljust(512, b"\0") + parameters.ljust(512, b"\0") + body


def test_coordinates_of_opensim_come_back(tmp_path, walk):
    write_motion(walk, tmp_path / "x.mot")
    read = read_one(tmp_path / "x.mot", subject=walk.subject)
    assert read.rate == pytest.approx(40.0)
    np.testing.assert_allclose(read.qpos[:, :3], walk.qpos[:, :3], atol=1e-5)
    assert np.degrees(np.abs(np.angle(np.exp(1j * (read.angles - walk.angles))))).max() < 1e-3
    assert read_one(tmp_path / "x.mot").provenance.notes == (
        "the file has no bone lengths: usual proportions",
    )
    text = (tmp_path / "x.mot").read_text()
    for old, new, message in (
        ("endheader", "end", "no line endheader"),
        ("hip_flexion_r", "tail_wag", "coordinates such as hip_flexion_r"),
        ("\n0.025\t", "\n0.02x\t", "no number"),
        ("\n0.025\t", "\n0.04\t", "not evenly spaced"),
    ):
        assert old in text
        (tmp_path / "y.mot").write_text(text.replace(old, new, 1))
        with pytest.raises(MotionError, match=message):
            read_one(tmp_path / "y.mot")


def test_poses_of_our_own_recordings(tmp_path, walk):
    write_subject(walk.subject, tmp_path / "subject.toml")
    with Recorder(tmp_path / "x.mcap") as recorder:
        schema = {"type": "object"}
        take = recorder.channel("/take", "localreg.Take", schema)
        poses = recorder.channel("/poses", "localreg.Pose", schema)
        take.write({"version": 1, "subject": (tmp_path / "subject.toml").read_text()}, 0.0)
        for index, qpos in enumerate(walk.qpos):
            if index != 7:  # a frame that was passed over
                message = {"index": index + 3, "time": index / 40.0, "qpos": qpos.tolist()}
                poses.write(message, index / 40.0)
    (read,), report = read_sources([tmp_path])
    assert report.entries[0].name == "x"
    assert read.rate == pytest.approx(40.0)
    expected = walk.qpos.copy()
    expected[7] = expected[6]
    np.testing.assert_allclose(read.qpos, expected, atol=1e-9)
    np.testing.assert_allclose(read.subject.offsets, walk.subject.offsets, atol=1e-9)
    assert read.provenance.notes == ("1 frames without a pose hold the one before",)


def test_recordings_of_trackers_alone_say_what_to_do(tmp_path):
    with Recorder(tmp_path / "x.mcap") as recorder:
        recorder.channel("/other", "localreg.Other", {"type": "object"}).write({"index": 0}, 0.0)
    with pytest.raises(MotionError, match="localreg synthesize"):
        read_one(tmp_path / "x.mcap")
