"""`localreg doctor`: what works on this machine, and what to do about the rest."""

import os
import sys
from collections.abc import Callable, Iterator
from typing import Final, Literal, NamedTuple

import typer

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

_PACKAGES: Final = ("jax", "numpy", "scipy", "mujoco", "optimistix", "pyserial")
_STYLES: Final = {"ok": "green", "note": "yellow", "missing": "red"}


class Finding(NamedTuple):
    """One thing that was looked at.

    Attributes:
        topic: what it is about.
        state: whether it works, deserves a note, or is missing.
        found: what was found.
        advice: what to do about it; empty if nothing.
    """

    topic: str
    state: Literal["ok", "note", "missing"]
    found: str
    advice: str = ""


@app.command(epilog="Example: localreg doctor")
def doctor() -> None:
    """Say what works on this machine and what to do about the rest.

    Looks at versions, data, graphics, serial ports and processors. Changes nothing.
    """
    from rich.table import Table
    from rich.text import Text

    from localreg.commands.console import output

    findings = list(examine())
    table = Table("topic", "state", "found", "what to do")
    for finding in findings:
        table.add_row(
            finding.topic,
            Text(finding.state, style=_STYLES[finding.state]),
            Text(finding.found),
            Text(finding.advice),
        )
    console = output()
    console.print(table)
    missing = [finding.topic for finding in findings if finding.state == "missing"]
    console.print(f"to mend: {', '.join(missing)}" if missing else "nothing is missing")


def examine() -> Iterator[Finding]:
    """Everything that is looked at; what cannot even be looked at is a finding too."""
    checks: tuple[tuple[str, Callable[[], Iterator[Finding]]], ...] = (
        ("program", _versions),
        ("sample set", _sample),
        ("graphics", _graphics),
        ("serial ports", _serial_ports),
        ("pseudo terminals", _pseudo_terminals),
        ("processors", _processors),
    )
    for topic, check in checks:
        try:
            yield from check()
        except Exception as error:  # a doctor reports whatever is the matter
            yield Finding(topic, "missing", f"{type(error).__name__}: {error}", "report this")


def _versions() -> Iterator[Finding]:
    from importlib.metadata import PackageNotFoundError, version

    python = ".".join(map(str, sys.version_info[:3]))
    old = sys.version_info < (3, 11)
    yield Finding(
        "Python", "missing" if old else "ok", python, "install Python 3.11 or newer" if old else ""
    )
    found, missing = [], []
    for package in ("localreg-mocap", *_PACKAGES):
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            missing.append(package)
    if missing:
        yield Finding("packages", "missing", ", ".join(missing), f"pip install {' '.join(missing)}")
    yield Finding("versions", "ok", ", ".join(found))


def _sample() -> Iterator[Finding]:
    from localreg.errors import MotionError
    from localreg.motion.formats.sample import read_sample

    try:
        motions = read_sample()
    except MotionError as error:
        yield Finding("sample set", "missing", "not usable", str(error))
        return
    seconds = sum(motion.seconds for motion in motions)
    yield Finding("sample set", "ok", f"{len(motions)} clips, {seconds:.0f} s")


def _graphics() -> Iterator[Finding]:
    from localreg.drawing.offscreen import ADVICE, working_backend

    backend = working_backend(os.environ.get("MUJOCO_GL", ""))
    if backend:
        yield Finding("pictures", "ok", f"solid bodies by MuJoCo's {backend}")
    else:
        yield Finding("pictures", "note", "stick figures by Matplotlib", ADVICE)
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        yield Finding("display", "ok", "a window can be opened")
    else:
        yield Finding("display", "note", "none", "pictures are drawn off screen")


def _serial_ports() -> Iterator[Finding]:
    from serial.tools import list_ports

    ports = sorted(port.device for port in list_ports.comports())
    if not ports:
        yield Finding(
            "serial ports",
            "note",
            "none",
            "plug in the tracker's adapter, or try localreg sensors emulate",
        )
    for port in ports:
        if os.access(port, os.R_OK | os.W_OK):
            yield Finding("serial port", "ok", f"{port}, may be opened")
        else:
            yield Finding("serial port", "missing", f"{port}, may not be opened", _permission(port))


def _permission(port: str) -> str:
    """How to be allowed to open a port: by the group that it belongs to, often dialout."""
    import grp

    try:
        group = grp.getgrgid(os.stat(port).st_gid).gr_name  # noqa: PTH116
    except (KeyError, OSError):
        return "ask who runs this machine for permission"
    return f"sudo usermod -aG {group} $USER, then log out and in again"


def _pseudo_terminals() -> Iterator[Finding]:
    try:
        for descriptor in os.openpty():
            os.close(descriptor)
    except OSError as error:
        yield Finding(
            "emulator", "missing", f"no pseudo terminal: {error.strerror}",
            "mount /dev/pts, or emulate over TCP: localreg sensors emulate --tcp 127.0.0.1:5000",
        )  # fmt: skip
    else:
        yield Finding("emulator", "ok", "pseudo terminals work")


def _processors() -> Iterator[Finding]:
    cores = len(os.sched_getaffinity(0))
    busy = os.getloadavg()[0]
    found = f"{cores} usable, load {busy:.1f}"
    if cores < 2:
        yield Finding("processors", "note", found, "live motion wants two, one for the sensors")
    elif busy > cores:
        yield Finding("processors", "note", found, "close other programs before a live session")
    else:
        yield Finding("processors", "ok", found)
