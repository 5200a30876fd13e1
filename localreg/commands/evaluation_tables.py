"""The results of an evaluation as tables for people."""

import math
from dataclasses import astuple
from typing import Final

from localreg.commands.grids import Grid
from localreg.evaluation.metrics import FIGURES, Figures, mean_figures
from localreg.evaluation.results import Evaluation
from localreg.evaluation.robustness import Growth
from localreg.evaluation.statistics import LEVEL, Difference
from localreg.evaluation.summaries import (
    COMPARED,
    RIVALS,
    badness,
    by_activity,
    by_joint,
    difference,
    extras,
    worse_than,
)

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
_FEW: Final = 12
_PLACELESS: Final = (
    "(orientations alone do not say where in the room the body is: look at the root-aligned MPJPE)"
)


def mean_table(evaluation: Evaluation) -> Grid:
    """Means over clips by method and signals; the last row has the truth's own figures."""
    clips = len({clip.name for clip in evaluation.clips})
    table = _table("method", "signals", title=f"Means over {clips} clips")
    for method, kinds in evaluation.means().items():
        for signals, figures in kinds.items():
            table.add_row(method, signals, *_cells(figures))
        table.add_section()
    one = evaluation.clips[0]
    same = [c.comparison for c in evaluation.of(one.method, one.signals)]
    truth = mean_figures(
        [Figures(jitter_m_s3=c.true_jitter_m_s3, foot_skate_cm_s=c.true_foot_skate_cm_s)
         for c in same]
    )  # fmt: skip
    table.add_row("(truth)", "", *_cells(truth))
    if any(clip.signals == "orientation" for clip in evaluation.clips):
        table.caption = _PLACELESS
    return table


def worst_table(evaluation: Evaluation) -> Grid:
    """The clips with the greatest joint angle errors, by method and signals."""
    table = _table("method", "signals", "worst clips", title="Worst clips")
    for method, kinds in evaluation.means().items():
        for signals in kinds:
            clips = evaluation.of(method, signals)
            clips.sort(key=lambda clip: badness(clip.figures), reverse=True)
            for clip in clips[:_WORST]:
                table.add_row(method, signals, clip.name, *_cells(clip.figures))
            table.add_section()
    return table


def clip_table(evaluation: Evaluation) -> Grid:
    """Every clip with every method and kind of signals."""
    table = _table("clip", "frames", "method", "signals", title="Clips")
    for clip in sorted(evaluation.clips, key=lambda clip: clip.name):
        table.add_row(clip.name, str(clip.frames), clip.method, clip.signals, *_cells(clip.figures))
    return table


def activity_table(evaluation: Evaluation) -> Grid:
    """Means by what is done in the clips."""
    table = _table("activity", "clips", "method", "signals", title="Activities")
    rows: dict[str, list[tuple[str, ...]]] = {}
    for method, kinds in evaluation.means().items():
        for signals in kinds:
            for activity, clips in by_activity(evaluation, method, signals).items():
                figures = mean_figures([clip.figures for clip in clips])
                rows.setdefault(activity, []).append(
                    (activity, str(len(clips)), method, signals, *_cells(figures))
                )
    for activity in sorted(rows):
        for row in rows[activity]:
            table.add_row(*row)
        table.add_section()
    return table


def joint_table(evaluation: Evaluation) -> Grid:
    """Turn errors of every bone, one column for every method and kind of signals."""
    columns = [
        (method, signals) for method, kinds in evaluation.means().items() for signals in kinds
    ]
    table = Grid("Bone turns [deg]", ["bone", *("\n".join(column) for column in columns)])
    errors = [by_joint(evaluation.of(*column))["geodesic_error_deg"] for column in columns]
    for bone in errors[0]:
        table.add_row(bone, *(_cell(error[bone]) for error in errors))
    return table


def difference_table(evaluation: Evaluation) -> Grid:
    """The first method against every other, with paired bootstrap intervals over clips."""
    first = evaluation.methods[0]
    table = Grid(
        f"Differences and their {LEVEL:.0%} intervals (* excludes zero)",
        [f"{first} minus", "signals", *(_TITLES[figure] for figure in COMPARED)],
        left=2,
    )
    for method, kinds in evaluation.means().items():
        if method == first:
            continue
        for signals in kinds:
            cells = [
                _interval(difference(evaluation, first, method, signals, figure))
                for figure in COMPARED
            ]
            table.add_row(method, signals, *cells)
        table.add_section()
    return table


