"""Building a database, its windows, its masks, and what save and load give back."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from localreg.body.subject import canonical_subject
from localreg.database import PoseDatabase
from localreg.errors import DatabaseError
from localreg.motion.motion import MIRROR_DOFS, MIRROR_SIGNS
from tests.localreg.database.made_motion import make_motion


@pytest.fixture(scope="module")
def database() -> PoseDatabase:
    return PoseDatabase.build(
        [
            make_motion(1, name="a", subject="01", trial="01_01", activity="walk"),
            make_motion(2, name="b", subject="01", trial="01_02", activity="run"),
            make_motion(3, name="c", subject="02", trial="02_01", activity="walk"),
        ]
    )


def remaining(database: PoseDatabase, mask: np.ndarray) -> set[str]:
    names = set()
    for index, clip in enumerate(database.clips):
        kept = mask[database.clip_index == index]
        assert kept.all() or not kept.any()
        if kept.all():
            names.add(clip.name)
    return names


def test_poses_are_those_of_the_motions_at_the_rate(database: PoseDatabase) -> None:
    motion = make_motion(2).resampled(40.0)
    clip = next(c for c in database.clips if c.name == "b")
    assert clip.length == len(motion) == 80
    np.testing.assert_array_equal(
        database.angles[clip.start : clip.stop], motion.angles.astype(np.float32)
    )
    np.testing.assert_array_equal(
        database.roots[clip.start : clip.stop], motion.qpos[:, :7].astype(np.float32)
    )
    assert database.angles.dtype == np.float32
    assert database.clip_index.dtype == np.int32
    assert (clip.subject, clip.trial, clip.activity, clip.mirrored) == ("01", "01_02", "run", False)
    assert database.seconds == pytest.approx(len(database) / 40.0)


def test_every_clip_gets_its_mirror_image_once(database: PoseDatabase) -> None:
    names = [clip.name for clip in database.clips]
    assert names == ["a", "a-mirrored", "b", "b-mirrored", "c", "c-mirrored"]
    for index in range(0, 6, 2):
        clip, image = database.clips[index], database.clips[index + 1]
        assert image.image_of == index
        assert clip.image_of == -1
        assert image.mirrored
        assert image.group == clip.group
        np.testing.assert_allclose(
            database.angles[image.start : image.stop],
            database.angles[clip.start : clip.stop][:, MIRROR_DOFS] * MIRROR_SIGNS,
            atol=1e-6,
        )
    again = PoseDatabase.build([make_motion(1).mirrored()])
    assert [clip.name for clip in again.clips] == ["made-1-mirrored"]
    assert [c.name for c in PoseDatabase.build([make_motion(1)], mirror=False).clips] == ["made-1"]


@settings(max_examples=30, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 12), min_size=1, max_size=6),
    predecessors=st.integers(0, 5),
    mirror=st.booleans(),
)
def test_windows_never_cross_the_ends_of_a_clip(
    lengths: list[int], predecessors: int, mirror: bool
) -> None:
    motions = [make_motion(i, n, rate=40.0) for i, n in enumerate(lengths)]
    database = PoseDatabase.build(motions, mirror=mirror)
    targets = database.window_targets(predecessors)
    copies = 2 if mirror else 1
    assert len(targets) == copies * sum(max(n - predecessors, 0) for n in lengths)
    histories = database.histories(targets, predecessors)
    assert histories.shape == (len(targets), predecessors, 56)
    for target, history in zip(targets, histories, strict=True):
        clip = database.clips[database.clip_index[target]]
        position = target - clip.start
        assert predecessors <= position < clip.length
        own = database.angles[clip.start : clip.stop]
        np.testing.assert_array_equal(history, own[position - predecessors : position][::-1])


def test_long_databases_grow() -> None:
    motions = [make_motion(i, 3000, rate=40.0) for i in range(5)]
    database = PoseDatabase.build(iter(motions), mirror=False)
    assert len(database) == 15000
    for clip, motion in zip(database.clips, motions, strict=True):
        np.testing.assert_array_equal(
            database.angles[clip.start : clip.stop], motion.angles.astype(np.float32)
        )


def test_leaving_out_a_clip_a_person_or_an_activity(database: PoseDatabase) -> None:
    def left(**out: str) -> set[str]:
        return {name for name in remaining(database, database.exclude(**out)) if "-" not in name}

    assert left() == {"a", "b", "c"}
    assert left(clip="a") == {"b", "c"}
    assert left(clip="a-mirrored") == {"b", "c"}
    assert left(subject="01") == {"c"}
    assert left(activity="walk") == {"b"}
    assert left(clip="b", activity="walk") == set()
    mask = database.exclude(clip="a")
    assert mask.dtype == bool
    assert "a-mirrored" not in remaining(database, mask)


@pytest.mark.parametrize(
    ("out", "message"),
    [
        ({"clip": "aa"}, "no clip 'aa'"),
        ({"subject": "3"}, r"no subject '3'; it has 2: such as 01, 02"),
        ({"activity": "walking"}, "such as walk"),
    ],
)
def test_leaving_out_what_is_not_there(
    database: PoseDatabase, out: dict[str, str], message: str
) -> None:
    with pytest.raises(DatabaseError, match=message):
        database.exclude(**out)


def test_save_and_load_give_the_same(database: PoseDatabase, tmp_path) -> None:
    database.save(tmp_path / "db")
    for verify in (None, True, False):
        loaded = PoseDatabase.load(tmp_path / "db", verify=verify)
        assert isinstance(loaded.angles, np.memmap)
        assert not loaded.angles.flags.writeable
        for name in ("angles", "roots", "clip_index", "offsets", "axis_frames"):
            np.testing.assert_array_equal(getattr(loaded, name), getattr(database, name))
            assert getattr(loaded, name).dtype == getattr(database, name).dtype
        assert loaded.clips == database.clips
        assert (loaded.rate, loaded.settings) == (database.rate, database.settings)
        np.testing.assert_array_equal(loaded.exclude(clip="a"), database.exclude(clip="a"))


def test_saving_is_reproducible(database: PoseDatabase, tmp_path) -> None:
    database.save(tmp_path / "one")
    PoseDatabase.load(tmp_path / "one").save(tmp_path / "two")
    for file in (tmp_path / "one").iterdir():
        assert file.read_bytes() == (tmp_path / "two" / file.name).read_bytes()


def test_nothing_to_build_from() -> None:
    with pytest.raises(DatabaseError, match="no motion"):
        PoseDatabase.build([])
    with pytest.raises(DatabaseError, match="no motion"):
        PoseDatabase.build([make_motion(1).first(0)])
    with pytest.raises(DatabaseError, match="positive rate"):
        PoseDatabase.build([make_motion(1)], rate=0.0)


def test_an_empty_motion_is_named_not_hidden() -> None:
    database = PoseDatabase.build([make_motion(1).first(0), make_motion(2)])
    assert database.skipped == ("made-1",)
    assert [clip.name for clip in database.clips] == ["made-2", "made-2-mirrored"]


def test_skeletons_are_stored_once(database: PoseDatabase) -> None:
    canonical = canonical_subject()
    assert {clip.skeleton for clip in database.clips} == {0}
    np.testing.assert_allclose(database.offsets[0], canonical.offsets)
    np.testing.assert_allclose(database.axis_frames[0], canonical.axis_frames)
