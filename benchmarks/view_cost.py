"""What the live view costs the loop: synthesis with the page open in a browser, and without.

    python -m benchmarks.view_cost --seconds 120 --json view.json

One run alternates between the two every few seconds, so that both see the same machine: with,
every frame goes to the view's process, which serves a page that somebody has open; without, the
view and the visitor are stopped by a signal and nothing is handed over. Frames come at 40 Hz, as
live, of a walk that is left out of the database.

The visitor takes all that a browser takes and draws nothing, as that is done by the graphics
hardware of another machine. `--visitor chromium` draws with this machine's processors instead,
which on few cores measures little but that.
"""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from localreg.commands.console import notes, output, progress_bar
from localreg.database.store import PoseDatabase
from localreg.errors import LocalregError
from localreg.evaluation.results import program_version, write_json
from localreg.evaluation.trackers import SimulatedTrackers, simulate_trackers
from localreg.live.nearest_clips import Found, NearestClips
from localreg.live.quiet import undisturbed
from localreg.live.sinks.base import LivePose
from localreg.live.sinks.view import ViewSink
from localreg.live.viewing import EVERY, SEARCH_EVERY
from localreg.live.warm_up import warm_up
from localreg.motion.sources import SAMPLE, read_sources
from localreg.synthesis.estimator import AnyEstimator
from localreg.synthesis.methods import build_estimator
from localreg.view.feed import About
from localreg.view.process import ViewProcess

RATE = 40.0
"""Frames a second [Hz]."""

MOST_GROWTH = 0.20
"""The view is too dear if the 99th percentile grows by more."""

_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_FLAGS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--headless=new",
          "--no-sandbox", "--window-size=900,560")  # fmt: skip
_CONNECTED = 60.0
_SETTLING = 5.0


class Visitor(StrEnum):
    """Who has the page open."""

    PLAIN = "plain"
    CHROMIUM = "chromium"


class Shown:
    """The view's process and the visitor: running, or stopped by a signal."""

    def __init__(self, view: ViewProcess, visitor: subprocess.Popen[bytes]) -> None:
        self._view, self._visitor = view, visitor

    def go(self, on: bool) -> None:
        """Let both run, or stop both."""
        number = signal.SIGCONT if on else signal.SIGSTOP
        os.kill(self._view.pid, number)
        os.killpg(self._visitor.pid, number)


@contextlib.contextmanager
def visiting(url: str, visitor: Visitor) -> Iterator[subprocess.Popen[bytes]]:
    """Somebody who has the page open, at the lowest priority.

    Raises:
        LocalregError: there is no browser.
    """
    with tempfile.TemporaryDirectory() as profile:
        if visitor is Visitor.PLAIN:
            command = [sys.executable, "-m", "benchmarks.visitor", url, "--seconds", "1000000"]
        else:
            command = [_browser(), *_FLAGS, f"--user-data-dir={profile}", url]
        process = subprocess.Popen(
            ["nice", "-n", "19", *command],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        try:
            yield process
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGCONT)
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            time.sleep(0.5)


def _browser() -> str:
    found = next((path for name in _BROWSERS if (path := shutil.which(name))), None)
    if found is None:
        raise LocalregError("there is no browser; apt-get install chromium, or --visitor plain")
    return found


def wait_connected(pid: int, port: int) -> None:
    """Until a visitor has both sockets of the page open.

    Raises:
        LocalregError: it does not come.
    """
    give_up = time.monotonic() + _CONNECTED
    wanted = f":{port:04X}"
    while time.monotonic() < give_up:
        rows = [line.split() for line in Path(f"/proc/{pid}/net/tcp").read_text().splitlines()]
        if sum(row[1].endswith(wanted) and row[3] == "01" for row in rows) >= 2:
            return
        time.sleep(0.2)
    raise LocalregError(f"nobody opened the page within {_CONNECTED:g} s")


def measure(seconds: float, block: float, visitor: Visitor) -> dict[str, Any]:
    """Alternate and return the figures.

    Args:
        seconds: how long altogether [s].
        block: how long with or without in one go [s].
        visitor: who has the page open.
    """
    motions, _ = read_sources([SAMPLE])
    walk = max(motions, key=len)
    database = PoseDatabase.build(motions, rate=RATE)
    allowed = database.exclude(clip=walk.provenance.name)
    estimator = build_estimator("localreg", walk.subject, database).leave_out(allowed)
    warm_up(estimator)
    trackers = simulate_trackers(walk.resampled(RATE))
    with contextlib.ExitStack() as stack:
        view = stack.enter_context(ViewProcess(walk.subject, port=0))
        url, _ = view.wait()
        process = stack.enter_context(visiting(url, visitor))
        wait_connected(view.pid, int(url.rstrip("/").rpartition(":")[2]))
        shown = Shown(view, process)
        stack.callback(shown.go, True)
        with undisturbed():
            loop = Loop(estimator, trackers, view, NearestClips(database))
            loop.run(_SETTLING, True)
            times = loop.alternate(seconds, block, shown)
    return figures(times)


