"""The demo as somebody sees it: its page in a real browser, which has no screen."""

import contextlib
import io
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from tests.localreg.view.sockets import family_of, ports_beyond_loopback

sync_api = pytest.importorskip("playwright.sync_api")
pytest.importorskip("envpool_assets")

PATIENCE = 240.0
SIZE = (800, 480)
PANEL = 380
"""Width of the side window with its margins [pixels]."""

MARK = (88, 97)
"""Where the button `mark` is."""

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--headless=new", "--no-sandbox")

pytestmark = pytest.mark.skipif(BROWSER is None, reason="no chromium: apt-get install chromium")


class Demo:
    """`localreg demo` as a process, and what it says."""

    def __init__(self, folder: Path) -> None:
        command = [sys.executable, "-m", "localreg", "demo", "--view", "web", "--view-port", "0"]
        self.process = subprocess.Popen(
            [*command, "--seconds", "100", "--out", str(folder)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.said: list[str] = []
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        assert self.process.stderr is not None
        self.said.extend(self.process.stderr)

    def url(self) -> str:
        """Where the page is, once it is said."""
        give_up = time.monotonic() + PATIENCE
        while time.monotonic() < give_up:
            for line in list(self.said):
                if found := re.search(r"http://127\.0\.0\.1:\d+/", line):
                    return found[0]
            assert self.process.poll() is None, "".join(self.said)
            time.sleep(0.1)
        pytest.fail("the demo did not say where its page is: " + "".join(self.said))

    def end(self) -> None:
        """Stop at once: the second Ctrl-C leaves no time for figures and pictures."""
        try:
            while self.process.poll() is None:
                self.process.send_signal(signal.SIGINT)
                time.sleep(0.5)
        finally:
            self.process.kill()
            self._thread.join(PATIENCE)
            assert self.process.stderr is not None
            self.process.stderr.close()


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Demo, Path]]:
    folder = tmp_path_factory.mktemp("demo")
    playing = Demo(folder)
    try:
        yield playing, folder
    finally:
        playing.end()


def picture(page: sync_api.Page) -> np.ndarray:
    """What is to be seen: height, width, red green blue from 0 to 1."""
    return imread(io.BytesIO(page.screenshot(type="png")))[..., :3]


def body(seen: np.ndarray) -> np.ndarray:
    """Which pixels beside the panel are of the blue body."""
    red, blue = seen[:, PANEL:, 0], seen[:, PANEL:, 2]
    return blue > red + 0.15


def test_the_demo_is_seen_and_touched_in_a_browser(demo: tuple[Demo, Path]):
    playing, folder = demo
    url = playing.url()
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=BROWSER, args=list(FLAGS))
        with contextlib.closing(browser):
            page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
            page.set_default_timeout(1e3 * PATIENCE)
            failures: list[str] = []
            page.on("pageerror", lambda error: failures.append(str(error)))
            page.goto(url)
            give_up = time.monotonic() + PATIENCE

            def until(condition: object, what: str) -> None:
                assert callable(condition)
                while not condition():
                    assert time.monotonic() < give_up, (what, playing.said, failures)
                    time.sleep(0.2)

            first = picture(page)

            def is_drawn() -> bool:
                nonlocal first
                first = picture(page)
                return body(first).sum() > 1500

            until(is_drawn, "the body is drawn")
            until(lambda: (body(picture(page)) ^ body(first)).sum() > 300, "the body moves")

            marks = folder / "marks.csv"

            def is_marked() -> bool:
                page.mouse.click(*MARK)
                return marks.exists()

            until(is_marked, "the button of the panel does something")
            assert re.fullmatch(r"frame,seconds\n(\d+,\d+\.\d{3}\n)+", marks.read_text())

            family = family_of(playing.process.pid)
            assert len(family) >= 3  # the demo, the emulator, the view
            assert not set().union(*map(ports_beyond_loopback, family))
            assert not failures
