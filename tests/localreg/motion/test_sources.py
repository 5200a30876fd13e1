"""Sources: what is found, under which names, by which rules, and what is left out and why."""

import shutil

import numpy as np
import pytest

from localreg.body.skeleton import DOF_NAMES
from localreg.errors import MotionError
from localreg.motion.formats import write_motion
from localreg.motion.overrides import Overrides
from localreg.motion.sources import iterate_sources, read_sources
from tests.localreg.motion.strategies import make_calm_motion


@pytest.fixture
def folder(tmp_path):
    """Two people's AMC, BVH of two activities, and things that are no motions."""
    root = tmp_path / "set"
    for seed, name in enumerate(
        ["02/02_01.amc", "02/02_02.amc", "135/135_06.amc", "walking/a.bvh", "jumping/a.bvh"]
    ):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        write_motion(make_calm_motion(seed, count=6, rate=60.0), root / name)
    (root / "readme.txt").write_text("nothing to read")
    (root / "walking" / "notes.tsv").write_text("a\tb")
    return root


def overrides(tmp_path, text):
    path = tmp_path / "overrides.toml"
    path.write_text(text)
    return Overrides.load(path)


def test_a_folder_is_searched_in_a_fixed_order(folder):
    motions, report = read_sources([folder])
    names = ["02_01", "02_02", "135_06", "jumping/a.bvh", "walking/a.bvh"]
    assert [motion.provenance.name for motion in motions] == names
    assert [entry.name for entry in report.entries] == names
    assert [entry.subject for entry in report.entries] == ["02", "02", "135", "", ""]
    assert [entry.trial for entry in report.entries] == ["02_01", "02_02", "135_06", "a", "a"]
    assert [entry.activity for entry in report.entries] == ["", "", "", "jumping", "walking"]
    assert [entry.rate for entry in report.entries] == [120.0, 120.0, 120.0, 60.0, 60.0]
    assert [entry.rate_rule for entry in report.entries] == ["default 120 Hz"] * 3 + ["file"] * 2
    assert (report.frames, len(report.used), report.skipped) == (30, 5, [])
    assert report.seconds == pytest.approx(3 * 5 / 120 + 2 * 5 / 60)


def test_the_order_of_the_file_system_does_not_matter(folder, tmp_path):
    other = tmp_path / "other" / "set"
    for path in sorted(folder.rglob("*"), reverse=True):
        if path.is_file():
            (other / path.relative_to(folder)).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, other / path.relative_to(folder))
    ours, theirs = (read_sources([root])[0] for root in (folder, other))
    for a, b in zip(ours, theirs, strict=True):
        assert a.provenance.name == b.provenance.name
        np.testing.assert_array_equal(a.qpos, b.qpos)


def test_a_source_rate_holds_for_files_without_one(folder):
    _, report = read_sources([folder], source_rate=30.0)
    assert [entry.rate for entry in report.entries] == [30.0, 30.0, 30.0, 60.0, 60.0]
    assert [entry.rate_rule for entry in report.entries] == ["source rate"] * 3 + ["file"] * 2


def test_what_occurs_twice_is_read_once(folder):
    file = folder / "02" / "02_01.amc"
    motions, _ = read_sources([folder, file, str(file), folder / "02"])
    assert len(motions) == 5


def test_copies_of_one_trial_get_names_of_their_own_and_one_trial(folder, tmp_path):
    copy = tmp_path / "copy" / "CMU_002_01.bvh"
    copy.parent.mkdir()
    write_motion(make_calm_motion(0, count=3), copy)
    motions, _ = read_sources([folder, copy])
    same = [m.provenance for m in motions if m.provenance.trial == "02_01"]
    assert [p.name for p in same] == ["02/02_01.amc", "CMU_002_01.bvh"]
    assert len({m.provenance.name for m in motions}) == len(motions)


def test_equal_relative_paths_still_get_names_of_their_own(tmp_path):
    for root in ("a", "b", "c"):
        (tmp_path / root).mkdir()
        write_motion(make_calm_motion(0, count=3), tmp_path / root / "x.bvh")
    motions, _ = read_sources([tmp_path / "a", tmp_path / "b", tmp_path / "c"])
    assert len({m.provenance.name for m in motions}) == 3


def test_the_sample_set_and_files_together(folder):
    motions, report = read_sources(["sample", folder / "02"])
    assert len(motions) == 38
    assert len({m.provenance.name for m in motions}) == 38
    assert report.entries[0].rate_rule == "file"
    assert report.entries[0].activity == "walk"


def test_a_bad_file_in_a_folder_is_left_out_with_its_reason(folder):
    bad = folder / "walking" / "b.bvh"
    bad.write_text("HIERARCHY\nROOT pelvis\n{\n}\n")
    motions, report = read_sources([folder])
    assert len(motions) == 5
    (entry,) = report.skipped
    assert (entry.source, entry.name, entry.frames) == (str(bad), "", 0)
    assert "line 4" in entry.skipped


