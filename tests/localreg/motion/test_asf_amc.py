"""Acclaim files: what CMU's real files hold, what is accepted, and what is refused where."""

import time

import numpy as np
import pytest

from localreg.body.skeleton import BONE_NAMES, DOF_NAMES, default_axis_frames
from localreg.errors import MotionError
from localreg.motion.formats import ReadOptions, read_motion, write_motion
from localreg.motion.formats.asf import find_asf, read_asf
from localreg.motion.formats.axes import CMU_UNIT
from tests.localreg.motion.strategies import make_calm_motion, make_subject


@pytest.fixture
def files(tmp_path):
    """A small motion of subject 07 on disk: its AMC and ASF, and the motion itself."""
    motion = make_calm_motion(7, count=4)
    write_motion(motion, tmp_path / "07_03.amc")
    (tmp_path / "07_03.asf").rename(tmp_path / "07.asf")
    return tmp_path / "07_03.amc", tmp_path / "07.asf", motion


def edit(path, old, new, count=1):
    text = path.read_bytes()
    assert old.encode() in text, old
    path.write_bytes(text.replace(old.encode(), new.encode(), count))


def line_of(path, start, nth=1):
    lines = path.read_text().split("\n")
    return [i for i, line in enumerate(lines, 1) if line.split()[:1] == [start]][nth - 1]


def read_one(path, **options):
    (motion,) = read_motion(path, ReadOptions(**options))
    return motion


def test_all_real_files_read(motions_dir):
    paths = sorted((motions_dir / "cmu").rglob("*.amc"))
    motions = [read_one(path) for path in paths]
    assert len(motions) == 38
    assert sum(map(len, motions)) == 89600
    for motion in motions:
        assert motion.rate == 120.0
        assert motion.provenance.notes == ()
        np.testing.assert_allclose(motion.subject.axis_frames, default_axis_frames(), atol=1e-9)
        assert 0.7 < motion.subject.lengths[[1, 2]].sum() < 1.0


def test_first_frame_of_a_real_file(motions_dir):
    motion = read_one(motions_dir / "cmu/subjects/02/02_01.amc")
    position = np.array([10.4194, 30.1003, 16.7048]) * CMU_UNIT
    np.testing.assert_allclose(motion.qpos[0, :3], position, atol=1e-12)
    values = dict(zip(DOF_NAMES, np.degrees(motion.angles[0]), strict=True))
    assert values["lowerbackrx"] == pytest.approx(7.86573)
    assert values["lowerbackrz"] == pytest.approx(6.3571)
    assert values["rclaviclery"] == pytest.approx(0.0, abs=1e-10)
    assert values["rhandrx"] == pytest.approx(-25.9429)
    assert values["ltoesrx"] == pytest.approx(-10.2227)
    assert motion.subject.lengths[1] == pytest.approx(7.59371 * 0.0254 / 0.45)
    assert motion.provenance.subject == "02"
    assert motion.provenance.trial == "02_01"


def test_standing_upright_is_the_quarter_turn_about_x(files):
    amc, _, _ = files
    text = amc.read_text().split("\n")
    text[4] = "root 1 2 3 0 0 0"
    amc.write_text("\n".join(text))
    read = read_one(amc)
    np.testing.assert_allclose(read.qpos[0, 3:7], [0.5**0.5, 0.5**0.5, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(read.qpos[0, :3], np.array([1, -3, 2]) * CMU_UNIT, atol=1e-12)


def test_ten_thousand_frames_in_a_second(tmp_path):
    write_motion(make_calm_motion(1, count=10_000), tmp_path / "long.amc")
    start = time.perf_counter()
    assert len(read_one(tmp_path / "long.amc")) == 10_000
    # Half a second on two busy cores; the allowance is for slower ones and type checks.
    assert time.perf_counter() - start < 3.0


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\r\r\n"),
        lambda text: text.replace("\n", "\r"),
        lambda text: text.replace("\n", "\n\n"),
        lambda text: text.replace("\nroot", "\n# a comment\n\t root  "),
        lambda text: text.rstrip("\n"),
        lambda text: text.replace(":DEGREES\n", ""),
    ],
    ids=["crlf", "crcrlf", "cr", "blank lines", "comments", "no last line feed", "no unit"],
)
def test_layouts_that_mean_the_same(files, change):
    amc, _, motion = files
    amc.write_bytes(change(amc.read_text()).encode())
    read = read_one(amc)
    np.testing.assert_allclose(read.angles, motion.angles, atol=1e-9)
    assert read.provenance.notes == ()


