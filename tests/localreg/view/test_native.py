"""The window: a real one, on a display that nobody sees."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from localreg.cli import app
from localreg.motion.formats import write_motion
from tests.localreg.view.virtual_display import (
    MISSING,
    VirtualDisplay,
    eventually,
    is_there,
    virtual_display,
)
from tests.localreg.view.walking import walking

SPACE = 0x20


@pytest.fixture
def display(tmp_path: Path) -> Iterator[VirtualDisplay]:
    if not is_there():
        pytest.skip(MISSING)
    with virtual_display(tmp_path) as running:
        yield running


def view(walk: Path, display: str) -> "subprocess.Popen[str]":
    environment = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "COLUMNS")}
    environment |= {"DISPLAY": display, "OPENBLAS_NUM_THREADS": "1"}
    environment.pop("WAYLAND_DISPLAY", None)
    return subprocess.Popen(
        [sys.executable, "-m", "localreg", "view", str(walk), "--loop"],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip


def blue(picture: np.ndarray) -> float:
    """Share of the screen that is the body's."""
    return float((picture[..., 2].astype(int) - picture[..., 0] > 60).mean())


def test_a_window_shows_the_body_moving_and_obeys_keys(
    tmp_path: Path, display: VirtualDisplay
) -> None:
    walk = tmp_path / "walk.bvh"
    write_motion(walking(2.0), walk)
    process = view(walk, display.name)
    try:
        assert eventually(lambda: blue(display.picture()) > 0.01 or process.poll() is not None)
        assert process.poll() is None, process.communicate()[0]
        first = display.picture().copy()

        def moved() -> bool:
            return bool(np.mean(np.any(display.picture() != first, axis=2)) > 0.01)

        assert eventually(moved)
        solid = blue(display.picture())
        display.press(ord("7"))
        assert eventually(lambda: blue(display.picture()) < 0.5 * solid), "sticks are thin"
        display.press(ord("7"))
        display.press(ord("7"))
        assert eventually(lambda: blue(display.picture()) > 0.7 * solid)
        # Paused, with the camera at rest, nothing changes any more.
        display.press(SPACE)
        display.press(ord("2"))

        def stands_still() -> bool:
            before = display.picture().copy()
            return not eventually(lambda: np.any(display.picture() != before), patience=1.0)

        assert eventually(stands_still)
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
        assert "Traceback" not in process.communicate()[0]
    finally:
        process.kill()
        process.wait()


def test_without_a_display_one_sentence_names_the_browser(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    walk = tmp_path / "walk.bvh"
    write_motion(walking(0.1), walk)
    monkeypatch.setenv("DISPLAY", ":32123")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    result = CliRunner().invoke(app, ["view", str(walk)])
    assert result.exit_code == 1
    # On a slow machine progress was shown before.
    last = result.stderr.strip().splitlines()[-1]
    assert last.startswith("error: no window can be opened here")
    assert "--web" in last
