"""Copies of a recording are found whatever was done to them; other motion is not."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BONE_NAMES, BONES, DOF_BONES
from localreg.body.subject import canonical_subject
from localreg.database import PoseDatabase
from localreg.database.clips import merged_groups
from localreg.database.duplicates import fingerprints, mirrored_fingerprints
from localreg.motion.motion import Motion, Provenance
from localreg.motion.sources import read_sources
from tests.localreg.database.made_motion import make_motion


def named(motion: Motion, name: str) -> Motion:
    return replace(motion, provenance=Provenance(name))


def resampled_elsewhere(motion: Motion) -> Motion:
    return motion.resampled(33.0)


def trimmed(motion: Motion) -> Motion:
    """Begins between two frames of the original's 40 Hz grid."""
    return replace(motion, qpos=motion.qpos[61:-50])


def trimmed_to_half_a_second(motion: Motion) -> Motion:
    return replace(motion, qpos=motion.qpos[100:163])


def mirrored(motion: Motion) -> Motion:
    return motion.mirrored()


def noisy(motion: Motion) -> Motion:
    qpos = motion.qpos.copy()
    qpos[:, 7:] += np.radians(0.2) * np.random.default_rng(0).normal(size=(len(qpos), 56))
    return replace(motion, qpos=qpos)


def without_some_bones(motion: Motion) -> Motion:
    qpos = motion.qpos.copy()
    lost = [i for i, bone in enumerate(DOF_BONES) if bone[1:] in ("thumb", "fingers", "toes")]
    qpos[:, [7 + i for i in lost]] = 0.0
    return replace(motion, qpos=qpos)


def elsewhere(motion: Motion) -> Motion:
    """Other heading and place."""
    qpos = motion.qpos.copy()
    turn = Rotation.from_euler("z", 70, degrees=True)
    qpos[:, :3] = turn.apply(qpos[:, :3]) + np.array([3.0, 4.0, 0.1])
    root = Rotation.from_quat(qpos[:, 3:7], scalar_first=True)
    qpos[:, 3:7] = (turn * root).as_quat(scalar_first=True)
    return replace(motion, qpos=qpos)


def in_other_axes(motion: Motion) -> Motion:
    """The same rotations of the thighs, told in a skeleton of other axis frames."""
    frames = motion.subject.axis_frames.copy()
    qpos = motion.qpos.copy()
    for bone in ("lfemur", "rfemur"):
        b, d = BONE_NAMES.index(bone), 7 + DOF_BONES.index(bone)
        old, new = frames[b], frames[b] @ Rotation.from_euler("z", 15, degrees=True).as_matrix()
        local = Rotation.from_euler("ZYX", qpos[:, d : d + 3]).as_matrix()
        told = new.T @ old @ local @ old.T @ new
        qpos[:, d : d + 3] = Rotation.from_matrix(told).as_euler("ZYX")
        frames[b] = new
    return replace(motion, qpos=qpos, subject=replace(motion.subject, axis_frames=frames))


CHANGES = [
    resampled_elsewhere, trimmed, trimmed_to_half_a_second, mirrored, noisy,
    without_some_bones, elsewhere, in_other_axes,
]  # fmt: skip


@pytest.mark.parametrize("change", CHANGES)
def test_changed_copies_are_found(change: Callable[[Motion], Motion]) -> None:
    others = [make_motion(i, 480) for i in range(2, 8)]
    original = make_motion(1, 480, trial="01_01")
    copy = named(change(original), "copy")
    database = PoseDatabase.build([*others[:3], original, *others[3:], copy])
    group = {c.group for c in database.clips if c.name.startswith(("copy", "made-1"))}
    assert len(group) == 1
    assert len({clip.group for clip in database.clips}) == 7
    mask = database.exclude(clip="copy")
    gone = {database.clips[i].name for i in np.unique(database.clip_index[~mask])}
    images = {name + "-mirrored" for name in ("made-1", "copy")}
    assert gone - images == {"made-1", "copy"}

    without_copy = PoseDatabase.build([*others, original])
    mask = without_copy.exclude_motion(copy)
    gone = {without_copy.clips[i].name for i in np.unique(without_copy.clip_index[~mask])}
    assert gone == {"made-1", "made-1-mirrored"}


def test_one_recording_in_two_parts_and_one_whole() -> None:
    whole = make_motion(1, 600)
    parts = [
        named(replace(whole, qpos=whole.qpos[:200]), "begin"),
        named(replace(whole, qpos=whole.qpos[400:]), "end"),
    ]
    database = PoseDatabase.build([*parts, make_motion(2, 600), whole])
    assert not database.exclude(clip="begin")[database.clip_index == 2].any()
    assert len({clip.group for clip in database.clips}) == 2


