"""The service file, read by systemd itself, and what it promises against the program."""

import configparser
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from localreg.cli import app
from localreg.live.config_files import shipped_configs

UNIT = next(iter(shipped_configs().values())).parent / "systemd" / "localreg@.service"


@pytest.fixture
def service() -> configparser.SectionProxy:
    parser = configparser.ConfigParser(interpolation=None, strict=False)
    parser.optionxform = str  # type: ignore[method-assign, assignment]
    parser.read(UNIT)
    return parser["Service"]


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_systemd_understands_the_unit(tmp_path: Path):
    text = UNIT.read_text().replace("/opt/localreg/bin/localreg", sys.executable)
    unit = tmp_path / "localreg@is900.service"
    unit.write_text(text)
    result = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", "--recursive-errors=no", str(unit)],
        capture_output=True,
        text=True,
        timeout=60,
    )
    about_us = [line for line in result.stderr.splitlines() if "localreg" in line]
    assert about_us == []
    assert result.returncode == 0, result.stderr


def test_the_command_is_one_that_the_program_takes(service: configparser.SectionProxy):
    _, *arguments = shlex.split(service["ExecStart"].replace("%i", "is900"))
    result = CliRunner().invoke(app, [*arguments, "--check"])
    assert result.exit_code == 0, result.output


def test_reloading_is_the_signal_that_recenters(service: configparser.SectionProxy):
    assert service["ExecReload"] == "/bin/kill -USR1 $MAINPID"
    assert service["Type"] == "notify"
    assert float(service["WatchdogSec"]) >= 10.0
