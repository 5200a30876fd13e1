"""Graphs over the last seconds, with ImPlot."""

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
from jaxtyping import Float
from mujoco.studio.dear_imgui import dear_imgui as imgui
from mujoco.studio.implot import implot
from numpy import ndarray

_SECONDS: Final = 10.0
_POINTS: Final = 100  # of each line; more cannot be told apart in so narrow a graph

_PLAIN: Final = (
    int(implot.Flags.NoMouseText) | int(implot.Flags.NoMenus) | int(implot.Flags.NoBoxSelect)
)


def plot(
    title: str,
    unit: str,
    ages: Float[ndarray, " n"],
    lines: Mapping[str, Float[ndarray, " n"]],
    *,
    least: float,
    most: float = math.inf,
    lowest: float = 0.0,
    height: float = 84.0,
) -> None:
    """Lines over the last ten seconds.

    Args:
        title: unique among the plots.
        unit: of the values, for the axis.
        ages: before the newest, at most 0 [s].
        lines: values by name; NaN leaves a gap.
        least: the axis reaches at least so far up,
        most: and no farther than this.
        lowest: where the axis begins.
        height: in pixels.
    """
    known = [values[np.isfinite(values)] for values in lines.values()]
    highest = max((float(values.max()) for values in known if values.size), default=least)
    flags = _PLAIN if len(lines) > 1 else _PLAIN | int(implot.Flags.NoLegend)
    imgui.TextDisabled(f"{title} [{unit}]" if unit else title)
    if not implot.BeginPlot(f"##{title}", imgui.Vec2(-1.0, height), flags):
        return
    lock = implot.AxisFlags.NoHighlight
    implot.SetupAxes("", "", lock, lock)
    top = min(most, max(least, 1.1 * highest))
    always = implot.Cond.Always
    implot.SetupAxisLimits(implot.Axis.X1, -_SECONDS, 0.0, always)
    implot.SetupAxisLimits(implot.Axis.Y1, lowest, top, always)
    implot.SetupLegend(implot.Location.East, implot.LegendFlags.Outside)
    # Counted from the newest, so that the points do not swim along the line.
    every = max(1, -(-len(ages) // _POINTS))
    times = ages[::-every][::-1].tolist()
    for name, values in lines.items():
        if len(times) > 1:
            implot.PlotLine(name, times, values[::-every][::-1].tolist())
    implot.EndPlot()
