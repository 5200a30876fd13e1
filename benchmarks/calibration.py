"""How well calibration finds simulated people, and what that buys.

    python -m benchmarks.calibration --people 50 --skeletons DIR --json calibration.json

Every person has the lengths of a real ASF file that the eigen-skeleton has not seen, trackers
strapped on anyhow, tracker noise of 3 mm and 0.5 deg, and holds every pose with errors in all
joints. Beside the errors stands the Cramer-Rao bound (with beliefs: van Trees): what an estimate
that reaches it would show, on the mean and at worst, among as many people. Without ASF files
people are drawn from the published table.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import typer
from jaxtyping import Float
from numpy import ndarray
from rich.table import Table

from benchmarks.calibrated_synthesis import (
    motion_means,
    motion_table,
    synthesis_errors,
    synthesis_means,
    synthesis_table,
)
from benchmarks.calibration_trials import (
    USUAL,
    Condition,
    Person,
    Trial,
    conditions,
    draw_people,
    run_trial,
)
from calibration.anthropometry import NINE_BONES
from calibration.eigen_skeleton import (
    stature,
)
from calibration.fit import FitSettings
from calibration.observability import expected_deviations, information
from calibration.result import QUANTILE_90, REPORTED
from calibration.setup import true_lengths
from localreg.commands.console import notes, output, progress_bar
from localreg.evaluation.results import without_nan, write_json

PUBLISHED: Final = {"mean_percent": 1.4, "worst_percent": 5.2, "head": 4.2, "radius": 5.2}
"""Two people against an optical system, nine bones each."""

_MEAN_ABSOLUTE: Final = float(np.sqrt(2.0 / np.pi))
_DRAWS: Final = 1000


def bound(person: Person, condition: Condition) -> Float[ndarray, "9"]:
    """The least standard deviations that anybody could reach."""
    habits = condition.habits
    settings = FitSettings(
        mount_sigma=habits.mount_spread,
        pose_sigma=habits.pose_error,
        plant_sigma=habits.plant_error,
    )
    prior = person.prior
    if condition.knows_height:
        prior = prior.at_stature(stature(person.lengths))
    told, believed = information(
        condition.poses,
        prior,
        settings=settings,
        position_sd=habits.noise_position / np.sqrt(habits.frames),
        orientation_sd=habits.noise_orientation / np.sqrt(habits.frames),
    )
    return expected_deviations(believed + told.sum(axis=0), prior)


def summarize(
    condition: Condition, trials: Sequence[Trial], bounds: Float[ndarray, "n 9"]
) -> dict[str, Any]:
    """The figures of a condition."""
    errors = np.array([trial.error for trial in trials])
    deviations = np.array([trial.deviation for trial in trials])
    absolute = 100.0 * np.abs(errors)
    within = np.abs(errors) <= QUANTILE_90 * deviations
    least = 100.0 * np.sqrt(np.mean(bounds**2, axis=0))
    rms = 100.0 * np.sqrt(np.mean(errors**2, axis=0))
    named = sum(bool(trial.outcome.findings) for trial in trials)
    worst = _worst_at_the_bound(bounds)
    return {
        "condition": condition.name,
        "people": len(trials),
        "mean_error_percent": float(absolute.mean()),
        "worst_error_percent": float(absolute.max()),
        "bound_mean_error_percent": float(_MEAN_ABSOLUTE * least.mean()),
        "bound_worst_error_percent": float(np.median(worst.max(axis=1))),
        "bound_worst_error_90_percent": float(np.quantile(worst.max(axis=1), 0.9)),
        "rms_over_bound": float(np.sqrt(np.mean(rms**2) / np.mean(least**2))),
        "coverage_90": float(within.mean()),
        "mount_error_mm": float(1e3 * np.median([t.mount_error for t in trials])),
        "mount_turn_error_deg": float(np.degrees(np.median([t.turn_error for t in trials]))),
        "observable": _observable_errors(trials),
        "named_something_amiss": named,
        "seconds_median": float(np.median([trial.seconds for trial in trials])),
        "bones": {
            bone: {
                "mean_error_percent": float(absolute[:, i].mean()),
                "worst_error_percent": float(absolute[:, i].max()),
                "bound_mean_error_percent": float(_MEAN_ABSOLUTE * least[i]),
                "bound_worst_error_percent": float(np.median(worst[:, i])),
                "rms_error_percent": float(rms[i]),
                "bound_rms_error_percent": float(least[i]),
                "rms_over_bound": float(rms[i] / least[i]),
                "coverage_90": float(within[:, i].mean()),
            }
            for i, bone in enumerate(NINE_BONES)
        },
    }


def _worst_at_the_bound(bounds: Float[ndarray, "n 9"]) -> Float[ndarray, "draws 9"]:
    """Worst errors of each bone among so many people whose errors have the bound's spread [%]."""
    rng = np.random.default_rng(0)
    drawn = rng.normal(0.0, 1.0, (_DRAWS, *bounds.shape))
    return 100.0 * np.abs(drawn * bounds).max(axis=1)