def test_the_same_trial_is_one_recording_whatever_it_looks_like() -> None:
    motions = [
        make_motion(1, name="a", trial="07_01"),
        make_motion(2, name="b", trial="07_01"),
        make_motion(3, name="c", trial=""),
        make_motion(4, name="d", trial=""),
    ]
    database = PoseDatabase.build(motions, mirror=False)
    assert [clip.group for clip in database.clips] == [0, 0, 1, 2]
    stranger = make_motion(9, name="e", trial="07_01")
    np.testing.assert_array_equal(database.exclude_motion(stranger), database.clip_index > 1)
    assert database.exclude_motion(make_motion(9, name="e")).all()


def test_short_and_still_copies_are_found_when_exact() -> None:
    short = make_motion(1, 12, name="short")
    still = make_motion(2, 300, name="still", amplitude=0.0)
    motions = [short, named(short, "short-2"), still, named(still, "still-2"), make_motion(3)]
    groups = [c.group for c in PoseDatabase.build(motions, mirror=False).clips]
    assert groups == [0, 0, 1, 1, 2]


def test_standing_alike_is_no_copy() -> None:
    still = make_motion(1, 300, amplitude=0.0)
    breathing = replace(still, qpos=still.qpos.copy(), provenance=Provenance("breathing"))
    breathing.qpos[:, 7:] += np.radians(0.3) * np.sin(np.arange(300) / 40)[:, None]
    database = PoseDatabase.build([still, breathing], mirror=False)
    assert [c.group for c in database.clips] == [0, 1]
    assert database.exclude_motion(named(breathing.resampled(60.0), "again")).all()


def test_a_motion_shorter_than_any_window_is_only_told_by_name() -> None:
    database = PoseDatabase.build([make_motion(1, trial="01_01")])
    assert database.exclude_motion(make_motion(1, 3, name="?")).all()
    assert not database.exclude_motion(make_motion(1, 3, trial="01_01")).any()


def test_loaded_databases_find_copies_too(tmp_path: Path) -> None:
    PoseDatabase.build([make_motion(1), make_motion(2)]).save(tmp_path / "db")
    database = PoseDatabase.load(tmp_path / "db")
    mask = database.exclude_motion(named(make_motion(2).resampled(50.0), "again"))
    np.testing.assert_array_equal(mask, database.clip_index < 2)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000))
def test_fingerprints_mirror_as_motion_does(seed: int) -> None:
    motion = make_motion(seed, 5)
    image = motion.mirrored()
    np.testing.assert_allclose(
        mirrored_fingerprints(fingerprints(motion.angles, motion.subject.axis_frames)),
        fingerprints(image.angles, image.subject.axis_frames),
        atol=1e-6,
    )


def test_fingerprints_are_the_rotations_of_the_bones() -> None:
    motion = make_motion(5, 4)
    frames = canonical_subject().axis_frames
    got = fingerprints(motion.angles, frames).reshape(4, 9, 4)
    for column, bone in ((1, "lfemur"), (8, "rradius")):
        b, d = BONE_NAMES.index(bone), DOF_BONES.index(bone)
        n = len(BONES[b].dofs)
        euler = np.zeros((4, 3))
        euler[:, 3 - n :] = motion.angles[:, d : d + n]
        local = Rotation.from_euler("ZYX", euler).as_matrix()
        want = Rotation.from_matrix(frames[b] @ local @ frames[b].T)
        have = Rotation.from_quat(got[:, column], scalar_first=True)
        assert (want.inv() * have).magnitude().max() < 1e-6


def test_merged_groups() -> None:
    assert merged_groups([0, 0, 1, 2, 2, 3], [(1, 3), (5, 5)]) == [0, 0, 1, 0, 0, 2]
    assert merged_groups([], []) == []


def test_walks_of_one_person_are_not_copies() -> None:
    """36 walks of four people, most of them of one, all different recordings."""
    motions, _ = read_sources(["sample"])
    database = PoseDatabase.build(motions)
    read = [clip for clip in database.clips if clip.image_of < 0]
    assert len(read) >= 36
    assert len({clip.group for clip in read}) == len({clip.trial for clip in read})
    test = named(motions[0].resampled(60.0), "seen before")
    mask = database.exclude_motion(test)
    gone = {database.clips[i].trial for i in np.unique(database.clip_index[~mask])}
    assert gone == {motions[0].provenance.trial}


def test_the_archives_own_copy_is_found(motions_dir: Path) -> None:
    """One walk of subject 02 is in the archive as AMC and as BVH under another name."""
    walks = motions_dir / "cmu-bvh" / "walking"
    motions, _ = read_sources([walks, motions_dir / "cmu" / "subjects" / "02"])
    nameless = [replace(m, provenance=replace(m.provenance, trial="", subject="")) for m in motions]
    database = PoseDatabase.build(nameless, mirror=False)
    group = {c.name: c.group for c in database.clips}
    assert group["walking_1"] == group["02_01"]
    assert len(set(group.values())) == len(group) - 1
