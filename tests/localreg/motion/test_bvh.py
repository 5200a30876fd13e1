"""BVH files: CMU's real ones, other layouts, and what is refused where."""

import re

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from localreg.body.kinematics import Kinematics, bone_ends_batch
from localreg.body.skeleton import BONE_NAMES
from localreg.errors import MotionError
from localreg.motion.formats import ReadOptions, read_motion, write_motion
from localreg.motion.formats.bvh import JOINT_NAMES
from localreg.motion.formats.bvh_file import read_bvh_file
from tests.localreg.motion.strategies import make_calm_motion, make_motion, turn_distance

TURNS = "Zrotation Yrotation Xrotation"


@pytest.fixture
def file(tmp_path):
    """A small motion on disk, and the motion."""
    motion = make_calm_motion(7, count=4)
    write_motion(motion, tmp_path / "calm.bvh")
    return tmp_path / "calm.bvh", motion


def edit(path, old, new, count=1):
    text = path.read_bytes()
    assert old.encode() in text, old
    path.write_bytes(text.replace(old.encode(), new.encode(), count))


def read_one(path, **options):
    (motion,) = read_motion(path, ReadOptions(**options))
    return motion


def test_real_files_of_the_skeleton_read(motions_dir):
    folders = [f for f in sorted((motions_dir / "cmu-bvh").iterdir()) if f.name != "martial"]
    paths = [path for folder in folders for path in sorted(folder.glob("*.bvh"))]
    assert len(paths) == 72
    for path in paths[::6]:  # all of them are sound; these are enough for every day
        motion = read_one(path)
        assert motion.rate == 120.0
        assert motion.provenance.notes == (
            "lengths taken as CMU units",
            "bones that the file leaves out take usual proportions: thorax, lwrist, rwrist",
        )


def test_walking_1_is_02_01_on_its_own_skeleton(motions_dir):
    truth = read_one(motions_dir / "cmu/subjects/02/02_01.amc")
    path = motions_dir / "cmu-bvh/walking/walking_1.bvh"
    motion = read_one(path, subject=truth.subject)
    np.testing.assert_allclose(motion.angles, truth.angles, atol=np.radians(1e-3))
    assert turn_distance(motion.qpos[:, 3:7], truth.qpos[:, 3:7]).max() < np.radians(1e-3)
    kinematics = Kinematics.from_subject(truth.subject)
    ours = bone_ends_batch(kinematics, jnp.asarray(motion.qpos))
    theirs = bone_ends_batch(kinematics, jnp.asarray(truth.qpos))
    np.testing.assert_allclose(ours, theirs, atol=2e-5)
    # The file's own skeleton is the same but for the bones that it leaves out.
    completed = read_one(path).subject
    present = [i for i, n in enumerate(BONE_NAMES) if n not in ("thorax", "lwrist", "rwrist")]
    np.testing.assert_allclose(
        completed.offsets[present], truth.subject.offsets[present], atol=2e-5
    )
    assert np.abs(completed.lengths - truth.subject.lengths).max() < 0.01


def test_another_skeleton_is_retargeted(motions_dir):
    path = motions_dir / "cmu-bvh/martial/06.bvh"
    file = read_bvh_file(path)
    assert (len(file.joints), len(file.values), file.rate) == (43, 3262, 120.0)
    motion = read_one(path)
    assert motion.provenance.skeleton == "Poser"
    assert len(motion) == 3262 - 8
    assert "dropped a reference pose" in " ".join(motion.provenance.notes)


def test_what_we_write_says_so_in_centimetres(file):
    path, motion = file
    text = path.read_text()
    joints = re.findall(r"(?:ROOT|JOINT) (\w+)", text)
    assert joints[0] == "Hips"
    assert set(joints) == set(JOINT_NAMES.values())
    leg = motion.subject.offsets[BONE_NAMES.index("lfemur")] * 100.0
    assert f"OFFSET {leg[0]:.6f} {leg[1]:.6f} {leg[2]:.6f}" in text
    assert f"CHANNELS 6 Xposition Yposition Zposition {TURNS}" in text
    x, y, z = motion.qpos[0, :3]
    assert text.splitlines()[-4].startswith(f"{100 * x:.6f} {100 * z:.6f} {-100 * y:.6f} ")


