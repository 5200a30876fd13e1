"""The commands as typed; one run in a real terminal, killed in pose five and resumed."""

import json
import os
import pty
import re
import select
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from calibration.knowledge import UNKNOWN_MOUNT, known_file, read_knowledge
from localreg.body.subject import canonical_subject, read_subject, write_subject
from localreg.cli import app

COMMAND = [sys.executable, "-m", "localreg", "calibrate"]
TIMEOUT = 240.0


class Terminal:
    """A child in a pseudo terminal, as a person sees it."""

    def __init__(self, arguments, folder):
        self.master, slave = pty.openpty()
        environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100", "LINES": "40"}
        self._child = subprocess.Popen(
            [*COMMAND, *arguments],
            cwd=folder,
            env=environment,
            stdin=slave,
            stdout=slave,
            stderr=slave,
            start_new_session=True,
        )
        os.close(slave)
        self.text = ""
        self._is_over = False

    def wait_for(self, pattern):
        """Read until something is seen."""
        give_up = time.monotonic() + TIMEOUT
        while not re.search(pattern, self.text):
            assert time.monotonic() < give_up, f"never saw {pattern!r} in:\n{self.text[-3000:]}"
            assert not self._is_over, f"ended before {pattern!r}:\n{self.text[-3000:]}"
            if select.select([self.master], [], [], 0.5)[0]:
                self._read()

    def press(self, key):
        os.write(self.master, key.encode())

    def _read(self):
        try:
            data = os.read(self.master, 65536)
        except OSError:
            data = b""
        self._is_over = not data
        self.text += re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", data.decode("utf-8", "ignore"))

    def end(self):
        """Read the rest; the exit status."""
        give_up = time.monotonic() + TIMEOUT
        while not self._is_over and time.monotonic() < give_up:
            if select.select([self.master], [], [], 0.5)[0]:
                self._read()
        os.close(self.master)
        return self._child.wait(TIMEOUT)

    def kill(self):
        self._child.kill()
        self._child.wait(TIMEOUT)
        os.close(self.master)


def test_killed_in_pose_five_and_in_the_walk_it_resumes_there(tmp_path: Path):
    arguments = ["--simulate", "sample", "--out", "me.toml", "--hold", "0.8", "--motion", "9"]
    first = Terminal(arguments, tmp_path)
    first.wait_for("press Enter or space")
    assert "pose 1 of 8: T" in first.text
    time.sleep(0.3)
    first.press(" ")
    first.wait_for(r"recorded 4: ski low")
    first.wait_for(r"pose 5 of 8: ski wide")
    first.kill()
    kept = json.loads((tmp_path / "me.progress.json").read_text())
    assert [hold["pose"] for hold in kept["holds"]] == ["T", "twist", "side bend", "ski low"]
    second = Terminal([*arguments, "--yes"], tmp_path)
    second.wait_for("going on after 4 poses")
    second.wait_for(r"pose 5 of 8: ski wide")
    second.wait_for(r"recorded 8: heel")
    second.wait_for("Walk about as you like")
    second.wait_for(r"\b3 s to go")
    second.kill()
    third = Terminal([*arguments, "--yes"], tmp_path)
    third.wait_for("going on after 8 poses and [56] s of motion")
    third.wait_for("recorded motion")
    assert third.end() == 0
    assert "thigh" in third.text
    subject = read_subject(tmp_path / "me.toml")
    assert subject.calibration is not None
    assert len(subject.calibration.poses) == 8
    assert subject.calibration.method == "eight poses and 9 s of motion"
    truth = canonical_subject()
    femur = 1
    assert subject.lengths[femur] == pytest.approx(truth.lengths[femur], rel=0.06)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["me.known.json", "me.toml"]