def _observable_errors(trials: Sequence[Trial]) -> dict[str, Any]:
    """The worst of what reports call observable, and which lengths all of them call so."""
    lengths, places, always = [0.0], [0.0], set(REPORTED)
    for trial in trials:
        result, truth = trial.outcome.result, true_lengths(trial.person)
        told = {length.name: length.value for length in result.lengths if length.is_observable}
        always &= set(told)
        lengths += [abs(value / truth[name] - 1.0) for name, value in told.items()]
        for found, true, estimate in zip(
            result.subject.mounts, trial.person.mounts, result.mounts, strict=True
        ):
            away = np.abs(np.array(found.position) - np.array(true.position))
            places += away[np.array(estimate.is_observable)].tolist()
    return {
        "lengths": [name for name in REPORTED if name in always],
        "worst_length_percent": float(100.0 * max(lengths)),
        "worst_mount_mm": float(1e3 * max(places)),
        "worst_turn_deg": float(np.degrees(max(trial.turn_error.max() for trial in trials))),
    }


def main(
    people: Annotated[int, typer.Option(min=1, help="Simulated people a condition.")] = 10,
    skeletons: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder with ASF files.")
    ] = None,
    only: Annotated[list[str] | None, typer.Option(help="Only this condition; may repeat.")] = None,
    synthesis: Annotated[
        int, typer.Option(min=0, help="People to synthesize with, the last of them.")
    ] = 2,
    motion: Annotated[
        list[str] | None,
        typer.Option(metavar="SOURCE", help="Clips to synthesize; default: the sample set."),
    ] = None,
    clips: Annotated[int, typer.Option(min=1, help="Longest clips of it for each.")] = 2,
    frames: Annotated[int, typer.Option(min=20, help="Frames of each clip.")] = 200,
    seconds: Annotated[float, typer.Option(min=5.0, help="Motion to refine by [s].")] = 60.0,
    json: Annotated[Path | None, typer.Option(help="Also write the figures here.")] = None,
) -> None:
    """Calibrate simulated people and show the table."""
    drawn = draw_people(people, skeletons)
    chosen = [c for c in conditions() if not only or c.name in only]
    if not chosen:
        raise typer.BadParameter(f"conditions are {', '.join(c.name for c in conditions())}")
    summaries, usual = [], []
    with progress_bar("calibrating") as bar:
        for place, condition in enumerate(chosen):
            trials, bounds = [], []
            known: dict[int, Float[ndarray, 9]] = {}
            for number, person in enumerate(drawn):
                bar(place * people + number, len(chosen) * people, condition.name)
                trials.append(run_trial(person, condition))
                if id(person.prior) not in known:
                    known[id(person.prior)] = bound(person, condition)
                bounds.append(known[id(person.prior)])
            summaries.append(summarize(condition, trials, np.array(bounds)))
            if condition.name == USUAL:
                usual = list(zip(drawn, trials, strict=True))
    shown = output()
    shown.print(_conditions_table(summaries, people, skeletons is not None))
    shown.print(_observable_table(summaries))
    for summary in summaries:
        if summary["condition"] == USUAL:
            shown.print(_bones_table(summary))
    document: dict[str, Any] = {"schema": 1, "people": people, "conditions": summaries,
                                "published": PUBLISHED}  # fmt: skip
    if synthesis and usual:
        with progress_bar("synthesizing") as bar:
            movers = usual[-synthesis:]
            rows, fits = synthesis_errors(movers, motion or ["sample"], clips, frames, seconds, bar)
        moved = motion_means(movers, fits)
        document["motion"] = {"people": len(movers), "seconds": seconds, "mean": moved}
        document["synthesis"] = {"clips": rows, "mean": synthesis_means(rows)}
        shown.print(motion_table(moved, len(movers), seconds))
        shown.print(synthesis_table(synthesis_means(rows)))
    if json is not None:
        write_json(without_nan(document), json)
        notes().print(f"figures: {json}")