@pytest.mark.parametrize("order", ["XYZ", "YZX", "ZXY", "XZY", "YXZ"])
def test_any_order_of_channels(file, order):
    path, motion = file
    text = (
        path.read_text()
        .replace(TURNS, " ".join(f"{axis}ROTATION" for axis in order))
        .replace("Xposition Yposition Zposition", "Zposition Xposition Yposition")
    )
    head, _, body = text.partition("Frame Time")
    rows = []
    for line in body.strip().split("\n")[1:]:
        x, y, z, *angles = map(float, line.split())
        turns = Rotation.from_euler("ZYX", np.reshape(angles, (-1, 3)), degrees=True)
        values = [z, x, y, *turns.as_euler(order, degrees=True).ravel()]
        rows.append(" ".join(map(repr, map(float, values))))
    path.write_text("\n".join([head + "Frame Time: 0.0083333", *rows]))
    read = read_one(path)
    np.testing.assert_allclose(read.qpos[:, :3], motion.qpos[:, :3], atol=1e-7)
    assert turn_distance(read.qpos[:, 3:7], motion.qpos[:, 3:7]).max() < 1e-6
    assert np.abs(np.exp(1j * read.angles) - np.exp(1j * motion.angles)).max() < 1e-6


@pytest.mark.parametrize(
    ("frame_time", "rate"),
    [
        ("0.0083333", 120.0), ("0.008333", 120.0), ("0.00833333", 120.0), ("0.0333", 30.0),
        ("0.033333", 30.0), ("0.0166666", 60.0), ("0.03", 1 / 0.03), ("0.04", 25.0),
        ("0.010000", 100.0), ("0.0417083", 1 / 0.0417083), ("8.3333e-3", 1 / 8.3333e-3), ("1", 1.0),
    ],
)  # fmt: skip
def test_frame_times_of_few_digits(file, frame_time, rate):
    path, motion = file
    edit(path, f"Frame Time: {1 / motion.rate:.12f}", f"Frame Time:\t{frame_time}")
    assert read_one(path).rate == pytest.approx(rate, rel=1e-12)


@pytest.mark.parametrize("rate", [24.0, 120.0, 33.333333333, 59.94, 1.6, 1000.0])
def test_rates_come_back(tmp_path, rate):
    write_motion(make_calm_motion(1, count=3, rate=rate), tmp_path / "x.bvh")
    assert read_one(tmp_path / "x.bvh").rate == pytest.approx(rate, rel=1e-7)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\n\n"),
        lambda text: text.replace("\n{", " {").replace("\t", " "),
        lambda text: text.rstrip("\n"),
        lambda text: text.lower().replace("frames:", "Frames :"),
    ],
    ids=["crlf", "blank lines", "braces beside", "no last line feed", "lower case"],
)
def test_layouts_that_mean_the_same(file, change):
    path, motion = file
    text = change(path.read_text())
    for name in JOINT_NAMES.values():
        text = re.sub(rf"\b{name}\b", name, text, flags=re.IGNORECASE)
    path.write_bytes(text.encode())
    np.testing.assert_allclose(read_one(path).angles, motion.angles, atol=1e-6)


