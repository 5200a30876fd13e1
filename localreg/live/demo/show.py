"""What the demo says while it plays, and the table at its end."""

import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from localreg.live.demo.scores import LiveScore
from localreg.live.performance import tracker_residual
from localreg.live.session import Session

REFRESH = 0.25
"""How often the line is drawn anew [s]."""

_PLAIN_EVERY = 10.0

# Where more frames than this were held, what was followed is told apart from what was not.
_MANY_HELD = 0.01


class ProgressLine:
    """One line on stderr: clip, time, tracker residual, time of a frame.

    A context manager. It is drawn only when `draw` is called, from the live loop's idle
    moments; without a terminal it becomes a plain line every ten seconds.

    Args:
        console: where to.
        session: whose figures are shown.
        clip_at: name of the clip on at a host time [s].
        seconds: duration of the whole [s].
        zero: host time of its beginning [s].
    """

    def __init__(
        self,
        console: Console,
        session: Session,
        clip_at: Callable[[float], str],
        seconds: float,
        zero: float,
    ) -> None:
        self._console = console
        self._session = session
        self._clip_at = clip_at
        self._seconds = seconds
        self._zero = zero
        self._plain_due = zero + _PLAIN_EVERY
        self._live: Live | None = None
        if console.is_terminal:
            self._live = Live(console=console, auto_refresh=False, transient=True)

    def __enter__(self) -> Self:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def draw(self) -> None:
        """Draw the line as things are now."""
        if self._live is not None:
            self._live.update(Text(self.line(), no_wrap=True, overflow="crop"), refresh=True)
        elif time.monotonic() >= self._plain_due:
            self._plain_due += _PLAIN_EVERY
            self._console.print(self.line(), highlight=False)

    def line(self) -> str:
        """The words of the line."""
        latest, counters = self._session.latest, self._session.counters
        if latest is None:
            return "waiting for the first frame"
        t = latest.frame.time
        residual = tracker_residual(latest.pose)
        seen = "no tracker" if np.isnan(residual) else f"trackers {1e3 * residual:4.1f} mm"
        return (
            f"{self._clip_at(t):<8} {t - self._zero:5.1f} of {self._seconds:.1f} s   "
            f"{'held ' if latest.is_held else ''}{seen}   frame {1e3 * counters.compute.last:4.1f} "
            f"ms   late {counters.late_frames}"
        )


def results_table(scored: LiveScore, session: Session, title: str) -> Table:
    """The figures of a run.

    Args:
        scored: accuracy, and what the contract says of the run.
        session: what else was counted; shown where it is not nought.
        title: of the table.
    """
    counters = session.counters
    method, kinds = next(iter(scored.evaluation.means().items()))
    figures = kinds["both"]
    table = Table(title=title, show_header=False, title_justify="left")
    table.add_column("figure")
    table.add_column("value", justify="right")

    def add(name: str, value: float | None, form: str) -> None:
        is_known = value is not None and np.isfinite(value)
        table.add_row(name, form.format(value) if is_known else "-")

    table.add_row("method", method)
    table.add_row("clips played", str(len(scored.evaluation.clips)))
    add("joint-angle error", figures.joint_angle_error_deg, "{:.2f} deg")
    add("position error (MPJPE)", figures.mpjpe_cm, "{:.2f} cm")
    add("tracker error", figures.tracker_error_cm, "{:.2f} cm")
    if scored.held.mean() > _MANY_HELD:
        tracked = ~scored.held & np.isfinite(scored.mpjpe)
        if tracked.any():
            angle = float(np.degrees(scored.joint_angle_error[tracked].mean()))
            add("joint-angle error without held frames", angle, "{:.2f} deg")
            mpjpe = float(100.0 * scored.mpjpe[tracked].mean())
            add("position error without held frames", mpjpe, "{:.2f} cm")
    live = scored.live
    add("latency, median", live["latency_p50_ms"], "{:.1f} ms")
    add("latency, 99 %", live["latency_p99_ms"], "{:.1f} ms")
    share = 100.0 * counters.late_frames / max(counters.frames, 1)
    table.add_row("late frames", f"{counters.late_frames} of {counters.frames} ({share:.2f} %)")
    table.add_row("dropped samples", str(live["dropped_samples"]))
    for name, count in (
        ("frames that never came", counters.missing_frames),
        ("frames without any tracker", counters.blind_frames),
        ("frames given up", counters.failed_frames),
        ("frames with an earlier pose held", counters.held_frames),
        ("bodies found anew while playing", counters.reacquired_frames),
        ("failures of listeners", counters.sink_errors),
    ):
        if count:
            table.add_row(name, str(count))
    return table
