"""What is answered before anything is opened or loaded."""

import contextlib
import re
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from localreg.body.subject import canonical_subject, write_subject
from localreg.cli import app
from localreg.errors import LocalregError
from localreg.live.config import JsonOutput, RunConfig, VmcOutput, VrpnOutput
from localreg.live.config_files import find_config
from localreg.live.outputs import open_outputs
from localreg.live.run_options import RunOptions, method_settings, wearer_of
from localreg.synthesis.settings import METHODS
from sensors.errors import ConfigurationError
from sensors.placement import Placement
from sensors.recording import Recorder

run = CliRunner().invoke
SUBJECT = canonical_subject()


def config(stations: dict[str, int], method: str = "localreg") -> RunConfig:
    device = {"driver": "is900", "port": "/dev/ttyUSB0", "stations": stations}
    return RunConfig.parse({"devices": [device], "synthesis": {"method": method}})


def test_a_subject_wears_what_the_devices_report_in_its_own_order():
    wearer = wearer_of(config({"rhand": 2, "head": 1, "torso": 3}), RunOptions())
    assert wearer.trackers == ("head", "torso", "rhand")


def test_a_tracker_without_a_place_on_the_body_is_named():
    with pytest.raises(LocalregError, match=r"wears no tracker tail.*head, torso"):
        wearer_of(config({"head": 1, "tail": 2}), RunOptions())
    with pytest.raises(LocalregError, match="none named"):
        wearer_of(config({}), RunOptions())


def test_the_trackers_of_a_subject_file_count(tmp_path: Path):
    mount = replace(SUBJECT.mounts[0], tracker="crown")
    file = tmp_path / "anna.toml"
    write_subject(replace(SUBJECT, name="anna", mounts=(mount,)), file)
    options = RunOptions(subject=file)
    assert wearer_of(config({"crown": 1}), options).trackers == ("crown",)
    with pytest.raises(LocalregError, match="anna wears no tracker head"):
        wearer_of(config({"head": 1}), options)


def test_a_replayed_recording_reports_its_own_trackers(tmp_path: Path):
    path = tmp_path / "take.mcap"
    device = config({"head": 1, "lhand": 2}).devices[0]
    with Recorder(path) as recorder:
        recorder.configuration(
            ("head", "lhand"),
            [device.model_copy(update={"name": "is900"}).model_dump(mode="json")],
            {},
            Placement().model_dump(mode="json"),
        )
    replay = RunConfig.parse({"devices": [{"driver": "replay", "file": str(path)}]})
    assert wearer_of(replay, RunOptions()).trackers == ("head", "lhand")


def synthesis(**told: float) -> RunConfig:
    device = {"driver": "is900", "port": "/dev/ttyUSB0", "stations": {"head": 1}}
    return RunConfig.parse({"devices": [device], "synthesis": told})


def test_trackers_may_be_said_to_be_noisy():
    assert method_settings(synthesis()) == METHODS["localreg"]
    noisy = method_settings(synthesis(position_error_m=0.02, orientation_error_deg=3.0))
    expected = replace(METHODS["localreg"], sigma_position=0.02, sigma_orientation=np.radians(3.0))
    assert noisy == expected


@pytest.mark.parametrize("told", [{"position_error_m": 20.0}, {"orientation_error_deg": 0.0}])
def test_errors_in_a_wrong_unit_are_refused(told: dict[str, float]):
    with pytest.raises(ConfigurationError, match=next(iter(told))):
        synthesis(**told)


@pytest.mark.parametrize(
    ("method", "seconds", "words"),
    [
        ("magic", None, "synthesis.method is 'magic'; choose among localreg"),
        ("localreg", 0.0, "cannot run for 0 s"),
        ("localreg", float("nan"), "cannot run for nan s"),
    ],
)
def test_what_cannot_be_is_said(method: str, seconds: float | None, words: str):
    with pytest.raises(LocalregError, match=re.escape(words)):
        wearer_of(config({"head": 1}, method), RunOptions(seconds=seconds))


@pytest.mark.parametrize(
    ("record", "health", "words"),
    [
        (("a.c3d",), None, r"cannot record to a\.c3d; .*\.mcap.*\.bvh or \.amc"),
        (("a.mcap", "b.mcap"), None, "one recording at a time"),
        (("there.bvh",), None, r"there\.bvh exists and is not overwritten"),
        (("new.mcap",), "there.bvh", r"there\.bvh exists and is not overwritten"),
    ],
)
def test_files_are_looked_at_before_anything_is_opened(
    record: tuple[str, ...],
    health: str | None,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.chdir(tmp_path)
    Path("there.bvh").write_text("precious")
    options = RunOptions(record=tuple(map(Path, record)), health=health)
    with pytest.raises(LocalregError, match=words):
        wearer_of(config({"head": 1}), options)
    good = RunOptions(record=(Path("a.mcap"), Path("a.bvh"), Path("a.amc")), health="-")
    wearer_of(config({"head": 1}), good)


def test_checking_loads_neither_jax_nor_mujoco():
    program = (
        "import sys\n"
        "from localreg.cli import app\n"
        "try:\n"
        "    app(['run', '--config', 'paper', '--check'])\n"
        "except SystemExit as end:\n"
        "    assert not end.code, end.code\n"
        "assert not {'jax', 'mujoco'} & set(sys.modules)\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120
    )
    assert result.returncode == 0, result.stderr
    assert "paper.toml: good; 1 devices, trackers head" in result.stdout


def test_a_configuration_can_be_shown_and_used_as_a_file(tmp_path: Path):
    shown = run(app, ["run", "--config", "is900", "--show"])
    assert shown.exit_code == 0
    assert shown.stdout == find_config("is900").read_text()
    mine = tmp_path / "mine.toml"
    mine.write_text(shown.stdout)
    assert run(app, ["run", "--config", str(mine), "--check"]).exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--config", "is9000"], "did you mean is900?"),
        (["--config", "is900", "--subject", "nobody.toml"], "cannot read subject file nobody.toml"),
    ],
)
def test_mistakes_end_with_a_sentence(arguments: list[str], words: str):
    result = run(app, ["run", *arguments])
    assert result.exit_code == 1
    assert words in result.stderr
    assert "Traceback" not in result.output


def test_outputs_that_cannot_all_be_opened_leave_nothing_open():
    with contextlib.closing(socket.create_server(("127.0.0.1", 0))) as taken:
        port = taken.getsockname()[1]
        with contextlib.closing(socket.create_server(("127.0.0.1", 0))) as spare:
            free = spare.getsockname()[1]
        outputs = (
            VmcOutput(protocol="vmc"),
            VrpnOutput(protocol="vrpn", port=free),
            VrpnOutput(protocol="vrpn", port=port),
        )
        with pytest.raises(LocalregError, match=rf"127\.0\.0\.1:{port} for VRPN"):
            open_outputs(outputs, SUBJECT, 40.0, "127.0.0.1")
    (again,) = open_outputs(outputs[1:2], SUBJECT, 40.0, "127.0.0.1")
    again.close()


def test_an_unknown_host_is_named():
    output = JsonOutput(protocol="json", host="no.such.host.invalid")
    with pytest.raises(LocalregError, match=r"cannot send to no\.such\.host\.invalid:39550"):
        open_outputs((output,), SUBJECT, 40.0, "127.0.0.1")