def test_units_are_told_by_the_legs(tmp_path):
    write_motion(make_calm_motion(3, count=2), tmp_path / "x.bvh")
    text = (tmp_path / "x.bvh").read_text()
    expected = read_one(tmp_path / "x.bvh")
    for name, factor in [("metres", 0.01), ("millimetres", 10.0), ("CMU units", 0.01 / 0.0564444)]:
        lines = []
        for line in text.split("\n"):
            words = line.split()
            if words[:1] == ["OFFSET"]:
                line = "OFFSET " + " ".join(repr(float(w) * factor) for w in words[1:])
            elif len(words) == 96:
                line = " ".join([*(repr(float(w) * factor) for w in words[:3]), *words[3:]])
            lines.append(line)
        (tmp_path / "y.bvh").write_text("\n".join(lines))
        read = read_one(tmp_path / "y.bvh")
        assert read.provenance.notes == (f"lengths taken as {name}",)
        np.testing.assert_allclose(read.subject.offsets, expected.subject.offsets, atol=1e-5)
        np.testing.assert_allclose(read.qpos[:, :3], expected.qpos[:, :3], atol=1e-5)
    forced = read_one(tmp_path / "x.bvh", metres_per_unit=0.02)
    np.testing.assert_allclose(forced.subject.lengths, 2 * expected.subject.lengths, atol=1e-9)
    assert forced.provenance.notes == ()


def test_rotation_that_hinges_cannot_take_is_noted(tmp_path):
    motion = make_motion(5, count=3, frames="random")
    write_motion(motion, tmp_path / "x.bvh")
    notes = " ".join(read_one(tmp_path / "x.bvh").provenance.notes)
    assert "ltibia: its hinges cannot take up to" in notes
    assert "lfemur" not in notes
    # Told the axis frames, the reader finds the angles again.
    read = read_one(tmp_path / "x.bvh", subject=motion.subject)
    assert len(read.provenance.notes) == 1


def test_a_wrong_count_is_noted(file):
    path, _ = file
    edit(path, "Frames: 4", "Frames: 9")
    read = read_one(path)
    assert len(read) == 4
    assert read.provenance.notes[0] == "the file claims '9' frames and holds 4"


def test_a_last_frame_cut_short_is_dropped_and_noted(file):
    path, _ = file
    path.write_bytes(path.read_bytes()[:-30])
    read = read_one(path)
    assert len(read) == 3
    assert read.provenance.notes[:2] == (
        "frame 4 is cut short and was dropped",
        "the file claims '4' frames and holds 3",
    )


def test_a_leaf_without_an_end_site_takes_usual_proportions(file):
    path, _ = file
    text = path.read_text()
    start = text.index("\tEnd Site", text.index("JOINT Head"))
    path.write_text(text[:start] + text[text.index("}", start) + 1 :])
    assert "usual proportions: head" in " ".join(read_one(path).provenance.notes)


def test_joints_that_move_in_their_parents_are_noted(file):
    path, _ = file
    edit(path, f"CHANNELS 3 {TURNS}", f"CHANNELS 6 Xposition Yposition Zposition {TURNS}")
    lines = path.read_text().strip("\n").split("\n")
    for i in range(-4, 0):
        words = lines[i].split()
        lines[i] = " ".join([*words[:6], "1", "2", "3", *words[6:]])
    path.write_text("\n".join(lines))
    assert "position channels left out" in " ".join(read_one(path).provenance.notes)