def _conditions_table(summaries: Sequence[dict[str, Any]], people: int, real: bool) -> Table:
    source = "held-out ASF files" if real else "the published table"
    table = Table(title=f"nine lengths of {people} people from {source}", title_justify="left")
    for name in ("", "mean [%]", "bound [%]", "worst [%]", "bound's worst [%]", "rms / bound",
                 "in 90 % interval", "mounts [mm]", "[deg]", "fit [s]"):  # fmt: skip
        table.add_column(name, justify="right" if name else "left")
    for s in summaries:
        table.add_row(
            s["condition"],
            f"{s['mean_error_percent']:.2f}",
            f"{s['bound_mean_error_percent']:.2f}",
            f"{s['worst_error_percent']:.1f}",
            f"{s['bound_worst_error_percent']:.1f} ({s['bound_worst_error_90_percent']:.1f})",
            f"{s['rms_over_bound']:.2f}",
            f"{100 * s['coverage_90']:.0f} %",
            f"{s['mount_error_mm']:.1f}",
            f"{s['mount_turn_error_deg']:.2f}",
            f"{s['seconds_median']:.1f}",
        )
    table.caption = (
        "bound: the mean error of an estimate that reaches the Cramér-Rao bound; its worst: the "
        "worst of as many such errors, median (and 90 % quantile)"
    )
    table.add_row("published, 2 people", "1.40", "", "5.2", "", "", "", "", "", "")
    return table


def _observable_table(summaries: Sequence[dict[str, Any]]) -> Table:
    title = "the worst of what reports call observable"
    table = Table(title=title, title_justify="left")
    for name in ("", "length [%]", "mount, along an axis [mm]", "mount's turn [deg]"):
        table.add_column(name, justify="right" if name else "left")
    table.add_column("lengths that every report calls observable")
    for summary in summaries:
        worst = summary["observable"]
        table.add_row(
            summary["condition"],
            f"{worst['worst_length_percent']:.2f}",
            f"{worst['worst_mount_mm']:.2f}",
            f"{worst['worst_turn_deg']:.2f}",
            ", ".join(worst["lengths"]),
        )
    return table


def _bones_table(summary: dict[str, Any]) -> Table:
    table = Table(title=f"bone by bone, {summary['condition']} [%]", title_justify="left")
    table.add_column("")
    for bone in summary["bones"]:
        table.add_column(bone, justify="right")
    for label, figure, scale, form in (
        ("mean error", "mean_error_percent", 1.0, "{:.2f}"),
        ("the bound's", "bound_mean_error_percent", 1.0, "{:.2f}"),
        ("rms error", "rms_error_percent", 1.0, "{:.2f}"),
        ("the bound's", "bound_rms_error_percent", 1.0, "{:.2f}"),
        ("rms / bound", "rms_over_bound", 1.0, "{:.2f}"),
        ("worst error", "worst_error_percent", 1.0, "{:.1f}"),
        ("the bound's", "bound_worst_error_percent", 1.0, "{:.1f}"),
        ("in 90 % interval", "coverage_90", 100.0, "{:.0f}"),
    ):
        row = [form.format(scale * bone[figure]) for bone in summary["bones"].values()]
        table.add_row(label, *row)
    return table


if __name__ == "__main__":
    typer.run(main)