def test_bones_in_another_order_and_scientific_notation(files):
    amc, _, motion = files
    lines = amc.read_text().strip("\n").split("\n")
    frames = [lines[i : i + 30] for i in range(3, len(lines), 30)]
    frames[1] = [frames[1][0], *reversed(frames[1][1:])]
    for frame in frames:
        frame[2] = " ".join(
            [frame[2].split()[0], *(f"{float(v):.15E}" for v in frame[2].split()[1:])]
        )
    amc.write_text("\n".join([*lines[:3], *(line for frame in frames for line in frame)]))
    np.testing.assert_allclose(read_one(amc).angles, motion.angles, atol=1e-9)


def test_radians_in_both_files(files):
    amc, asf, _ = files
    expected = read_one(amc)
    lines = amc.read_text().split("\n")
    for i, line in enumerate(lines):
        words = line.split()
        if len(words) > 1 and not line.startswith("#"):
            skip = 4 if words[0] == "root" else 1
            angles = [repr(np.radians(float(word)).item()) for word in words[skip:]]
            lines[i] = " ".join([*words[:skip], *angles])
    amc.write_text("\n".join(lines).replace(":DEGREES", ":RADIANS"))
    np.testing.assert_allclose(read_one(amc).qpos, expected.qpos, atol=1e-9)
    lines = asf.read_text().replace("angle deg", "angle rad").split("\n")
    for i, line in enumerate(lines):
        words = line.split()
        if words[:1] == ["axis"] and len(words) == 5:
            angles = [repr(np.radians(float(word)).item()) for word in words[1:4]]
            lines[i] = " ".join(["axis", *angles, "XYZ"])
    asf.write_text("\n".join(lines))
    edit(amc, ":RADIANS\n", "")
    read = read_one(amc)
    np.testing.assert_allclose(read.qpos, expected.qpos, atol=1e-9)
    np.testing.assert_allclose(read.subject.axis_frames, expected.subject.axis_frames, atol=1e-9)


def test_root_values_in_another_order(files):
    amc, asf, _ = files
    expected = read_one(amc)
    edit(asf, "order TX TY TZ RX RY RZ", "order RZ RY RX TZ TY TX")
    lines = amc.read_text().split("\n")
    for i, line in enumerate(lines):
        if line.startswith("root"):
            lines[i] = " ".join(["root", *reversed(line.split()[1:])])
    amc.write_text("\n".join(lines))
    np.testing.assert_allclose(read_one(amc).qpos, expected.qpos, atol=1e-12)


def test_values_in_the_order_of_the_skeletons_dofs(files):
    amc, asf, _ = files
    expected = read_one(amc)
    lines = asf.read_text().split("\n")
    head = next(i for i, line in enumerate(lines) if line.strip() == "name head")
    dof = next(i for i in range(head, len(lines)) if lines[i].strip().startswith("dof"))
    lines[dof] = "dof rz rx ry"
    asf.write_text("\n".join(lines))
    lines = amc.read_text().split("\n")
    for i, line in enumerate(lines):
        if line.startswith("head "):
            _, x, y, z = line.split()
            lines[i] = f"head {z} {x} {y}"
    amc.write_text("\n".join(lines))
    np.testing.assert_allclose(read_one(amc).qpos, expected.qpos, atol=1e-12)


def test_missing_bones_rest_and_are_noted(files):
    amc, _, _ = files
    lines = [
        line for line in amc.read_text().split("\n") if not line.startswith(("lthumb", "head"))
    ]
    amc.write_text("\n".join(lines))
    read = read_one(amc)
    assert read.provenance.notes == ("no values for head, lthumb; they are zero",)
    absent = [DOF_NAMES.index(name) for name in ("headrx", "headry", "headrz", "lthumbrx")]
    assert not read.angles[:, absent].any()


def test_a_missing_root_rests_upright_and_is_noted(files):
    amc, _, _ = files
    lines = [line for line in amc.read_text().split("\n") if not line.startswith("root")]
    amc.write_text("\n".join(lines))
    read = read_one(amc)
    assert "root" in read.provenance.notes[0]
    np.testing.assert_allclose(read.qpos[:, 3:7], [[0.5**0.5, 0.5**0.5, 0, 0]] * 4)


