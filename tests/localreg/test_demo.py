"""The command, as typed."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from localreg.cli import app
from localreg.motion.formats.registry import read_motion

PNG = b"\x89PNG\r\n\x1a\n"


def test_the_demo_writes_what_it_says(tmp_path: Path):
    out, figures = tmp_path / "deep" / "out", tmp_path / "demo.json"
    arguments = ["demo", "--seconds", "1.5", "--out", str(out), "--json", str(figures)]
    result = CliRunner().invoke(app, [*arguments, "--view", "none", "--seed", "4"])
    assert result.exit_code == 0, result.output
    assert "warmed up in" in result.stderr
    for words in ("joint-angle error", "MPJPE", "latency, 99 %", "late frames", "of 60"):
        assert words in result.stdout
    for file in (out / "synthesis.bvh", out / "filmstrip.png", figures):
        assert str(file) in result.stdout.replace("\n", "")
    document = json.loads(figures.read_text())
    assert document["settings"]["seed"] == 4
    assert document["live"]["frames"] == 60
    (motion,) = read_motion(out / "synthesis.bvh")
    assert len(motion) == sum(clip["frames"] for clip in document["clips"])
    assert (out / "filmstrip.png").read_bytes().startswith(PNG)


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--seconds", "0"], 1, "half a second or more"),
        (["--seconds", "5", "--faults"], 1, "give --seconds 10"),
        (["--out", "{file}/out"], 1, "give another --out"),
        (["--view", "mirror"], 2, "mirror"),
        (["--nonsense"], 2, "nonsense"),
    ],
)
def test_wrong_use_is_one_sentence(arguments, code, words, tmp_path: Path):
    file = tmp_path / "file"
    file.touch()
    arguments = ["--view", "none", *(a.format(file=file) for a in arguments)]
    if "--out" not in arguments:
        arguments += ["--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, ["demo", *arguments])
    assert result.exit_code == code
    assert words in result.stderr
    assert "Traceback" not in result.output
