"""The report of an evaluation: one web page that needs nothing but itself."""

import base64
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import Final

import numpy as np

from localreg.commands import evaluation_tables as tables
from localreg.commands.grids import Grid
from localreg.database import PoseDatabase
from localreg.drawing.filmstrip import filmstrip
from localreg.errors import LocalregError
from localreg.evaluation import figures
from localreg.evaluation.execution import Run
from localreg.evaluation.leave_one_out import Progress
from localreg.evaluation.metrics import SETTLING_FRAMES
from localreg.evaluation.protocol import Protocol
from localreg.evaluation.results import ClipResult, Evaluation
from localreg.evaluation.summaries import badness
from localreg.evaluation.sweeps import Series, plan_series, run_series, some_clips
from localreg.motion.motion import Motion

NAME: Final = "report.html"
"""Name of the page in the folder that is asked for."""

_FILM_SECONDS: Final = 12.0  # of a clip in a filmstrip; a long one would show nothing

_STYLE: Final = """
body { font: 15px/1.5 system-ui, sans-serif; color: #2b2d31; max-width: 1180px;
  margin: 2rem auto; padding: 0 1rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.25rem; margin-top: 2.5rem; }
h3 { font-size: 1rem; margin-bottom: .4rem; }
img { max-width: 100%; height: auto; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .85rem; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .7rem; text-align: right; vertical-align: bottom; white-space: nowrap; }
.word { text-align: left; }
thead th { border-bottom: 1px solid #2b2d31; font-weight: 600; }
tbody + tbody tr:first-child td { border-top: 1px solid #e4e2de; }
.remark { color: #6d7077; font-size: .85rem; }
li { margin: .2rem 0; }
summary { cursor: pointer; color: #0072b2; }
"""


@dataclass(frozen=True)
class _Part:
    """A heading with what stands under it, as HTML."""

    title: str
    body: str


def write_report(
    folder: Path,
    evaluation: Evaluation,
    motions: Sequence[Motion],
    database: PoseDatabase,
    protocol: Protocol,
    run: Run,
    *,
    progress: Progress | None = None,
) -> Path:
    """Run the series of the report and write the page.

    Args:
        folder: where; made if need be.
        evaluation: whose results kept their poses.
        motions: the clips of the evaluation.
        database: what the methods learned from.
        protocol: of the evaluation.
        run: where to run trials.
        progress: is told after every clip of the series.

    Returns:
        The page.

    Raises:
        LocalregError: it cannot be written.
    """
    trackers = protocol.trackers or motions[0].subject.trackers
    series = plan_series(protocol, trackers, database)
    clips = some_clips(motions)
    curves = run_series(series, clips, database, run, progress=progress)
    seconds = _seconds(series[0].points[0].protocol.max_frames, database.rate)
    remark = (
        f"{len(clips)} clips, evenly spread over the source, the first {seconds:.1f} s of each; "
        f"signals: {protocol.signals[0]}. -squares has plain squares for the Lorentzian."
    )
    drawn = [
        f"<h3>{escape(one.name)}</h3>"
        + _image(figures.series_curves(one, found), f"Errors along {one.name.lower()}")
        for one, found in zip(series, curves, strict=True)
    ]
    page = _page(
        "Evaluation",
        [
            _Part("What was evaluated", _conditions(evaluation)),
            _Part("Means", _grid(tables.mean_table(evaluation)) + _differences(evaluation)),
            _Part("By activity", _activities(evaluation)),
            _Part("Where it is worse than inverse kinematics", _worse(evaluation)),
            _Part("Over time", _over_time(evaluation)),
            _Part("Best, median and worst clip", _films(evaluation, motions)),
            _Part("By bone", _bones(evaluation)),
            _Part("Robustness and database size", f"<p>{escape(remark)}</p>" + "".join(drawn)
                  + _folded("The same in numbers", _series_table(series, curves))),
            _Part("Calibration, smoothness, time", _grid(tables.more_table(evaluation))),
            _Part("Every clip", _folded("Show them", _grid(tables.clip_table(evaluation)))),
        ],
    )  # fmt: skip
    path = folder / NAME
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise LocalregError(f"cannot write {path}: {reason}; choose another folder") from error
    return path


def _conditions(evaluation: Evaluation) -> str:
    settings = evaluation.settings
    clips = {clip.name: clip.frames for clip in evaluation.clips}
    facts = [
        f"{len(clips)} clips, {sum(clips.values())} frames at {settings.rate_hz:g} Hz; the first "
        f"{SETTLING_FRAMES} frames of each do not count",
        f"start: {settings.start}; trained on: {settings.database}",
        f"noise: {1e3 * settings.noise_position_m:g} mm on each axis, "
        f"{settings.noise_orientation_deg:g} degrees; seed {settings.seed}",
        f"methods: {', '.join(evaluation.methods)}; names ending in -truth are given the true "
        "first pose",
        f"localreg-mocap {settings.version}",
    ]
    unusual = {
        name: value
        for name, value in evaluation.conditions.items()
        if value and name not in ("leave_out", "database_share", *_USUAL)
    }
    if unusual:
        facts.append(", ".join(f"{name}: {value}" for name, value in unusual.items()))
    return "<ul>" + "".join(f"<li>{escape(fact)}</li>" for fact in facts) + "</ul>"


