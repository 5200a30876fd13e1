"""`localreg convert`, on files."""

import re

import numpy as np
import pybvh
import pytest
from typer.testing import CliRunner

from localreg.cli import app
from localreg.motion.formats import read_motion, writable_suffixes, write_motion
from tests.localreg.motion.strategies import make_calm_motion

run = CliRunner().invoke


@pytest.fixture
def take(tmp_path):
    path = tmp_path / "take.bvh"
    write_motion(make_calm_motion(0, count=121, rate=120.0), path)
    return path


def convert(*arguments):
    return run(app, ["convert", *map(str, arguments)])


@pytest.mark.parametrize("suffix", writable_suffixes())
def test_any_kind_comes_out(take, tmp_path, suffix):
    out = tmp_path / f"out{suffix}"
    result = convert(take, out)
    assert result.exit_code == 0, result.output
    assert f"{out}: 121 frames at 120 Hz of take" in result.stdout
    assert out.is_file()


def test_amc_and_bvh_come_back(take, tmp_path):
    result = convert(take, tmp_path / "a.amc")
    assert result.exit_code == 0
    assert "--source-rate" not in result.stdout
    result = convert(take, tmp_path / "slow.amc", "--rate", "40")
    assert "read it with --source-rate 40" in result.stdout
    assert convert(tmp_path / "a.amc", tmp_path / "b.bvh").exit_code == 0
    (first,), (last,) = read_motion(take), read_motion(tmp_path / "b.bvh")
    np.testing.assert_allclose(last.qpos, first.qpos, atol=1e-6)


def test_a_take_is_cleaned_on_the_way(take, tmp_path):
    out = tmp_path / "out.bvh"
    result = convert(
        take, out, "--names", "mixamo", "--from", "0.25", "--to", "0.75", "--rate", "60",
        "--smooth", "12", "--fill-gaps", "--lock-feet",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    for words in ("31 frames at 60 Hz", "0 frames of jumps", "smoothed at 12 Hz", "feet held in"):
        assert words in result.stdout
    file = pybvh.read_bvh_file(out)
    assert file.frame_count == 31
    assert "mixamorig:LeftUpLeg" in file.joint_names


def test_a_folder_of_clips_goes_to_a_folder(take, tmp_path):
    folder = tmp_path / "in" / "sub"
    folder.mkdir(parents=True)
    for name in ("in/a.bvh", "in/sub/a.bvh", "in/b.bvh"):
        (tmp_path / name).write_bytes(take.read_bytes())
    (tmp_path / "in" / "broken.bvh").write_text("no")
    out = tmp_path / "out"
    result = convert(tmp_path / "in", out, "--as", "csv")
    assert result.exit_code == 0, result.output
    assert len(list(out.glob("*.csv"))) == 3
    assert "skipped" in result.stdout
    one = convert(tmp_path / "in", tmp_path / "b.glb", "--clip", "b")
    assert one.exit_code == 0, one.output
    assert (tmp_path / "b.glb").is_file()


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("take.bvh", "x.fbx"), 2, "endings are .amc"),
        (("take.bvh", "x"), 2, "--as ENDING"),
        (("take.bvh", "x", "--as", "doc"), 2, "endings are"),
        (("take.bvh", "x.bvh", "--rate", "-1"), 2, "no frequency"),
        (("take.bvh", "x.bvh", "--smooth", "70"), 1, "cutoff of 70 Hz"),
        (("take.bvh", "x.bvh", "--from", "9"), 1, "it lasts 1 s"),
        (("take.bvh", "x.csv", "--names", "vrm"), 1, "names of their own"),
        (("take.bvh", "x.bvh", "--clip", "other"), 1, "it has take"),
        ((".", "x.bvh"), 1, "write all by --as bvh"),
        (("nowhere.bvh", "x.bvh"), 1, "no file or folder"),
        (("take.bvh", "no/where/x.bvh"), 1, "cannot write"),
    ],
)
def test_what_cannot_be_done_is_said(take, tmp_path, monkeypatch, arguments, code, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "second.bvh").write_bytes(take.read_bytes())
    result = convert(*arguments)
    assert result.exit_code == code, result.output
    assert message in re.sub(r"[\s│]+", " ", result.output)
    assert not list(tmp_path.glob("x*"))
