"""The figures of a report: errors by activity, over time, by bone, and along series."""

from collections.abc import Sequence
from io import BytesIO
from textwrap import wrap
from typing import Any, Final

import numpy as np
from jaxtyping import Float
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from numpy import ndarray

from localreg.evaluation.metrics import SETTLING_FRAMES
from localreg.evaluation.results import ClipResult, Evaluation
from localreg.evaluation.summaries import by_joint, by_kind
from localreg.evaluation.sweeps import Curve, Series
from localreg.evaluation.variants import SQUARES

_INK, _SOFT, _GRID = "#2b2d31", "#6d7077", "#e4e2de"
# Colors that the color-blind can tell apart (Okabe and Ito); grays for inverse kinematics.
_COLORS: Final = {
    "localreg": "#0072b2", "paper": "#d55e00", "joint": "#cc79a7", "lpcr": "#e69f00",
    "lpca": "#009e73", "ik": "#77797d", "ik-truth": "#b9bbc0",
}  # fmt: skip
_OTHERS: Final = ("#56b4e9", "#8a5a44", "#b8a900", "#444444")
_DPI: Final = 130
_MOST_ACTIVITIES: Final = 8
_LABEL_WIDTH: Final = 15  # characters
_MOST_IN_A_LINE: Final = 8


def activity_bars(evaluation: Evaluation, figure: str, label: str) -> bytes:
    """Means and deviations over clips, by activity, method and signals, as the papers do it.

    Args:
        evaluation: what to show.
        figure: name of the figure, as in `Figures`.
        label: of the axis, with its unit.

    Returns:
        A PNG, as all figures here.
    """
    kinds = list(dict.fromkeys(clip.signals for clip in evaluation.clips))
    sheet = _sheet(11.0, 3.1 * len(kinds))
    for row, signals in enumerate(kinds, start=1):
        axes = sheet.add_subplot(len(kinds), 1, row)
        groups = _groups(evaluation, signals)
        width = 0.8 / len(evaluation.methods)
        for index, method in enumerate(evaluation.methods):
            chosen = by_kind(evaluation, method, signals)
            everything = evaluation.of(method, signals)
            values = [_values(chosen.get(name, everything), figure) for name in groups]
            place = np.arange(len(groups)) + (index - 0.5 * (len(evaluation.methods) - 1)) * width
            means = np.array([v.mean() if v.size else np.nan for v in values])
            spread = np.array([v.std() if v.size else 0.0 for v in values])
            below = np.minimum(spread, means)
            axes.bar(place, means, 0.92 * width, color=color(method), label=method)
            several = np.array([v.size > 1 for v in values])  # one clip has no deviation
            axes.errorbar(
                place[several], means[several], yerr=[below[several], spread[several]],
                fmt="none", ecolor=_SOFT, capsize=2, linewidth=0.8,
            )  # fmt: skip
        names = [f"{_wrapped(name)}\n({_count(evaluation, signals, name)})" for name in groups]
        axes.set_xticks(np.arange(len(groups)), names)
        axes.set_ylabel(label, color=_INK)
        axes.set_title(f"signals: {signals}", loc="left", fontsize=10, color=_INK)
        _tidy(axes)
    _legend(sheet)
    return _png(sheet)


def error_over_time(clips: Sequence[ClipResult], rate: float) -> bytes:
    """Joint angle error and MPJPE of one clip frame by frame, one line a method.

    Args:
        clips: the same clip by several methods.
        rate: frames a second [Hz].
    """
    sheet = _sheet(11.0, 4.8)
    for row, (field, label) in enumerate(
        (("joint_angle_error_deg", "joint angle error [deg]"), ("mpjpe_cm", "MPJPE [cm]")), start=1
    ):
        axes = sheet.add_subplot(2, 1, row)
        for clip in clips:
            error = getattr(clip.comparison, field)
            axes.plot(np.arange(len(error)) / rate, error, color=color(clip.method),
                      linewidth=1.4, label=clip.method)  # fmt: skip
        axes.axvspan(0.0, SETTLING_FRAMES / rate, color=_GRID, linewidth=0)
        axes.set_ylabel(label, color=_INK)
        axes.set_ylim(bottom=0.0)
        axes.set_xlim(left=0.0)
        _tidy(axes)
    sheet.axes[0].set_title(
        f"{clips[0].name}, {clips[0].activity or 'unknown activity'}, {clips[0].signals}; "
        "the shaded frames do not count",
        loc="left", fontsize=10, color=_INK,
    )  # fmt: skip
    _legend(sheet)
    sheet.axes[1].set_xlabel("time [s]", color=_INK)
    return _png(sheet)