def test_a_bad_file_asked_for_by_name_is_an_error(folder):
    bad = folder / "walking" / "b.bvh"
    bad.write_text("HIERARCHY\n")
    with pytest.raises(MotionError, match=r"b\.bvh, line 1"):
        read_sources([bad])
    with pytest.raises(MotionError, match=r"b\.bvh, line 1"):
        read_sources([folder, bad])


def test_an_unknown_kind_asked_for_by_name_is_an_error(folder):
    with pytest.raises(MotionError, match="not known"):
        read_sources([folder / "readme.txt"])


def test_sources_without_motions_are_errors(folder, tmp_path):
    with pytest.raises(MotionError, match="no file or folder"):
        read_sources([tmp_path / "nowhere"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(MotionError, match=r"no usable motion in .*empty"):
        read_sources([tmp_path / "empty"])
    with pytest.raises(MotionError, match="no usable motion in no source at all"):
        read_sources([])
    only_bad = tmp_path / "bad"
    only_bad.mkdir()
    (only_bad / "x.bvh").write_text("")
    with pytest.raises(MotionError, match=r"x\.bvh, line 1"):
        read_sources([only_bad])


def test_progress_tells_every_file_and_the_end(folder):
    told = []
    read_sources(["sample", folder], progress=lambda *what: told.append(what))
    assert [done for done, _, _ in told] == list(range(7))
    assert {total for _, total, _ in told} == {6}
    assert told[0][2] == "sample"
    assert told[-1][2] == ""


def test_motions_come_one_at_a_time(folder):
    stream = iterate_sources([folder])
    motion, entry = next(stream)
    assert motion is not None
    assert entry.name == motion.provenance.name == "02_01"
    stream.close()


def test_overrides_lay_down_what_files_do_not_say(folder, tmp_path):
    rules = overrides(
        tmp_path,
        """
        version = 1
        [[file]]
        match = "*.amc"
        rate = 60
        [[file]]
        match = "135/*.amc"
        rate = 90
        drop_first = 2
        drop_last = 1
        ignore_dofs = ["lfingers*", "headrx"]
        activity = "kata"
        subject = "CMU_007"
        trial = "7_3"
        [[file]]
        match = "jumping/*"
        skip = "broken legs"
        [[file]]
        match = "walking/a.bvh"
        unit = "m"
        """,
    )
    before, _ = read_sources([folder])
    motions, report = read_sources([folder], overrides=rules)
    assert [m.rate for m in motions] == [60.0, 60.0, 90.0, 60.0]
    kata = motions[2]
    assert len(kata) == 3
    ignored = [DOF_NAMES.index("lfingersrx"), DOF_NAMES.index("headrx")]
    assert not kata.angles[:, ignored].any()
    kept = np.setdiff1d(np.arange(56), ignored)
    np.testing.assert_array_equal(kata.angles[:, kept], before[2].angles[2:5][:, kept])
    entry = report.entries[2]
    assert (entry.subject, entry.trial, entry.activity) == ("07", "07_03", "kata")
    assert entry.rate_rule == "override"
    assert entry.notes == (
        "override: dropped 2 frames at the head, 1 at the tail",
        "override: 2 joint angles set to zero",
    )
    assert report.entries[3].skipped == "override: broken legs"
    np.testing.assert_allclose(motions[3].subject.lengths, 100 * before[4].subject.lengths)


def test_dropping_every_frame_is_a_fault_of_the_file(folder, tmp_path):
    rules = overrides(tmp_path, "[[file]]\nmatch = '02_01.amc'\ndrop_first = 6\n")
    _, report = read_sources([folder], overrides=rules)
    assert "drop all of its 6 frames" in report.skipped[0].skipped


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[file]\n", "not a TOML file"),
        ("version = 2\n", "version"),
        ("[[file]]\nrate = 60\n", r"file\.0\.match"),
        ("[[file]]\nmatch = 'a'\nrate = -1\n", r"file\.0\.rate"),
        ("[[file]]\nmatch = 'a'\nunit = 'foot'\n", r"file\.0\.unit"),
        ("[[file]]\nmatch = 'a'\nspeed = 1\n", r"file\.0\.speed"),
        ("[[file]]\nmatch = 'a'\ndrop_first = -1\n", r"file\.0\.drop_first"),
        ("[[file]]\nmatch = 'a'\nignore_dofs = ['tail*']\n", "matches no joint angle"),
    ],
)
def test_faulty_overrides_name_the_entry(tmp_path, text, message):
    with pytest.raises(MotionError, match=message):
        overrides(tmp_path, text)


def test_missing_overrides_are_an_error(tmp_path):
    with pytest.raises(MotionError, match="cannot read overrides file"):
        Overrides.load(tmp_path / "none.toml")


def test_the_real_set_as_a_whole(motions_dir):
    _, report = read_sources(
        [motions_dir / "cmu" / "subjects" / "02", motions_dir / "cmu" / "inferred"]
    )
    assert len(report.used) == 15
    entries = {entry.name: entry for entry in report.entries}
    assert entries["02_01"].activity == "walk"
    assert entries["02_07"].activity == "swordplay"
    assert entries["backflip"].subject == "u_acrobat88"
    assert entries["backflip"].activity == ""
