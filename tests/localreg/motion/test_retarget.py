"""Foreign skeletons on ours: families by name, others by shape, units, axes and rest poses."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BODY_NAMES, DOF_NAMES
from localreg.body.subject import canonical_subject
from localreg.errors import MotionError
from localreg.motion.body_poses import body_points, body_turns
from localreg.motion.formats import ReadOptions, read_motion, write_motion
from localreg.motion.formats.bvh_file import read_bvh_file
from localreg.motion.formats.bvh_joints import joint_motion, skeleton_tree
from localreg.motion.retarget_solver import joint_points
from localreg.motion.skeleton_maps import FOLDER, SkeletonMap, known_maps
from localreg.motion.skeleton_shapes import find_shape
from localreg.motion.sources import read_sources
from tests.localreg.motion.foreign_files import LAYOUTS, euler, world_points, write_bvh
from tests.localreg.motion.strategies import make_calm_motion, make_motion, turn_distance

ORDERS = ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx", "xyx", "xzx", "yxy", "yzy", "zxz", "zyz")
LIMB_DOFS = [i for i, n in enumerate(DOF_NAMES) if re.match("[lr](femur|tibia|humerus|radius)", n)]


@pytest.fixture(scope="module")
def walk():
    """A calm walk of a symmetric person: knees and elbows bend, the head is on top."""
    count, rate = 60, 30.0
    qpos = np.zeros((count, 63))
    t = np.arange(count)[:, None] / rate
    qpos[:, :3] = np.hstack([0.1 * np.sin(t), -1.2 * t, 0.95 + 0.02 * np.sin(9 * t)])
    turn = Rotation.from_euler("z", 0.3 * np.sin(t)) * Rotation.from_euler("x", np.pi / 2)
    qpos[:, 3:7] = turn.as_quat(scalar_first=True)
    rng = np.random.default_rng(4)
    angles = 0.15 * np.sin(2 * np.pi * t * rng.uniform(0.5, 1.2, 56) + rng.uniform(0, 6, 56))
    swing = np.sin(2 * np.pi * t[:, 0])
    for side, sign in (("l", 1.0), ("r", -1.0)):
        for name, values in {
            "femurrx": -0.2 + 0.5 * sign * swing, "femurrz": -sign * 0.35 + 0 * swing,
            "tibiarx": 0.6 + 0.5 * sign * swing, "humerusrz": -sign * 1.1 + 0 * swing,
            "radiusrx": 0.7 - 0.3 * sign * swing, "fingersrx": 0.4 + 0 * swing,
        }.items():  # fmt: skip
            angles[:, DOF_NAMES.index(side + name)] = values
    qpos[:, 7:] = angles
    return replace(make_calm_motion(1, count=2), qpos=qpos, rate=rate, subject=canonical_subject())


def read_one(path, **options):
    (motion,) = read_motion(path, ReadOptions(**options))
    return motion


@pytest.mark.parametrize("family", LAYOUTS)
def test_every_family_reads_with_its_own_bones(tmp_path, walk, family):
    layout = LAYOUTS[family]
    foreign = write_bvh(tmp_path / "x.bvh", walk, family)
    read = read_one(tmp_path / "x.bvh")
    made = read.provenance
    assert (made.skeleton, read.rate, len(read)) == (family, 30.0, len(walk))
    notes = " ".join(made.notes)
    unit = {1.0: "metres", 0.01: "centimetres", 0.0254: "inches"}.get(layout.unit, "CMU units")
    assert f"lengths taken as {unit}" in notes
    assert f"{layout.up} taken as up" in notes
    assert made.joint_error < 2e-3
    assert max(error for _, error in made.joint_errors) < 5e-3
    assert len(made.joint_errors) >= 15
    # The figures are true: knees, wrists and head lie where the file's own tree puts them.
    truth, (starts, _) = world_points(walk, foreign), body_points(read.qpos, read.subject)
    body = {index: name for name, index in zip(foreign.names, foreign.bodies, strict=True)}
    for bone in ("ltibia", "rfoot", "lradius", "rhand", "head", "lowerneck"):
        place = BODY_NAMES.index(bone)
        theirs = truth[:, foreign.names.index(body[place])]
        assert np.linalg.norm(starts[:, place] - theirs, axis=1).mean() < 5e-3, bone
    # Long bones of the same motion bend alike, whatever rest pose the file counts from.
    apart = np.abs(np.angle(np.exp(1j * (read.angles - walk.angles))))[:, LIMB_DOFS]
    assert np.degrees(np.median(apart)) < 2.0
    assert np.degrees(np.median(apart, axis=0)).max() < 12.0


@pytest.mark.parametrize("family", LAYOUTS)
def test_random_people_of_every_family_move_as_their_files_do(tmp_path, family):
    """Bones of random lengths, left and right apart, all joints at large angles."""
    motion = make_calm_motion(sorted(LAYOUTS).index(family), count=40, rate=40.0)
    write_bvh(tmp_path / "x.bvh", motion, family)
    read = read_one(tmp_path / "x.bvh")
    assert read.provenance.skeleton == family
    assert read.provenance.joint_error < 0.01
    assert max(error for _, error in read.provenance.joint_errors) < 0.03


def test_exchanged_sides_are_noted(tmp_path, walk):
    write_bvh(tmp_path / "x.bvh", walk, "Mixamo")
    text = (tmp_path / "x.bvh").read_text()
    text = text.replace("Left", "@").replace("Right", "Left").replace("@", "Right")
    (tmp_path / "x.bvh").write_text(text)
    notes = " ".join(read_one(tmp_path / "x.bvh").provenance.notes)
    assert "left and right seem to be exchanged" in notes


@pytest.mark.parametrize("names", ["mixamo", "vrm"])
def test_what_we_write_under_other_names_comes_back(tmp_path, walk, names):
    write_motion(walk, tmp_path / "x.bvh", names=names)
    read = read_one(tmp_path / "x.bvh")
    assert read.provenance.skeleton.lower() == names
    assert read.provenance.joint_error < 1e-3
    ours, _ = body_points(read.qpos, read.subject)
    theirs, _ = body_points(walk.qpos, walk.subject)
    assert np.linalg.norm(ours - theirs, axis=2).mean() < 1e-3


def test_unknown_names_are_told_by_shape(tmp_path, walk):
    write_bvh(tmp_path / "named.bvh", walk, "Mixamo")
    text = (tmp_path / "named.bvh").read_text()
    for number, name in enumerate(re.findall(r"(?:ROOT|JOINT) (\S+)", text)):
        text = re.sub(rf"(ROOT|JOINT) {name}$", rf"\1 part{number}", text, flags=re.MULTILINE)
    (tmp_path / "x.bvh").write_text(text)
    read, named = read_one(tmp_path / "x.bvh"), read_one(tmp_path / "named.bvh")
    assert read.provenance.skeleton == "told by shape"
    assert read.provenance.joint_error < 1e-3
    np.testing.assert_allclose(read.subject.offsets, named.subject.offsets, atol=5e-3)
    ours, _ = body_points(read.qpos, read.subject)
    theirs, _ = body_points(named.qpos, named.subject)
    assert np.linalg.norm(ours - theirs, axis=2).mean() < 5e-3


def test_a_skeleton_map_of_ones_own(tmp_path, walk):
    write_bvh(tmp_path / "x.bvh", walk, "Mixamo")
    text = (tmp_path / "x.bvh").read_text().replace("UpLeg", "Schenkel").replace("ForeArm", "Elle")
    (tmp_path / "x.bvh").write_text(text)
    own = (FOLDER / "mixamo.toml").read_text().replace("UpLeg", "Schenkel")
    own = own.replace("ForeArm", "Elle").replace('"Mixamo"', '"Mine"')
    (tmp_path / "my.toml").write_text(own)
    (tmp_path / "rules.toml").write_text(
        "[[file]]\nmatch = 'x.bvh'\nskeleton_map = 'my.toml'\nup = 'y'\n"
    )
    from localreg.motion.overrides import Overrides

    rules = Overrides.load(tmp_path / "rules.toml")
    for given_by in ({"overrides": rules}, {"skeleton_map": tmp_path / "my.toml"}):
        (motion,), report = read_sources([tmp_path / "x.bvh"], **given_by)
        assert motion.provenance.skeleton == report.entries[0].skeleton == "Mine"
        assert report.entries[0].joint_error < 1e-3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[limbs\n", "not a TOML file"),
        ("name = 'x'\n", "root: Field required"),
        ("name = 'x'\nroot = 'a'\nlimbs = {tail = 'b'}\n", "limbs.tail is no bone"),
        ("name = 'x'\nroot = 'a'\nlimbs = {femur = 'b'}\n", "limbs lacks tibia"),
        ("name = 'x'\nroot = 'a'\nlegs = 2\nlimbs = {}\n", "legs: Extra inputs"),
    ],
)
def test_faulty_maps_name_the_entry(tmp_path, text, message):
    (tmp_path / "my.toml").write_text(text)
    with pytest.raises(MotionError, match=message):
        SkeletonMap.load(tmp_path / "my.toml")


def test_the_maps_that_come_along_are_sound():
    assert len(known_maps()) >= 12
    assert len({found.name for found in known_maps()}) == len(known_maps())
    assert all(found.about for found in known_maps())


def test_joints_that_are_no_body_are_an_error(tmp_path):
    joints = "".join(f"JOINT tail{i}\n{{\nOFFSET 0 1 0\nCHANNELS 0\n" for i in range(20))
    text = f"HIERARCHY\nROOT a\n{{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n{joints}{'}' * 21}\n"
    (tmp_path / "x.bvh").write_text(f"{text}MOTION\nFrames: 1\nFrame Time: 0.1\n1\n")
    with pytest.raises(MotionError, match="no body that is known by name or shape") as caught:
        read_one(tmp_path / "x.bvh")
    assert "\n" not in str(caught.value)


def test_sizes_that_no_person_has_are_an_error(tmp_path, walk):
    write_bvh(tmp_path / "x.bvh", walk, "VRM")
    with pytest.raises(MotionError, match="no person in any usual unit"):
        read_one(tmp_path / "x.bvh", metres_per_unit=1000.0)


def test_up_may_be_laid_down(tmp_path, walk):
    write_bvh(tmp_path / "x.bvh", walk, "SMPL")
    lying = read_one(tmp_path / "x.bvh", up="y")
    standing = read_one(tmp_path / "x.bvh")
    assert "taken as up" not in " ".join(lying.provenance.notes)
    np.testing.assert_allclose(lying.qpos[:, 2], standing.qpos[:, 1], atol=2e-3)


def test_another_subject_turns_as_the_file_does(tmp_path, walk):
    write_bvh(tmp_path / "x.bvh", walk, "Mixamo")
    tall = replace(walk.subject, lengths=1.2 * walk.subject.lengths)
    read = read_one(tmp_path / "x.bvh", subject=tall)
    assert read.subject is tall
    turns, truth = (body_turns(m.qpos, m.subject) for m in (read, walk))
    for bone in ("lfemur", "rtibia", "lhumerus"):
        place = BODY_NAMES.index(bone)
        apart = np.swapaxes(turns[:, place], 1, 2) @ truth[:, place]
        assert np.degrees(Rotation.from_matrix(apart).magnitude()).max() < 15.0


def test_a_reference_pose_at_the_head_is_dropped(tmp_path, walk):
    motion = walk.resampled(60.0)
    write_bvh(tmp_path / "x.bvh", motion, "Mixamo")
    head, _, table = (tmp_path / "x.bvh").read_text().partition("Frame Time: 0.01666667\n")
    rows = table.strip().split("\n")
    first = " ".join([*rows[0].split()[:3], *["0.0"] * (len(rows[0].split()) - 3)])
    head = head.replace(f"Frames: {len(motion)}", f"Frames: {len(motion) + 1}")
    (tmp_path / "x.bvh").write_text(f"{head}Frame Time: 0.01666667\n" + "\n".join([first, *rows]))
    read = read_one(tmp_path / "x.bvh")
    assert len(read) == len(motion)
    assert "dropped a reference pose at the head, 1 frames" in " ".join(read.provenance.notes)


def test_the_solver_places_bones_as_all_others_do(walk):
    motion = make_motion(3, count=4, frames="random")
    points, turns = joint_points(motion.subject, motion.qpos)
    _, ends = body_points(motion.qpos, motion.subject)
    np.testing.assert_allclose(points, ends, atol=1e-12)
    expected = Rotation.from_matrix(body_turns(motion.qpos, motion.subject).reshape(-1, 3, 3))
    assert turn_distance(turns.reshape(-1, 4), expected.as_quat(scalar_first=True)).max() < 1e-7


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), shift=st.integers(0, 11))
def test_random_skeletons_in_all_twelve_orders(tmp_path_factory, seed, shift):
    rng = np.random.default_rng(seed)
    count, joints = 4, 13
    parents = [-1, *(int(rng.integers(0, i)) for i in range(1, joints))]
    orders = [ORDERS[(shift + i) % 12] for i in range(joints)]
    offsets = rng.normal(0.0, 20.0, (joints, 3))
    turns = Rotation.random(count * joints, rng=rng).as_matrix().reshape(count, joints, 3, 3)
    turns[0] = np.eye(3)  # where the orders with one axis twice are at their worst
    root = rng.normal(0.0, 100.0, (count, 3))
    names, columns, path = [], [root], tmp_path_factory.mktemp("orders") / "x.bvh"

    def lines(joint):
        names.append(joint)
        columns.append(euler(turns[:, joint], orders[joint]))
        words = " ".join(f"{axis.upper()}rotation" for axis in orders[joint])
        count = "CHANNELS 3"
        if joint == 0:
            count = "CHANNELS 6 Xposition Yposition Zposition"
        place = " ".join(map(repr, offsets[joint].tolist()))
        kind = "JOINT" if joint else "ROOT"
        out = [f"{kind} j{joint}", "{", f"OFFSET {place}", f"{count} {words}"]
        for child in range(joints):
            out += lines(child) if parents[child] == joint else []
        return [*out, "}"]

    text = ["HIERARCHY", *lines(0), "MOTION", f"Frames: {count}", "Frame Time: 0.01"]
    text += [" ".join(map(repr, row)) for row in np.hstack(columns).tolist()]
    path.write_text("\n".join(text))
    file = read_bvh_file(path)
    tree = skeleton_tree(file)
    read = joint_motion(file, tree, list(range(joints)))
    assert read.rotations is not None
    world, places = np.empty_like(turns), np.empty((count, joints, 3))
    for joint, parent in enumerate(parents):
        if parent < 0:
            world[:, joint], places[:, joint] = turns[:, joint], root
        else:
            world[:, joint] = world[:, parent] @ turns[:, joint]
            places[:, joint] = places[:, parent] + world[:, parent] @ offsets[joint]
    np.testing.assert_allclose(read.rotations, world[:, names], atol=1e-9)
    np.testing.assert_allclose(read.positions, places[:, names], atol=1e-7)


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), shift=st.integers(0, 11))
def test_random_people_come_back_in_all_twelve_orders(tmp_path_factory, seed, shift):
    """AMC to BVH in any orders and back to AMC: 1 mm and 0.1 deg, with room to spare."""
    folder = tmp_path_factory.mktemp("trip")
    motion = make_motion(seed, count=4)
    write_motion(motion, folder / "a.amc")
    (canonical,) = read_motion(folder / "a.amc")
    write_motion(canonical, folder / "b.bvh")
    head, _, table = (folder / "b.bvh").read_text().partition("Frame Time:")
    time, *rows = table.strip().split("\n")
    values = np.array([list(map(float, row.split())) for row in rows])
    angles = values[:, 3:].reshape(len(values), -1, 3)
    parts = re.split("Zrotation Yrotation Xrotation", head)
    text = parts[0]
    for joint, part in enumerate(parts[1:]):
        order = ORDERS[(shift + joint) % 12]
        turns = Rotation.from_euler("ZYX", angles[:, joint], degrees=True).as_matrix()
        values[:, 3 + 3 * joint : 6 + 3 * joint] = euler(turns, order)
        text += " ".join(f"{axis.upper()}rotation" for axis in order) + part
    rows = [" ".join(f"{v:.6f}" for v in row) for row in values]
    (folder / "c.bvh").write_text("\n".join([f"{text}Frame Time: {time}", *rows, ""]))
    (again,) = read_motion(folder / "c.bvh")
    write_motion(again, folder / "d.amc")
    (back,) = read_motion(folder / "d.amc")
    ours, theirs = (np.stack(body_points(m.qpos, m.subject)) for m in (back, motion))
    assert np.abs(ours - theirs).max() < 1e-5
    turns, truth = (body_turns(m.qpos, m.subject) for m in (back, motion))
    apart = (np.swapaxes(turns, -1, -2) @ truth).reshape(-1, 3, 3)
    assert np.degrees(Rotation.from_matrix(apart).magnitude()).max() < 1e-3


def test_real_martial_arts_are_retargeted_to_the_millimetre(motions_dir):
    read = read_one(motions_dir / "cmu-bvh/martial/06.bvh")
    assert read.provenance.joint_error < 2e-3
    assert max(error for _, error in read.provenance.joint_errors) < 0.02
    # The same recording by another way: thighs and upper arms turn alike within a few degrees.
    truth = read_one(motions_dir / "cmu/subjects/135/135_06.amc")
    ours, theirs = read.angles, truth.angles[len(truth) - len(read) :]
    apart = np.degrees(np.median(np.abs(np.angle(np.exp(1j * (ours - theirs)))), axis=0))
    for name in ("lfemurrx", "rfemurrz", "ltibiarx", "lhumerusrz", "rhumerusry", "thoraxry"):
        assert apart[DOF_NAMES.index(name)] < 10.0, name


def test_shape_and_names_agree_on_real_figures(motions_dir):
    for name in ("martial/06", "walking/walking_1"):
        tree = skeleton_tree(read_bvh_file(motions_dir / f"cmu-bvh/{name}.bvh"))
        told, named = find_shape(tree), None
        for known in known_maps():
            named = known.find(tree)[0] or named
        assert told is not None
        assert named is not None
        for bone in ("root", "lfemur", "rtibia", "lfoot", "lhumerus", "rradius", "thorax"):
            assert told.starts[bone] == named.starts[bone], bone
