"""The command line: finding commands, help, errors and exit codes."""

import subprocess
import sys

import pytest
from typer.testing import CliRunner

import localreg.cli
from localreg.cli import BUILT_IN, Command, app
from localreg.errors import LocalregError

run = CliRunner().invoke

_HEAVY = ("jax", "numba", "mujoco", "matplotlib", "faiss", "scipy", "numpy", "rich.table", "serial")


def test_help_lists_every_command_and_imports_none() -> None:
    code = f"""
import sys
from localreg.cli import main
sys.argv = ["localreg", "--help"]
try:
    main()
finally:
    heavy = [name for name in {_HEAVY!r} if name in sys.modules]
    own = [name for name in sys.modules if name.startswith(("localreg.commands.", "sensors."))]
    assert not heavy + own, heavy + own
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    for name in ("data", "db", "synthesize", "evaluate", "doctor", "sensors"):
        assert f"\n  {name} " in done.stdout


def test_python_m_localreg_is_the_same_command() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "localreg", "--version"],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("localreg ")


@pytest.mark.parametrize("name", [*BUILT_IN, "sensors"])
def test_every_command_has_help_that_teaches(name: str) -> None:
    if name not in localreg.cli._commands():
        pytest.skip(f"{name} is not installed")
    result = run(app, [name, "--help"])
    assert result.exit_code == 0, result.output
    assert f"Usage: localreg {name}" in result.output
    assert len(result.output.splitlines()) > 5


@pytest.mark.parametrize("command", ["evaluate", "synthesize", "doctor", "db build", "db info"])
def test_help_shows_examples_and_units(command: str) -> None:
    text = run(app, [*command.split(), "--help"]).output
    assert f"localreg {command}" in text.partition("Example")[2]
    if command in ("evaluate", "db build"):
        assert "[Hz]" in " ".join(text.split())


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (["evalute"], "did you mean evaluate?"),
        (["nonsense"], "try "),
        (["evaluate"], "Missing argument 'SOURCE"),
        (["evaluate", "sample", "--signals", "taste"], "choose among both, position, orientation"),
        (["evaluate", "sample", "--methods", "magic"], "no method named magic"),
        (["evaluate", "sample", "--leave-out", "shoe"], "choose clip, subject or activity"),
        (["evaluate", "sample", "--database", "d", "--leave-out", "clip"], "choose one"),
        (["evaluate", "sample", "--start", "warm"], "choose among cold, truth"),
        (["evaluate", "sample", "--dropout", "2"], "0.99"),
        (["evaluate", "sample", "--max-frames", "3"], "give 9 or more"),
        (["evaluate", "sample", "--json", "/nowhere/at/all.json"], "cannot write"),
        (["db", "build", "sample"], "Missing option '--out'"),
        (["db", "build", "sample", "--out", "d", "--rate", "0"], "0.0 Hz is no rate"),
        (["synthesize", "x.bvh", "--database", "d", "--out", "o.xyz"], "may end in"),
    ],
)
def test_wrong_use_ends_with_2(args: list[str], says: str) -> None:
    result = run(app, args)
    assert result.exit_code == 2, result.output
    assert says in " ".join(result.output.split())
    assert "Traceback" not in result.output


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (["db", "info", "/nowhere"], "there is no database at /nowhere"),
        (["db", "build", "/nowhere", "--out", "d"], "there is no file or folder /nowhere"),
        (["evaluate", "/nowhere.bvh", "--methods", "ik"], "there is no file or folder"),
        (["evaluate", "sample", "--database", "/nowhere"], "there is no database at /nowhere"),
    ],
)
def test_what_goes_wrong_is_one_sentence_and_1(args: list[str], says: str) -> None:
    result = run(app, args)
    assert result.exit_code == 1
    assert result.stdout == ""
    assert result.stderr.startswith("error: ")
    assert says in result.stderr
    assert len(result.stderr.splitlines()) == 1


@pytest.mark.parametrize("place", [0, 1, 3])
def test_debug_lets_the_error_through_wherever_it_stands(place: int) -> None:
    args = ["db", "info", "/nowhere"]
    args.insert(place, "--debug")
    result = run(app, args)
    assert isinstance(result.exception, LocalregError)


def test_errors_of_sensors_are_sentences_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(BUILT_IN, "break", Command(f"{__name__}:breaking", "Breaks."))
    result = run(app, ["break"])
    assert (result.exit_code, result.stderr) == (1, "error: the line is dead; plug it in\n")


def breaking() -> None:
    """Break."""
    from sensors.errors import SensorError

    raise SensorError("the line is dead; plug it in")


def test_commands_that_are_not_there_are_not_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(BUILT_IN, "later", Command("localreg.commands.later:app", "Comes later."))
    assert "later" not in run(app, ["--help"]).output
    assert run(app, ["later"]).exit_code == 2


def test_output_that_nobody_reads_is_no_error() -> None:
    command = f"{sys.executable} -m localreg data sample | head -1"
    done = subprocess.run(
        ["sh", "-c", command], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0
    assert "Traceback" not in done.stderr
    assert "BrokenPipe" not in done.stderr


@pytest.mark.parametrize(
    ("config", "says"),
    [("is90", "did you mean is900?"), ("demo", "cannot open emulator")],
)
def test_commands_of_the_sensors_know_configurations_by_name(config: str, says: str) -> None:
    result = run(app, ["sensors", "monitor", "--config", config])
    assert result.exit_code == 1
    assert says in result.stderr