def bone_bars(evaluation: Evaluation, methods: Sequence[str], signals: str) -> bytes:
    """Turn errors of every bone, side by side for a few methods."""
    sheet = _sheet(11.0, 3.6)
    axes = sheet.add_subplot()
    width = 0.8 / len(methods)
    bones: list[str] = []
    for index, method in enumerate(methods):
        errors = by_joint(evaluation.of(method, signals))["geodesic_error_deg"]
        bones = list(errors)
        place = np.arange(len(bones)) + (index - 0.5 * (len(methods) - 1)) * width
        axes.bar(place, list(errors.values()), 0.92 * width, color=color(method), label=method)
    axes.set_xticks(np.arange(len(bones)), bones, rotation=60, ha="right")
    axes.set_ylabel("bone turn error [deg]", color=_INK)
    _legend(sheet)
    _tidy(axes)
    return _png(sheet)


def series_curves(series: Series, curves: Sequence[Curve]) -> bytes:
    """Errors along a series: joint angles on the left, positions on the right."""
    sheet = _sheet(11.0, 3.7 if series.is_measure else 4.4)
    sides = (("angle_deg", "joint angle error [deg]"), ("mpjpe_cm", "MPJPE [cm]"))
    for column, (field, label) in enumerate(sides, start=1):
        axes = sheet.add_subplot(1, 2, column)
        values: list[Float[ndarray, " points"]] = []
        for number, curve in enumerate(curves):
            error = getattr(curve, field)
            values.append(error)
            style = "--" if curve.method.endswith(SQUARES) else "-"
            # Places without a measure have nothing between them.
            style = style if series.is_measure else "none"
            place = [point.value for point in series.points]
            axes.plot(place, error, linestyle=style, marker="o", markersize=4.5,
                      color=color(curve.method, number), label=curve.method)  # fmt: skip
        if series.is_logarithmic:
            axes.set_xscale("log")
            axes.xaxis.set_minor_locator(NullLocator())
        ticks = [point.value for point in series.points]
        axes.set_xticks(ticks, [point.label for point in series.points])
        if not series.is_measure:
            axes.tick_params(axis="x", rotation=55)
        finite = np.concatenate(values)
        finite = finite[np.isfinite(finite) & (finite > 0.0)]
        if finite.size and finite.max() > 20.0 * finite.min():
            axes.set_yscale("log")
            axes.yaxis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
            for formatted in (axes.yaxis.set_major_formatter, axes.yaxis.set_minor_formatter):
                formatted(FuncFormatter(lambda value, _: f"{value:g}"))
        else:
            axes.set_ylim(bottom=0.0)
        axes.set_xlabel(series.axis, color=_INK)
        axes.set_ylabel(label, color=_INK)
        _tidy(axes)
    _legend(sheet)
    return _png(sheet)


def color(method: str, number: int = 0) -> str:
    """A method's color, the same in every figure; without the Lorentzian, too."""
    method = method.removesuffix(SQUARES)
    if method in _COLORS:
        return _COLORS[method]
    return _OTHERS[(len(method) + number) % len(_OTHERS)]


def _groups(evaluation: Evaluation, signals: str) -> list[str]:
    """The activities with the most clips, and `all` where there is more than one."""
    chosen = by_kind(evaluation, evaluation.methods[0], signals)
    names = sorted(chosen, key=lambda name: len(chosen[name]), reverse=True)[:_MOST_ACTIVITIES]
    return [*sorted(names), "all"] if len(chosen) > 1 else names


def _wrapped(name: str) -> str:
    """A name in a few short lines."""
    return "\n".join(wrap(name, _LABEL_WIDTH, max_lines=3, placeholder=" ..."))


def _count(evaluation: Evaluation, signals: str, name: str) -> str:
    chosen = by_kind(evaluation, evaluation.methods[0], signals)
    count = len(chosen.get(name, evaluation.of(evaluation.methods[0], signals)))
    return "1 clip" if count == 1 else f"{count} clips"


def _values(clips: Sequence[ClipResult], figure: str) -> Float[ndarray, " clips"]:
    values = [getattr(clip.figures, figure) for clip in clips]
    return np.array([v for v in values if v is not None and np.isfinite(v)], dtype=float)


def _sheet(width: float, height: float) -> Figure:
    sheet = Figure(figsize=(width, height), dpi=_DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(sheet)
    return sheet


def _legend(sheet: Figure) -> None:
    """Above everything, where it covers nothing."""
    handles, labels = sheet.axes[0].get_legend_handles_labels()
    sheet.legend(
        handles, labels, loc="outside upper right", ncols=min(len(labels), _MOST_IN_A_LINE),
        frameon=False, fontsize=8,
    )  # fmt: skip


def _tidy(axes: Any) -> None:
    axes.grid(axis="y", which="both", color=_GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(which="both", colors=_SOFT, labelsize=8, length=0)
    axes.xaxis.label.set_size(9)
    axes.yaxis.label.set_size(9)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _png(sheet: Figure) -> bytes:
    buffer = BytesIO()
    sheet.savefig(buffer, format="png")
    return buffer.getvalue()
