"""Commands on a folder of foreign files: the database's table, and an evaluation."""

import json

import pytest
from typer.testing import CliRunner

from localreg.cli import app
from localreg.motion.formats import read_motion, write_motion
from tests.localreg.motion.foreign_files import write_bvh
from tests.localreg.motion.strategies import make_calm_motion


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two families, one AMC with its skeleton, a broken file, and things that are no motions."""
    folder = tmp_path_factory.mktemp("set")
    motion = make_calm_motion(2, count=30, rate=40.0)
    write_motion(motion, folder / "own.amc")
    write_bvh(folder / "cloud.bvh", motion.first(28), "Mixamo")
    write_bvh(folder / "lab.bvh", motion.first(26), "Rokoko")
    (folder / "broken.bvh").write_text("HIERARCHY\nROOT a\n")
    (folder / "readme.md").write_text("about")
    (folder / "spare.asf").write_text((folder / "own.asf").read_text())
    return folder


def run(*words):
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exit_code == 0, result.output
    return result.output


def test_the_table_of_a_database_is_true(folder, tmp_path):
    output = run("db", "build", folder, "--out", tmp_path / "db", "--jobs", "1", "--source-rate",
                 "40", "--json", tmp_path / "table.json")  # fmt: skip
    table = json.loads((tmp_path / "table.json").read_text())
    used = {e["name"]: e for e in table["entries"] if not e["skipped"]}
    assert {name: (e["frames"], e["rate"], e["skeleton"]) for name, e in used.items()} == {
        "own": (30, 40.0, ""), "cloud": (28, 40.0, "Mixamo"), "lab": (26, 40.0, "Rokoko"),
    }  # fmt: skip
    for name in ("cloud", "lab"):
        (motion,) = read_motion(folder / f"{name}.bvh")
        assert used[name]["joint_errors"] == pytest.approx(dict(motion.provenance.joint_errors))
        assert used[name]["joint_error"] < 0.02
    assert used["own"]["joint_error"] is None
    (skipped,) = [e for e in table["entries"] if e["skipped"]]
    assert skipped["source"].endswith("broken.bvh")
    assert "ends inside the hierarchy" in skipped["skipped"]
    assert sorted(other["why"] for other in table["others"]) == [
        ".md: not a motion file",
        "a skeleton that no motion uses",
        "read with the motions of theirs",
    ]
    assert "3 clips used, 1 files skipped; joints of foreign files lie at most" in output
    assert "centimetres" in output


def test_an_evaluation_on_foreign_files(folder, tmp_path):
    run("db", "build", folder / "own.amc", "--out", tmp_path / "db", "--jobs", "1")
    run("evaluate", folder / "cloud.bvh", folder / "lab.bvh", "--database", tmp_path / "db",
        "--methods", "ik", "--signals", "both", "--max-frames", "12", "--jobs", "1",
        "--json", tmp_path / "x.json")  # fmt: skip
    clips = json.loads((tmp_path / "x.json").read_text())["clips"]
    assert {(clip["name"], clip["frames"]) for clip in clips} == {("cloud", 12), ("lab", 12)}
    assert all(0.0 < clip["mpjpe_cm"] < 50.0 for clip in clips)