@pytest.mark.parametrize("cut", [3, 12, 20, 700])
def test_a_last_frame_cut_short_is_dropped_and_noted(files, cut):
    amc, _, motion = files
    data = amc.read_bytes()
    amc.write_bytes(data[:-cut] if cut != 3 else data[: data.rindex(b" ") + 1] + b"-")
    read = read_one(amc)
    assert len(read) == 3
    assert read.provenance.notes == ("frame 4 is cut short and was dropped",)
    np.testing.assert_allclose(read.angles, motion.angles[:3], atol=1e-9)


def test_frame_numbers_out_of_sequence_are_noted(files):
    amc, _, _ = files
    edit(amc, "\n3\n", "\n7\n")
    read = read_one(amc)
    assert len(read) == 4
    assert read.provenance.notes == ("frame numbers are out of sequence, first 2 to 7; order kept",)


@pytest.mark.parametrize(
    ("old", "new", "where", "message"),
    [
        ("\nrtibia ", "\nrtail ", ("rtail", 1), "bone 'rtail' does not move in the skeleton"),
        ("\nltibia ", "\nltibia 1.0 ", ("ltibia", 1), "ltibia has 2 values, the skeleton says 1"),
        ("\nltibia ", "\nltibia nan # ", ("ltibia", 1), "not finite"),
        ("\nltibia ", "\nltibia inf # ", ("ltibia", 1), "not finite"),
        ("\nltibia ", "\nltibia 1,5 # ", ("ltibia", 1), "'1,5' is not a number"),
        ("\nltoes ", "\nltibia ", ("ltibia", 2), "ltibia occurs twice"),
        ("\n3\nroot", "\n3\n# root", ("4", 1), "frame 3 and the first one differ in having root"),
        (":DEGREES\n1\n", ":DEGREES\n", ("root", 1), "expected a frame number"),
    ],
)
def test_faults_in_a_motion_name_the_line(files, old, new, where, message):
    amc, _, _ = files
    edit(amc, old, new)
    with pytest.raises(MotionError, match=message) as caught:
        read_one(amc)
    line = line_of(amc, *where)
    assert str(caught.value).startswith(f"{amc}, line {line}: ")


@pytest.mark.parametrize("text", ["", "# only\n:DEGREES\n", "\n\n"])
def test_a_file_without_frames_is_an_error(files, text):
    amc, _, _ = files
    amc.write_text(text)
    with pytest.raises(MotionError, match="holds no frames"):
        read_one(amc)


@pytest.mark.parametrize("text", [":DEGREES\n1\n", ":DEGREES\n1\nroot 1 2\n"])
def test_a_file_without_a_complete_frame_is_an_error(files, text):
    amc, _, _ = files
    amc.write_text(text)
    with pytest.raises(MotionError, match=r"line [23]: the file holds no complete frame"):
        read_one(amc)


def test_a_file_that_is_not_there_is_an_error(tmp_path):
    with pytest.raises(MotionError, match="cannot read"):
        read_one(tmp_path / "none.amc")


@pytest.mark.parametrize(
    ("old", "new", "where", "message"),
    [
        ("length 0.45", "length 0", "length 0", "must be positive"),
        ("length 0.45", "length foot", "length foot", "'foot' is not a number"),
        ("angle deg", "angle gon", "angle gon", "deg or rad, not 'gon'"),
        ("order TX TY TZ RX RY RZ", "order TX TY TZ", "order", "must name TX TY TZ RX RY RZ"),
        ("axis XYZ", "axis XY", "axis XY", "an axis order is XYZ or alike"),
        ("name lradius", "name tail", "name tail", "bone 'tail' is not one of CMU's skeleton"),
        ("name lradius", "name rradius", "name rradius", "bone rradius occurs twice"),
        ("id 3\n", "id 3\n begin\n", "begin", "not closed"),
        ("dof ry rz", "dof rx ry rz", "dof rx ry rz", "but the canonical skeleton's by ry rz"),
        ("dof ry rz", "dof tx ry rz", "dof tx", "bone lclavicle moves by tx ry rz"),
        (
            "    lwrist lhand lthumb",
            "    lwrist lhand\n lhand lthumb",
            "lhand lthumb",
            "hangs on lhand",
        ),
        ("lowerneck upperneck", "upperback upperneck", "upperback upperneck", "hangs on upperback"),
    ],
)
def test_faults_in_a_skeleton_name_the_line(files, old, new, where, message):
    _, asf, _ = files
    edit(asf, old, new)
    lines = asf.read_text().split("\n")
    matching = [i for i, line in enumerate(lines, 1) if line.strip().startswith(where)]
    if "clavicle" in message or "canonical" in message:
        matching = [i for i in matching if i > lines.index("    name lclavicle")]
    with pytest.raises(MotionError, match=message) as caught:
        read_asf(asf)
    assert any(str(caught.value).startswith(f"{asf}, line {n}: ") for n in matching)