_USUAL: Final = ("outlier_position", "outlier_orientation_deg", "dropout_seconds")


def _differences(evaluation: Evaluation) -> str:
    return _grid(tables.difference_table(evaluation)) if len(evaluation.methods) > 1 else ""


def _activities(evaluation: Evaluation) -> str:
    bars = [
        figures.activity_bars(evaluation, "joint_angle_error_deg", "joint angle error [deg]"),
        figures.activity_bars(evaluation, "mpjpe_root_aligned_cm", "root-aligned MPJPE [cm]"),
    ]
    return (
        "<p>Bars: means over clips; lines: one standard deviation up and down.</p>"
        + "".join(_image(bar, "Errors by activity, method and signals") for bar in bars)
        + _grid(tables.activity_table(evaluation))
    )


def _worse(evaluation: Evaluation) -> str:
    lines = tables.worse_lines(evaluation)
    if not lines:
        return "<p>Inverse kinematics (ik, ik-truth) was not among the methods.</p>"
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"


def _over_time(evaluation: Evaluation) -> str:
    signals = evaluation.clips[0].signals
    median = _ranked(evaluation)[1][1]
    clips = [
        clip
        for method in evaluation.methods
        for clip in evaluation.of(method, signals)
        if clip.name == median.name
    ]
    picture = figures.error_over_time(clips, evaluation.settings.rate_hz)
    return "<p>The median clip, frame by frame.</p>" + _image(picture, "Errors frame by frame")


def _bones(evaluation: Evaluation) -> str:
    methods = evaluation.methods[:3]
    picture = figures.bone_bars(evaluation, methods, evaluation.clips[0].signals)
    return _image(picture, "Turn errors by bone") + _folded(
        "The same in numbers", _grid(tables.joint_table(evaluation))
    )


def _films(evaluation: Evaluation, motions: Sequence[Motion]) -> str:
    """Filmstrips of the first method with the first kind of signals."""
    originals = {motion.provenance.name: motion for motion in motions}
    rate = evaluation.settings.rate_hz
    parts = []
    with tempfile.TemporaryDirectory(prefix="localreg-") as folder:
        for word, clip in _ranked(evaluation):
            if clip.qpos is None or not np.isfinite(clip.qpos).all():
                continue
            shown = slice(min(clip.frames, round(_FILM_SECONDS * rate)))
            truth = originals[clip.name].resampled(rate).first(clip.frames)
            truth = replace(truth, qpos=truth.qpos[shown])
            qpos = clip.qpos[shown].astype(float)
            qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
            picture = Path(folder) / "film.png"
            filmstrip(
                truth,
                replace(truth, qpos=qpos),
                picture,
                mpjpe=_counted(0.01 * clip.comparison.mpjpe_cm)[shown],
                angle_error=_counted(np.radians(clip.comparison.joint_angle_error_deg))[shown],
                title=f"{word}: {clip.name}, {clip.method}, {clip.signals}",
                width=1500,
            )
            parts.append(_image(picture.read_bytes(), f"Filmstrip of the {word} clip"))
    return "<p>Truth above, synthesis below.</p>" + "".join(parts)


def _counted(error: np.ndarray) -> np.ndarray:
    error = error.copy()
    error[:SETTLING_FRAMES] = np.nan
    return error


def _ranked(evaluation: Evaluation) -> list[tuple[str, ClipResult]]:
    """The first method's best, median and worst clip; fewer where there are fewer clips."""
    first = evaluation.clips[0]
    clips = sorted(
        evaluation.of(first.method, first.signals), key=lambda clip: badness(clip.figures)
    )
    places = {"best": 0, "median": len(clips) // 2, "worst": len(clips) - 1}
    if len(clips) < len(places):
        return [("best", clips[0]), ("worst", clips[-1])][: max(2, len(clips))]
    return [(word, clips[place]) for word, place in places.items()]


def _series_table(series: Sequence[Series], curves: Sequence[Sequence[figures.Curve]]) -> str:
    grid = Grid(
        "Means over the clips of the series",
        ["series", "at", "method", "joint angle\n[deg]", "MPJPE\n[cm]"],
        3,
    )
    for one, found in zip(series, curves, strict=True):
        for curve in found:
            for point, angle, distance in zip(
                one.points, curve.angle_deg, curve.mpjpe_cm, strict=True
            ):
                grid.add_row(one.name, point.label, curve.method, f"{angle:.2f}", f"{distance:.2f}")
        grid.add_section()
    return _grid(grid)


def _seconds(frames: int | None, rate: float) -> float:
    return 0.0 if frames is None else frames / rate


def _grid(grid: Grid) -> str:
    return grid.to_html()


def _folded(words: str, body: str) -> str:
    """What few want to see, behind a line to click."""
    return f"<details><summary>{escape(words)}</summary>{body}</details>"


def _image(png: bytes, words: str) -> str:
    data = base64.b64encode(png).decode("ascii")
    return f'<p><img alt="{escape(words)}" src="data:image/png;base64,{data}"></p>'


def _page(title: str, parts: Sequence[_Part]) -> str:
    body = "".join(f"<h2>{escape(part.title)}</h2>{part.body}" for part in parts)
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width">'
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head>"
        f"<body><h1>{escape(title)}</h1>{body}</body></html>\n"
    )
