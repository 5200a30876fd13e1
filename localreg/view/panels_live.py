"""Panels of live runs: the take, the trackers, the timing, and what the prior leans on."""

import math
from typing import Final

import numpy as np
from mujoco.studio.dear_imgui import dear_imgui as imgui

from localreg.view.moment import TrackerMoment
from localreg.view.panels import Desk, Panel
from localreg.view.panels_plots import plot
from localreg.view.source import Command

GOOD: Final = imgui.Vec4(0.35, 0.80, 0.45, 1.0)
"""Color of what is as it should be."""

BAD: Final = imgui.Vec4(0.95, 0.45, 0.25, 1.0)
"""Color of what is not."""

_OLD: Final = 0.1  # age of a report that is no longer fresh [s]
_FAR: Final = 0.03  # distance of a tracker from the body that is worth a color [m]
_LABELS: Final[dict[Command, str]] = {
    "record": "record",
    "mark": "mark",
    "recenter": "recenter",
    "export": "export take",
}
_HINTS: Final[dict[Command, str]] = {
    "record": "Begin or end a motion file of what is shown.",
    "mark": "Write down that something happened at this moment.",
    "recenter": "Make this place the origin and this heading ahead.",
    "export": "Write the whole run so far to a motion file.",
}


class TakePanel(Panel):
    """What is being shown, and the buttons of a live run."""

    title = "Take"
    is_open = True

    def is_wanted(self, desk: Desk) -> bool:
        """Whether anything can be asked of the source."""
        return bool(desk.source.commands)

    def draw(self, desk: Desk) -> None:
        """A line on what is shown, the buttons, and what came of the last."""
        source, moment = desk.source, desk.moment
        if moment is not None:
            imgui.TextUnformatted(f"{moment.title}  frame {moment.index}".strip())
            if moment.is_held:
                imgui.SameLine()
                imgui.TextColored(BAD, "held")
        for number, name in enumerate(source.commands):
            if number:
                imgui.SameLine()
            recording = name == "record" and source.is_recording
            if imgui.Button("stop recording" if recording else _LABELS[name]):
                source.command(name)
            imgui.SetItemTooltip(_HINTS[name])
        if source.note:
            imgui.TextWrapped(source.note)


class TrackersPanel(Panel):
    """One row a tracker, and their distances from the body over time."""

    title = "Trackers"
    is_open = True

    def is_wanted(self, desk: Desk) -> bool:
        """Whether the body wears any."""
        return bool(desk.source.subject.trackers)

    def draw(self, desk: Desk) -> None:
        """The table and the plot."""
        moment = desk.moment
        trackers = () if moment is None else moment.trackers
        if not trackers:
            imgui.TextDisabled("no tracker is reported")
            return
        heads = ("tracker", "Hz", "age ms", "off mm", "off deg", "status")
        flags = int(imgui.TableFlags.RowBg) | int(imgui.TableFlags.SizingStretchProp)
        if imgui.BeginTable("trackers", len(heads), flags):
            for head in heads:
                imgui.TableSetupColumn(head)
            imgui.TableHeadersRow()
            for tracker in trackers:
                _row(tracker)
            imgui.EndTable()
        history = desk.history
        lines = dict(zip((t.name for t in trackers), 1e3 * history.distances.T, strict=True))
        plot("distance from the body", "mm", history.ages, lines, least=20.0, most=150.0)


class TimingPanel(Panel):
    """How the loop keeps up."""

    title = "Timing"
    is_open = True

    def is_wanted(self, desk: Desk) -> bool:
        """Whether there is a loop."""
        return desk.source.transport is None

    def draw(self, desk: Desk) -> None:
        """Percentiles, late frames, and the percentiles over time."""
        timing = None if desk.moment is None else desk.moment.timing
        if timing is None:
            imgui.TextDisabled("not yet known")
            return
        imgui.TextUnformatted(
            f"latency  p50 {_ms(timing.p50)}  p99 {_ms(timing.p99)} ms\n"
            f"compute  p50 {_ms(timing.compute_p50)}  p99 {_ms(timing.compute_p99)} ms"
        )
        share = 100.0 * timing.late_frames / max(1, timing.frames)
        color = GOOD if share < 1.0 else BAD
        imgui.TextColored(color, f"late {timing.late_frames} of {timing.frames} ({share:.2f} %)")
        history = desk.history
        p50, p99 = 1e3 * history.latency.T
        lines = {"p50": p50, "p99": p99}
        plot("latency", "ms", history.ages, lines, least=25.0, most=250.0)


class PriorPanel(Panel):
    """How far the database explains what is seen, and which of its clips are nearest."""

    title = "Prior"
    is_open = True

    def is_wanted(self, desk: Desk) -> bool:
        """Whether there is a database."""
        return desk.source.transport is None

    def draw(self, desk: Desk) -> None:
        """Confidence as a bar, the clips as a table, and confidence over time."""
        moment = desk.moment
        if moment is None or math.isnan(moment.confidence):
            imgui.TextDisabled("confidence not known")
        else:
            imgui.ProgressBar(
                moment.confidence, imgui.Vec2(-1.0, 0.0), f"confidence {moment.confidence:.2f}"
            )
        neighbors = () if moment is None else moment.neighbors
        if neighbors and imgui.BeginTable("clips", 3, imgui.TableFlags.SizingStretchProp):
            for head in ("nearest clips", "activity", "share"):
                imgui.TableSetupColumn(head)
            imgui.TableHeadersRow()
            for clip in neighbors:
                imgui.TableNextRow()
                for text in (clip.name, clip.activity or "-", f"{100.0 * clip.share:.0f} %"):
                    imgui.TableNextColumn()
                    imgui.TextUnformatted(text)
            imgui.EndTable()
        history = desk.history
        lines = {"confidence": history.confidence}
        plot("confidence", "", history.ages, lines, least=1.0, most=1.0, height=60.0)


def _row(tracker: TrackerMoment) -> None:
    imgui.TableNextRow()
    is_stale = not np.isnan(tracker.age) and tracker.age > _OLD
    cells = (
        (tracker.name, None),
        (_figure(tracker.rate, ".0f"), None),
        (_figure(1e3 * tracker.age, ".0f"), BAD if is_stale else None),
        (_figure(1e3 * tracker.distance, ".1f"), BAD if tracker.distance > _FAR else None),
        (_figure(math.degrees(tracker.angle), ".1f"), None),
        (tracker.status, BAD if tracker.is_masked else GOOD),
    )
    for text, color in cells:
        imgui.TableNextColumn()
        if color is None:
            imgui.TextUnformatted(text)
        else:
            imgui.TextColored(color, text)


def _figure(value: float, form: str) -> str:
    return "-" if math.isnan(value) else format(value, form)


def _ms(seconds: float) -> str:
    return _figure(1e3 * seconds, ".1f")