@pytest.mark.parametrize(
    ("old", "new", "where", "message"),
    [
        ("HIERARCHY", "HIERARCHIE", "HIERARCHIE", "expected HIERARCHY, found 'HIERARCHIE'"),
        ("ROOT Hips", "JOINT Hips", "JOINT Hips", "'JOINT' is out of place"),
        ("ROOT Hips", "ROOT", "ROOT", "a joint without a name"),
        ("JOINT LeftLeg", "ROOT LeftLeg", "ROOT LeftLeg", "out of place"),
        (f"CHANNELS 3 {TURNS}", "CHANNELS x", "CHANNELS x", "number of channels, found 'x'"),
        ("Zrotation Y", "Wrotation Y", "CHANNELS 6", "channel 'Wrotation' is unknown"),
        ("Zrotation Y", "Yrotation Y", "CHANNELS 6", "channel 'Yrotation' is unknown or given"),
        ("OFFSET 0.000000", "OFFSET nan", "OFFSET nan", "'nan' is not a number"),
        ("OFFSET 0.000000", "OFFSET none", "OFFSET none", "'none' is not a number"),
        ("OFFSET 0.000000 ", "OFFSET ", "CHANNELS", "'CHANNELS' is not a number"),
        ("End Site", "End Point", "End Point", "expected SITE"),
        ("CHANNELS 3", "LIMITS 3", "LIMITS 3", "'LIMITS' is not known"),
        ("}\nMOTION", "MOTION", "MOTION", "lacks a }"),
        ("MOTION", "MOVES", "MOVES", "expected ROOT or MOTION"),
        ("Frames: 4", "Frame count 4", "Frame count", "expected 'Frames: "),
        ("Frame Time: 0", "Time 0", "Time 0", "expected 'Frame Time: "),
        ("Frame Time: 0.", "Frame Time: -0.", "Frame Time", "a frame time of '-0."),
        ("Frame Time: 0.", "Frame Time: nan0.", "Frame Time", "a frame time of 'nan0."),
    ],
)
def test_faults_in_the_head_name_the_line(file, old, new, where, message):
    path, _ = file
    edit(path, old, new)
    lines = path.read_text().split("\n")
    line = next(i for i, text in enumerate(lines, 1) if text.strip().startswith(where))
    with pytest.raises(MotionError, match=message) as caught:
        read_one(path)
    assert str(caught.value).startswith(f"{path}, line {line}: ")


@pytest.mark.parametrize(
    ("word", "message"),
    [("nan", "not finite"), ("inf", "not finite"), ("1,5", "'1,5' is not a number"),
     ("", "has 96 values, this one 95"), ("1 2", "has 96 values, this one 97")],
)  # fmt: skip
@pytest.mark.parametrize("row", [0, 2])
def test_faults_in_a_frame_name_the_line(file, word, message, row):
    path, _ = file
    lines = path.read_text().strip("\n").split("\n")
    words = lines[row - 4].split()
    words[40] = word
    lines[row - 4] = " ".join(words)
    path.write_text("\n".join(lines))
    with pytest.raises(MotionError, match=message) as caught:
        read_one(path)
    assert str(caught.value).startswith(f"{path}, line {len(lines) + row - 3}: ")


@pytest.mark.parametrize(
    ("end", "message"),
    [
        ("JOINT Spine1", "ends inside the hierarchy"),
        ("\nFrames", "ends where 'Frames: "),
        ("\nFrame Time", "ends where 'Frame Time: "),
    ],
)
def test_files_cut_short_before_the_frames_are_errors(file, end, message):
    path, _ = file
    text = path.read_text()
    path.write_text(text[: text.index(end)])
    with pytest.raises(MotionError, match=message):
        read_one(path)


def test_a_file_without_frames_is_an_error(file):
    path, _ = file
    lines = path.read_text().strip("\n").split("\n")
    path.write_text("\n".join(lines[:-4]))
    with pytest.raises(MotionError, match="holds no complete frame"):
        read_one(path)
    path.write_bytes(b"")
    with pytest.raises(MotionError, match="ends inside the hierarchy"):
        read_one(path)


def test_joints_missing_or_hung_elsewhere_are_retargeted(file):
    path, motion = file
    text = path.read_text()
    start = text.index("JOINT LeftHandIndex1")
    end = text.index("}", text.index("}", start) + 1) + 1
    lines = (text[:start] + text[end:]).split("\n")
    lines = [" ".join(x.split()[:93]) if len(x.split()) == 96 else x for x in lines]
    path.write_text("\n".join(lines))
    assert len(read_one(path)) == len(motion)
    for number, name in enumerate(JOINT_NAMES.values()):
        text = re.sub(rf"\b{name}\b", f"j{number}", text)
    path.write_text(text)
    read = read_one(path)
    assert read.provenance.skeleton == "told by shape"
    np.testing.assert_allclose(read.qpos[:, :3], motion.qpos[:, :3], atol=0.01)
