"""The commands at work, on real walks, from the shell and in this process."""

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from localreg.cli import app
from localreg.commands import doctor
from localreg.database import PoseDatabase
from localreg.evaluation import worker
from localreg.motion.formats import read_motion, write_motion
from localreg.motion.formats.sample import read_sample
from localreg.synthesis import methods
from tests.localreg.evaluation.standing import Builder

run = CliRunner().invoke


@pytest.fixture(scope="session")
def walks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two real walks, cut short, as files."""
    pytest.importorskip("envpool_assets")
    folder = tmp_path_factory.mktemp("walks")
    for motion in read_sample()[:2]:
        short = replace(motion, qpos=motion.qpos[:60])
        write_motion(short, folder / f"{motion.provenance.name}.bvh")
    return folder


@pytest.fixture(scope="session")
def database(walks: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("databases") / "walks.db"
    result = run(app, ["db", "build", str(walks), "--out", str(folder)])
    assert result.exit_code == 0, result.output
    assert re.search(r"walks\.db: 4 clips, \d+ poses at 40 Hz", result.stdout)
    assert "16_22" in result.stdout
    return folder


@pytest.fixture
def builder(monkeypatch: pytest.MonkeyPatch) -> Builder:
    builder = Builder()
    monkeypatch.setattr(worker, "build_estimator", builder)
    monkeypatch.setattr(methods, "build_estimator", builder)
    return builder


def test_data_sample_lists_the_clips() -> None:
    pytest.importorskip("envpool_assets")
    result = run(app, ["data", "sample"])
    assert result.exit_code == 0
    assert "16_22" in result.stdout
    assert "36 clips of 4 people, 4409 frames, 131 s" in result.stdout


def test_db_build_says_what_was_skipped(walks: Path, tmp_path: Path) -> None:
    folder = tmp_path / "motions"
    folder.mkdir()
    (folder / "good.bvh").write_bytes((walks / "16_22.bvh").read_bytes())
    (folder / "bad.bvh").write_text("HIERARCHY\nnonsense\n")
    overrides = tmp_path / "rules.toml"
    overrides.write_text('[[file]]\nmatch = "good.bvh"\nrate = 60\nactivity = "stroll"\n')
    out = tmp_path / "db"
    result = run(
        app,
        ["db", "build", str(folder), "--out", str(out), "--rate", "30", "--no-mirror",
         "--overrides", str(overrides)],
        env={"COLUMNS": "400"},
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    about = next(line for line in result.stdout.splitlines() if "bad.bvh" in line)
    assert "skipped" in about
    assert "nonsense" in about
    assert "override" in result.stdout
    built = PoseDatabase.load(out)
    assert (built.rate, len(built.clips), len(built)) == (30.0, 1, 30)
    assert built.clips[0].activity == "stroll"


def test_db_info_verifies(database: Path, tmp_path: Path) -> None:
    result = run(app, ["db", "info", str(database)])
    assert result.exit_code == 0
    assert "16_23-mirrored" in result.stdout
    assert "all checksums match" in result.stdout
    copy = tmp_path / "copy"
    PoseDatabase.load(database).save(copy)
    damaged = bytearray((copy / "angles.npy").read_bytes())
    damaged[-1] ^= 1
    (copy / "angles.npy").write_bytes(damaged)
    result = run(app, ["db", "info", str(copy)])
    assert result.exit_code == 1
    assert "damaged" in result.stderr


def test_doctor_reports_and_never_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    result = run(app, ["doctor"])
    assert result.exit_code == 0, result.output
    for topic in ("Python", "versions", "pictures", "processors"):
        assert topic in result.stdout

    def broken() -> None:
        raise RuntimeError("no such organ")

    monkeypatch.setattr(doctor, "_graphics", broken)
    monkeypatch.setattr(doctor.os, "access", lambda path, mode: False)
    result = run(app, ["doctor"])
    assert result.exit_code == 0
    assert "no such organ" in result.stdout
    assert "to mend" in result.stdout


def test_evaluate_prints_tables_and_writes_json(
    walks: Path, builder: Builder, tmp_path: Path
) -> None:
    out = tmp_path / "figures.json"
    result = run(
        app,
        ["evaluate", str(walks), "--methods", "ik,paper", "--signals", "both,position",
         "--jobs", "1", "--json", str(out), "--verbose", "--seed", "7", "--start", "truth"],
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    titles = "Means over 2 clips", "Worst clips", "frames/s", "Clips", "Activities", "(truth)"
    for title in (*titles, "[deg]"):
        assert title in result.stdout
    assert "paper, both: joint angles worse than ik's on 0 of 2 clips" in result.stdout
    document = json.loads(out.read_text())
    assert document["settings"]["seed"] == 7
    assert document["settings"]["start"] == "truth"
    assert len(document["clips"]) == 8
    assert not list(tmp_path.glob(".*")), "nothing is left beside the file"


def test_evaluate_writes_nothing_but_json_to_the_output(
    walks: Path, database: Path, builder: Builder
) -> None:
    result = run(
        app,
        ["evaluate", str(walks), "--methods", "ik", "--signals", "both", "--jobs", "1",
         "--database", str(database), "--max-frames", "10", "--json", "-"],
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert document["settings"]["database"] == str(database)
    assert [clip["frames"] for clip in document["clips"]] == [10, 10]


def test_synthesize_writes_a_motion_and_warns_of_copies(
    walks: Path, database: Path, builder: Builder, tmp_path: Path
) -> None:
    out = tmp_path / "out.bvh"
    args = ["synthesize", str(walks / "16_22.bvh"), "--database", str(database), "--out", str(out)]
    result = run(app, args)
    assert result.exit_code == 0, result.output
    assert "holds a copy of this motion" in result.stderr
    (motion,) = read_motion(out)
    assert motion.rate == pytest.approx(40.0)
    assert str(len(motion)) in result.stdout
    np.testing.assert_allclose(motion.angles, 0.0, atol=1e-4)
    result = run(app, [args[0], str(walks), *args[2:]])
    assert result.exit_code == 1
    assert "holds 2 clips; name one by --clip 16_22" in result.stderr


def evaluate_in_shell(walks: Path, *options: str) -> dict:
    """The figures of real methods, by the command in a process of its own, timing apart."""
    done = subprocess.run(
        [sys.executable, "-m", "localreg", "evaluate", str(walks), "--signals", "both",
         "--max-frames", "14", "--json", "-", *options],
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document.pop("timing")
    return document


def test_real_methods_do_what_they_should_whatever_the_number_of_processes(walks: Path) -> None:
    one = evaluate_in_shell(walks, "--methods", "ik,localreg", "--jobs", "1")
    for method, worst in (("ik", 20.0), ("localreg", 6.0)):
        mean = one["mean"][method]["both"]
        assert 0.1 < mean["joint_angle_error_deg"] < worst
        assert 0.1 < mean["tracker_error_cm"] < 1.5
    two = evaluate_in_shell(walks, "--methods", "ik", "--jobs", "2")
    assert two["settings"] == one["settings"]
    assert two["clips"] == [clip for clip in one["clips"] if clip["method"] == "ik"]
    assert two["mean"]["ik"] == one["mean"]["ik"]