class Loop:
    """Steps an estimator at the rate of the frames, over and over."""

    def __init__(
        self,
        estimator: AnyEstimator,
        trackers: SimulatedTrackers,
        view: ViewProcess,
        clips: NearestClips,
    ) -> None:
        self._estimator, self._trackers = estimator, trackers
        self._view, self._sink, self._clips = view, ViewSink(view), clips
        self._state = estimator.init(trackers.frame(0))
        self._index = 0
        self._due = time.monotonic()
        self._about, self._turn, self._found = 0.0, 0, Found()

    def alternate(self, seconds: float, block: float, shown: Shown) -> dict[bool, list[np.ndarray]]:
        """The times of all blocks, with and without [s]."""
        times: dict[bool, list[np.ndarray]] = {True: [], False: []}
        pairs = max(2, round(seconds / block / 2.0))
        with progress_bar("alternating") as bar:
            for pair in range(pairs):
                # Whatever drifts shall not always meet the same one second.
                for on in (True, False) if pair % 2 else (False, True):
                    shown.go(on)
                    self.run(0.5, on)
                    times[on].append(self.run(block, on))
                bar(pair + 1, pairs, "")
        return times

    def run(self, seconds: float, on: bool) -> np.ndarray:
        """Take frames for so long.

        Args:
            seconds: how long [s].
            on: whether the view is handed them.

        Returns:
            From the frame to the pose handed on, for each [s].
        """
        times = []
        self._due = time.monotonic()
        for _ in range(round(seconds * RATE)):
            self._due += 1.0 / RATE
            time.sleep(max(0.0, self._due - time.monotonic()))
            if self._index == len(self._trackers):
                self._index = 0
                self._state = self._estimator.init(self._trackers.frame(0))
            frame = self._trackers.frame(self._index)
            begun = time.perf_counter()
            self._state, pose = self._estimator.step(self._state, frame)
            if on:
                self._sink.publish(LivePose(self._index, frame, pose, False, False))
            times.append(time.perf_counter() - begun)
            self._index += 1
            if on and time.monotonic() - self._about > EVERY:
                self._about, self._turn = time.monotonic(), self._turn + 1
                if self._turn % SEARCH_EVERY == 0:
                    self._found = self._clips.find(pose.qpos)
                self._view.tell(About(neighbors=self._found.clips, title="walk"))
        return np.array(times)


def figures(times: dict[bool, list[np.ndarray]]) -> dict[str, Any]:
    """Percentiles with and without, and by how much they grow."""
    found: dict[str, Any] = {"version": program_version(), "rate_hz": RATE}
    for on, name in ((True, "with"), (False, "without")):
        every = 1e3 * np.concatenate(times[on])
        found[name] = {
            "frames": len(every),
            **{f"p{q}_ms": float(np.percentile(every, q)) for q in (50, 90, 99)},
        }
    for q in (50, 90, 99):
        ratio = found["with"][f"p{q}_ms"] / found["without"][f"p{q}_ms"]
        found[f"p{q}_growth"] = ratio - 1.0
    return found


def main(
    seconds: Annotated[float, typer.Option(help="How long altogether [s].")] = 120.0,
    block: Annotated[float, typer.Option(help="With or without in one go [s].")] = 5.0,
    visitor: Annotated[Visitor, typer.Option(help="Who has the page open.")] = Visitor.PLAIN,
    json: Annotated[Path | None, typer.Option(help="Also write the figures here.")] = None,
) -> None:
    """Compare synthesis with the view's page open and without, in one run."""
    notes().print("warming up")
    found = measure(seconds, block, visitor)
    shown = output()
    for name in ("without", "with"):
        row = found[name]
        shown.print(
            f"{name:8s} p50 {row['p50_ms']:6.2f}  p90 {row['p90_ms']:6.2f}  "
            f"p99 {row['p99_ms']:6.2f} ms  ({row['frames']} frames)"
        )
    growth = found["p99_growth"]
    words = "within" if growth < MOST_GROWTH else "beyond"
    shown.print(
        f"p50 grows by {100 * found['p50_growth']:.1f} %, p99 by {100 * growth:.1f} %: {words} "
        f"{100 * MOST_GROWTH:.0f} %"
    )
    if json is not None:
        write_json(found, json)


if __name__ == "__main__":
    typer.run(main)