def more_table(evaluation: Evaluation) -> Grid:
    """Calibration, jitter and skate against the truth's, recovery, and time a frame."""
    table = Grid(
        "Calibration, smoothness, time",
        ["method", "signals", "error / predicted\ndeviation", "jitter /\ntruth's",
         "foot skate -\ntruth's [cm/s]", "back after\na gap [s]", "frame, median\n[ms]",
         "99 %\n[ms]", "frames/s"],
        left=2,
    )  # fmt: skip
    timing = evaluation.timing()
    for method, kinds in evaluation.means().items():
        for signals in kinds:
            found = extras(evaluation.of(method, signals))
            table.add_row(
                method, signals, _cell(found.standardized_error), _cell(found.jitter_ratio),
                _cell(found.foot_skate_excess_cm_s), _cell(found.recovery_s),
                _cell(timing[method].p50_ms), _cell(timing[method].p99_ms),
                _cell(timing[method].frames_per_s),
            )  # fmt: skip
    return table


def growth_table(growths: list[Growth]) -> Grid:
    """What disturbances cost."""
    table = Grid(
        "Disturbances",
        ["disturbance", "method", "signals", "clips", "MPJPE [cm]\nwithout", "MPJPE [cm]\nwith",
         "growth\n[%]", "joint angle [deg]\nwithout", "joint angle [deg]\nwith", "growth\n[%]",
         "MPJPE [cm]\nworst frame"],
        left=3,
    )  # fmt: skip
    for growth in growths:
        table.add_row(
            growth.disturbance, growth.method, growth.signals, str(growth.clips),
            _cell(growth.undisturbed_mpjpe_cm), _cell(growth.disturbed_mpjpe_cm),
            f"{100 * growth.mpjpe_growth:+.1f}",
            _cell(growth.undisturbed_angle_deg), _cell(growth.disturbed_angle_deg),
            f"{100 * growth.angle_growth:+.1f}",
            _cell(growth.worst_frame_cm),
        )  # fmt: skip
    return table


def recovery_table(growths: list[Growth]) -> Grid:
    """How soon all is well again, of disturbances that end."""
    table = Grid(
        "Frames until the MPJPE is within 110 % of the undisturbed",
        ["disturbance", "method", "signals", "clips", "mean\nover clips", "half of\nclips",
         "90 %\nof clips", "slowest\nclip"],
        left=3,
    )  # fmt: skip
    for growth in growths:
        if growth.recovery is not None:
            frames = (str(value) for value in astuple(growth.recovery))
            table.add_row(
                growth.disturbance, growth.method, growth.signals, str(growth.clips), *frames
            )
    return table


def worse_lines(evaluation: Evaluation) -> list[str]:
    """For every method, on which clips inverse kinematics is better, cold or given the truth."""
    lines = []
    for method, kinds in evaluation.means().items():
        for rival in RIVALS if method not in RIVALS else ():
            for signals in kinds:
                clips = evaluation.of(method, signals)
                if rival not in evaluation.methods:
                    continue
                worse = worse_than(evaluation, method, rival, signals)
                worse.sort(key=lambda entry: entry[1] - entry[2], reverse=True)
                names = [f"{name} ({own:.1f} > {its:.1f})" for name, own, its in worse[:_FEW]]
                if len(worse) > _FEW:
                    names.append(f"and {len(worse) - _FEW} more")
                lines.append(
                    f"{method}, {signals}: joint angles worse than {rival}'s on "
                    f"{len(worse)} of {len(clips)} clips" + (": " if names else "")
                    + ", ".join(names)
                )  # fmt: skip
    return lines


def _table(*first: str, title: str) -> Grid:
    return Grid(title, [*first, *(_TITLES[name] for name in FIGURES)], len(first))


def _cells(figures: Figures) -> list[str]:
    return [_cell(getattr(figures, name)) for name in FIGURES]


def _cell(value: float | None) -> str:
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:.2f}" if value < 100 else f"{value:.0f}"


def _interval(found: Difference) -> str:
    if found.mean is None or found.low is None or found.high is None:
        return _cell(found.mean)
    mark = " *" if found.is_sure else ""
    return f"{found.mean:+.2f} [{found.low:+.2f}, {found.high:+.2f}]{mark}"