def test_without_a_terminal_a_mistake_is_named_and_repeated(tmp_path: Path):
    arguments = ["--simulate", "sample", "--out", "me.toml", "--quick", "--hold", "0.8",
                 "--mistake", "T=bow", "--name", "anna"]  # fmt: skip
    done = subprocess.run(
        [*COMMAND, *arguments],
        cwd=tmp_path,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=TIMEOUT,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "Pose T was done as pose bow" in done.stderr
    assert "recorded 1: T" in done.stderr
    assert "usual proportions" in done.stdout
    subject = read_subject(tmp_path / "me.toml")
    assert subject.name == "anna"
    assert subject.calibration is not None
    assert subject.calibration.method == "T-pose"


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--out", "x.toml"], 1, "either --config"),
        (["--simulate", "sample", "--config", "is900", "--out", "x.toml"], 1, "either --config"),
        (["--config", "nothing", "--out", "x.toml"], 1, "no configuration"),
        (["--config", "demo", "--out", "x.toml"], 1, "--simulate"),
        (["--simulate", "sample", "--out", "x.toml", "--mistake", "T=x"], 1, "no mistake"),
        (["--simulate", "sample", "--out", "x.toml", "--height", "178"], 1, "centimeters"),
        (["--simulate", "sample", "--out", "x.toml", "--pose", "juggling"], 1, "no pose named"),
        (["height", "17", "--out", "x.toml"], 1, "nobody"),
        (["check", "none.toml", "--simulate", "sample"], 1, "cannot read"),
        (["run", "--nonsense"], 2, "nonsense"),
        (["nonsense"], 2, "nonsense"),
    ],
)
def test_wrong_use_is_one_sentence(arguments, code, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["calibrate", *arguments])
    assert result.exit_code == code, result.output
    assert words in result.stderr
    assert "Traceback" not in result.output


def test_a_height_alone_makes_a_subject(tmp_path: Path):
    out = tmp_path / "tall.toml"
    result = CliRunner().invoke(app, ["calibrate", "height", "1.90", "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert "femur" in result.stdout
    record = read_subject(out).calibration
    assert record is not None
    assert record.method == "height"
    assert record.length_sd["lfemur"] > 0.005


def test_poses_are_shown_and_what_they_tell(tmp_path: Path):
    result = CliRunner().invoke(app, ["calibrate", "poses", "--information"])
    assert result.exit_code == 0, result.output
    assert "eight naive poses" in result.stdout
    assert "8 heel" in result.stdout


def test_a_subject_is_refined_by_motion(tmp_path: Path):
    """Who wears trackers otherwise than the file says is found out by walking."""
    truth = canonical_subject()
    mounts = list(truth.mounts)
    x, y, z = mounts[4].position
    mounts[4] = replace(mounts[4], position=(x + 0.05, y, z + 0.04))
    write_subject(replace(truth, mounts=tuple(mounts)), tmp_path / "truth.toml")
    write_subject(truth, tmp_path / "me.toml")
    out = tmp_path / "better.toml"
    arguments = ["calibrate", "refine", str(tmp_path / "me.toml"), "--out", str(out),
                 "--simulate", "sample", "--seconds", "8"]  # fmt: skip
    result = CliRunner().invoke(app, [*arguments, "--truth", str(tmp_path / "truth.toml")])
    assert result.exit_code == 0, result.output
    assert "no me.known.json" in result.stderr
    assert "90 % within" in result.stdout
    better = read_subject(out)
    moved = np.array([m.position for m in better.mounts])
    true = np.array([m.position for m in mounts])
    assert np.linalg.norm(moved[4] - true[4]) < 0.9 * np.linalg.norm([0.05, 0.04])
    known = read_knowledge(better, known_file(out))
    assert known is not None
    assert np.all(known.position_sd < UNKNOWN_MOUNT[0])
    assert np.all(np.abs(moved - true) < 3.5 * known.position_sd)
    assert better.calibration is not None
    assert "refined by motion" in better.calibration.method
    result = CliRunner().invoke(app, [*arguments[:5], "--config", "is900", "--truth", str(out)])
    assert result.exit_code == 1
    assert "together with --simulate" in result.stderr


def test_checks_need_motion_and_enough_trackers(tmp_path: Path):
    file = tmp_path / "s.toml"
    write_subject(canonical_subject(), file)
    result = CliRunner().invoke(app, ["calibrate", "check", str(file)])
    assert result.exit_code == 1
    assert "give one of" in result.stderr
    write_subject(canonical_subject().with_trackers(("head", "lhand")), file)
    result = CliRunner().invoke(app, ["calibrate", "check", str(file), "--simulate", "sample"])
    assert "four at least" in result.stderr