@pytest.mark.parametrize("key", ["direction", "length"])
@pytest.mark.parametrize("value", ["nan", "x", ""])
def test_faulty_numbers_of_a_bone_name_the_line(files, key, value):
    _, asf, _ = files
    lines = asf.read_text().split("\n")
    index = [i for i, line in enumerate(lines) if line.strip().startswith(key)][-1]
    lines[index] = f"{key} {value} 0 1" if key == "direction" and value else f"{key} {value}"
    asf.write_text("\n".join(lines))
    with pytest.raises(MotionError, match=f"line {index + 1}: "):
        read_asf(asf)


def test_a_missing_bone_is_named(files):
    _, asf, _ = files
    text = asf.read_text()
    start = text.index("  begin\n    id 5\n")
    end = text.index("  begin\n    id 6\n")
    asf.write_text(text[:start] + text[end:])
    with pytest.raises(MotionError, match="bone ltoes is missing"):
        read_asf(asf)


def test_a_skeleton_cut_short_is_an_error(files):
    _, asf, _ = files
    text = asf.read_text()
    asf.write_text(text[: text.index("name lradius") + 20])
    with pytest.raises(MotionError, match="not closed; the file seems cut short"):
        read_asf(asf)


def test_length_units(files):
    _, asf, motion = files
    np.testing.assert_allclose(read_asf(asf).subject.lengths, motion.subject.lengths, rtol=1e-9)
    edit(asf, "length 0.45", "length 0.9")
    np.testing.assert_allclose(read_asf(asf).subject.lengths, motion.subject.lengths / 2, rtol=1e-9)
    read = read_asf(asf, metres_per_unit=CMU_UNIT)
    np.testing.assert_allclose(read.subject.lengths, motion.subject.lengths, rtol=1e-9)


def test_which_skeleton_goes_with_a_motion(tmp_path):
    motion = tmp_path / "02_01.amc"
    motion.touch()
    with pytest.raises(MotionError, match=r"none at all; put 02_01\.asf there"):
        find_asf(motion)
    (tmp_path / "someone.asf").touch()
    assert find_asf(motion).name == "someone.asf"
    (tmp_path / "else.ASF").touch()
    with pytest.raises(MotionError, match=r"has else\.ASF, someone\.asf"):
        find_asf(motion)
    (tmp_path / "2.asf").touch()
    assert find_asf(motion).name == "2.asf"
    (tmp_path / "02.asf").touch()
    assert find_asf(motion).name == "02.asf"
    (tmp_path / "02_01.asf").touch()
    assert find_asf(motion).name == "02_01.asf"


def test_options_rule_over_the_file(files):
    amc, asf, motion = files
    assert read_one(amc).rate == 120.0
    assert read_one(amc, source_rate=60.0).rate == 60.0
    assert read_one(amc, source_rate=60.0, rate=30.0).rate == 30.0
    other = make_subject(99)
    asf.unlink()
    read = read_one(amc, subject=other)
    assert read.subject is other
    np.testing.assert_allclose(read.qpos[:, :3], motion.qpos[:, :3], atol=1e-6)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_senseless_options_are_refused(value):
    with pytest.raises(MotionError, match="must be a positive number"):
        ReadOptions(rate=value)


def test_all_bones_come_back_in_the_skeleton(files):
    _, asf, motion = files
    skeleton = read_asf(asf)
    assert tuple(skeleton.dofs) == BONE_NAMES
    assert skeleton.subject.name == "07"
    np.testing.assert_allclose(skeleton.subject.offsets, motion.subject.offsets, atol=1e-11)
