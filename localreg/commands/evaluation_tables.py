"""The results of an evaluation as tables for people."""

import math
from typing import Final

import numpy as np
from rich.table import Table

from localreg.evaluation.metrics import FIGURES, Figures
from localreg.evaluation.results import Evaluation

_TITLES: Final = {
    "joint_angle_error_deg": "joint angle\n[deg]",
    "geodesic_error_deg": "bone turn\n[deg]",
    "mpjpe_cm": "MPJPE\n[cm]",
    "mpjpe_root_aligned_cm": "MPJPE, root\naligned [cm]",
    "tracker_error_cm": "tracker\n[cm]",
    "jitter_m_s3": "jitter\n[m/s^3]",
    "foot_skate_cm_s": "foot skate\n[cm/s]",
}
_WORST: Final = 3
_IK: Final = "ik"


def mean_table(evaluation: Evaluation) -> Table:
    """Means over clips by method and signals; the last row has the truth's own figures."""
    clips = len({clip.name for clip in evaluation.clips})
    table = _table("method", "signals", title=f"Means over {clips} clips")
    for method, kinds in evaluation.means().items():
        for signals, figures in kinds.items():
            table.add_row(method, signals, *_cells(figures))
        table.add_section()
    one = evaluation.clips[0]
    same = [c.comparison for c in evaluation.of(one.method, one.signals)]
    truth = Figures(
        jitter_m_s3=_mean([c.true_jitter_m_s3 for c in same]),
        foot_skate_cm_s=_mean([c.true_foot_skate_cm_s for c in same]),
    )
    table.add_row("(truth)", "", *_cells(truth))
    return table


def worst_table(evaluation: Evaluation) -> Table:
    """The clips with the greatest joint angle errors, by method and signals."""
    table = _table("method", "signals", "worst clips", title="Worst clips")
    for method, kinds in evaluation.means().items():
        for signals in kinds:
            clips = evaluation.of(method, signals)
            clips.sort(key=lambda clip: _badness(clip.figures), reverse=True)
            for clip in clips[:_WORST]:
                table.add_row(method, signals, clip.name, *_cells(clip.figures))
            table.add_section()
    return table


def clip_table(evaluation: Evaluation) -> Table:
    """Every clip with every method and kind of signals."""
    table = _table("clip", "frames", "method", "signals", title="Clips")
    for clip in sorted(evaluation.clips, key=lambda clip: clip.name):
        table.add_row(clip.name, str(clip.frames), clip.method, clip.signals, *_cells(clip.figures))
    return table


def timing_table(evaluation: Evaluation) -> Table:
    """How long a frame takes, by method."""
    table = Table("method", "median [ms]", "99th percentile [ms]", "frames/s", title="Timing")
    for column in table.columns[1:]:
        column.justify = "right"
    for method, timing in evaluation.timing().items():
        table.add_row(
            method, _cell(timing.p50_ms), _cell(timing.p99_ms), _cell(timing.frames_per_s)
        )
    return table


def worse_than_ik(evaluation: Evaluation) -> list[str]:
    """For every method and kind of signals, on which clips inverse kinematics is better."""
    lines = []
    for method, kinds in evaluation.means().items():
        for signals in kinds if method != _IK else ():
            clips = evaluation.of(method, signals)
            rivals = {clip.name: clip for clip in evaluation.of(_IK, signals)}
            worse = [
                clip.name
                for clip in clips
                if clip.name in rivals
                and _badness(clip.figures) > _badness(rivals[clip.name].figures)
            ]
            if rivals:
                names = f": {', '.join(worse)}" if worse else ""
                lines.append(
                    f"{method}, {signals}: joint angles worse than {_IK}'s on "
                    f"{len(worse)} of {len(clips)} clips{names}"
                )
    return lines


def _table(*first: str, title: str) -> Table:
    table = Table(*first, title=title)
    for name in FIGURES:
        table.add_column(_TITLES[name], justify="right")
    return table


def _cells(figures: Figures) -> list[str]:
    return [_cell(getattr(figures, name)) for name in FIGURES]


def _cell(value: float | None) -> str:
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:.2f}" if value < 100 else f"{value:.0f}"


def _badness(figures: Figures) -> float:
    value = figures.joint_angle_error_deg
    return math.inf if value is None or math.isnan(value) else value


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
