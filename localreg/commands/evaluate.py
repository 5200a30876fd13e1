"""`localreg evaluate`: how well methods synthesize motion that they have not seen."""

import os
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from localreg.commands.reading import OverridesFile, SkeletonMapFile, SourceRate, Sources

if TYPE_CHECKING:
    from collections.abc import Sequence
    from contextlib import AbstractContextManager

    from rich.console import Console

    from localreg.database import PoseDatabase
    from localreg.evaluation.execution import Run
    from localreg.evaluation.leave_one_out import Progress
    from localreg.evaluation.protocol import Protocol
    from localreg.evaluation.results import Evaluation
    from localreg.motion.motion import Motion

_USUAL_OUTLIERS = 0.05


class Disturbance(StrEnum):
    """What can be done to the trackers to see what it costs."""

    OUTLIERS = "outliers"
    LOST_TRACKER = "lost-tracker"


app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command(
    epilog="""Examples:

localreg evaluate sample --methods localreg,ik --signals both

localreg evaluate sample --leave-out subject --json walks.json

localreg evaluate test/ --database train.db --start truth --jobs 4

localreg evaluate sample --trackers head,lhand,rhand --outliers 0.02 --dropout 0.1

localreg evaluate sample --report out/report

localreg evaluate sample --methods localreg,localreg-squares --signals both --disturb outliers"""
)
def evaluate(
    sources: Sources,
    database: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Learn from this database, without the copies of the test clip; else from the "
            "clips themselves.",
        ),
    ] = None,
    leave_out: Annotated[
        str | None,
        typer.Option(
            metavar="clip|subject|activity",
            help="Without --database: what to leave out with each test clip (clip).",
        ),
    ] = None,
    methods: Annotated[
        str,
        typer.Option(
            help="Methods, with commas; NAME-truth is given the true first pose, NAME-squares "
            "has plain squares for the Lorentzian, NAME-floor8 a least deviation of 8 degrees, "
            "NAME:neighbours=24:rank=6 other settings (localreg/synthesis/settings.py)."
        ),
    ] = "localreg,paper,lpcr,lpca,ik,ik-truth",
    signals: Annotated[
        str, typer.Option(help="What trackers measure, one evaluation for each.")
    ] = "both,position,orientation",
    trackers: Annotated[
        str | None, typer.Option(help="Trackers worn, with commas; all six by default.")
    ] = None,
    noise_position: Annotated[
        float, typer.Option(min=0.0, help="Standard deviation on each axis [m].")
    ] = 0.003,
    noise_orientation: Annotated[
        float, typer.Option(min=0.0, help="Standard deviation of each rotation component [deg].")
    ] = 0.5,
    outliers: Annotated[
        float,
        typer.Option(min=0.0, max=1.0, help="Probability of an outlier, per tracker and frame."),
    ] = 0.0,
    outlier_position: Annotated[
        float, typer.Option(min=0.0, help="How far off an outlier's position is [m].")
    ] = 0.3,
    outlier_orientation: Annotated[
        float, typer.Option(min=0.0, help="How far off an outlier's orientation is [deg].")
    ] = 60.0,
    dropout: Annotated[
        float, typer.Option(min=0.0, max=0.99, help="Share of time that each tracker is away.")
    ] = 0.0,
    dropout_seconds: Annotated[
        float, typer.Option(min=0.0, help="How long it stays away, on average [s].")
    ] = 0.2,
    slip_position: Annotated[
        float, typer.Option(min=0.0, help="How far each tracker slides on its bone, once [m].")
    ] = 0.0,
    slip_orientation: Annotated[
        float, typer.Option(min=0.0, help="How far it turns then [deg].")
    ] = 0.0,
    time_jitter: Annotated[
        float,
        typer.Option(min=0.0, help="Standard deviation of when trackers really measure [ms]."),
    ] = 0.0,
    start: Annotated[
        str,
        typer.Option(
            metavar="cold|truth", help="Start from the trackers, or given the true first pose."
        ),
    ] = "cold",
    max_frames: Annotated[
        int | None, typer.Option(help="Only the first so many frames of each clip.")
    ] = None,
    rate: Annotated[float, typer.Option(help="Frames a second, without --database [Hz].")] = 40.0,
    mirror: Annotated[
        bool, typer.Option(help="Learn from mirror images too, without --database.")
    ] = True,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the noise.")] = 0,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes; one for every core by default.")
    ] = None,
    source_rate: SourceRate = None,
    overrides: OverridesFile = None,
    skeleton_map: SkeletonMapFile = None,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Also write every figure; - for the output."),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Also write a web page with tables, figures and filmstrips there; runs some more "
            "evaluations, of a few clips, for curves of robustness and database size.",
        ),
    ] = None,
    verbose: Annotated[
        bool, typer.Option(help="Show activities, joints and every clip, too.")
    ] = False,
    database_share: Annotated[
        float,
        typer.Option(min=0.0, max=1.0, help="Learn from this share of the recordings only."),
    ] = 1.0,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS", help="Run on the workers of this Dask scheduler (extra: cluster)."
        ),
    ] = None,
    disturb: Annotated[
        Disturbance | None,
        typer.Option(
            help="Instead of the tables, what a disturbance costs: outliers (5 % of 30 cm unless "
            "--outliers says otherwise), or each tracker in turn lost for a second."
        ),
    ] = None,
) -> None:
    """Synthesize clips from simulated trackers and measure the errors.

    Every clip is kept from the database while it is the test, with its mirror image and
    every copy of the same recording. The first 5 frames of each count for nothing.
    """
    if database is not None and leave_out is not None:
        raise typer.BadParameter(
            "choose one: with --database all of it is the training set, except copies of the test",
            param_hint="--leave-out",
        )
    if not 0.0 < rate < float("inf"):
        raise typer.BadParameter(f"{rate} Hz is no rate", param_hint="--rate")
    to_output = json_file is not None and str(json_file) == "-"
    if json_file is not None and not to_output:
        _check_writable(json_file)
    if report is not None and report.exists() and not report.is_dir():
        raise typer.BadParameter(f"{report} is a file; give a folder", param_hint="--report")
    if report is not None and disturb is not None:
        raise typer.BadParameter(
            "choose one: --disturb prints a table and no page", param_hint="--report"
        )

    import numpy as np

    from localreg.commands.console import notes, output, progress_bar
    from localreg.commands.reading import read, warn_of_skipped
    from localreg.database import PoseDatabase
    from localreg.errors import SynthesisError
    from localreg.evaluation.leave_one_out import evaluate as run_evaluation
    from localreg.evaluation.protocol import Protocol
    from localreg.evaluation.results import write_json
    from localreg.evaluation.summaries import to_json
    from localreg.evaluation.trackers import TrackerQuality

    try:
        protocol = Protocol(
            methods=_names(methods),
            signals=_names(signals),
            quality=TrackerQuality(
                noise_position=noise_position,
                noise_orientation=float(np.radians(noise_orientation)),
                outliers=outliers,
                outlier_position=outlier_position,
                outlier_orientation=float(np.radians(outlier_orientation)),
                dropout=dropout,
                dropout_seconds=dropout_seconds,
                slip_position=slip_position,
                slip_orientation=float(np.radians(slip_orientation)),
                time_jitter=1e-3 * time_jitter,
            ),
            trackers=None if trackers is None else _names(trackers),
            start=start,
            leave_out=None if database is not None else _leave_out(leave_out),
            max_frames=max_frames,
            seed=seed,
            database_share=database_share,
            keep_poses=report is not None,
        )
    except SynthesisError as error:
        raise typer.BadParameter(str(error)) from error
    motions, reading = read(sources, source_rate, overrides, skeleton_map)
    warn_of_skipped(reading)
    if database is not None:
        learned = PoseDatabase.load(database)
    else:
        learned = PoseDatabase.build(motions, rate=rate, mirror=mirror)
    with _somewhere(learned, database, jobs, len(motions), scheduler) as run:
        if disturb is not None:
            with progress_bar("disturbing") as bar:
                document = _disturb(disturb, motions, learned, protocol, run, bar, to_output)
            if json_file is not None and not to_output:
                write_json(document, json_file)
        else:
            with progress_bar("evaluating") as bar:
                evaluation = run_evaluation(
                    motions, learned, protocol, folder=database, run=run, progress=bar
                )
            document = to_json(evaluation)
            if json_file is not None and not to_output:
                write_json(document, json_file)
            if evaluation.too_short:
                notes().print(f"too short to be a test: {', '.join(evaluation.too_short)}")
            if not to_output:
                _print(evaluation, output(), verbose=verbose)
            if report is not None:
                from localreg.commands.evaluation_report import write_report

                with progress_bar("report") as bar:
                    page = write_report(
                        report, evaluation, motions, learned, protocol, run, progress=bar
                    )
                notes().print(f"report: {page}", soft_wrap=True)
    if to_output:
        import json

        typer.echo(json.dumps(document, indent=1, allow_nan=False))


def _somewhere(
    database: "PoseDatabase",
    folder: Path | None,
    jobs: int | None,
    clips: int,
    scheduler: str | None,
) -> "AbstractContextManager[Run]":
    """Where trials are run: processes of this machine, or a Dask cluster."""
    if scheduler is not None:
        from localreg.evaluation.cluster import cluster

        return cluster(database, scheduler)
    from localreg.evaluation.execution import default_jobs, processes

    return processes(database, min(jobs or default_jobs(), clips), folder)


def _disturb(
    what: Disturbance,
    motions: "Sequence[Motion]",
    database: "PoseDatabase",
    protocol: "Protocol",
    run: "Run",
    progress: "Progress",
    to_output: bool,
) -> dict[str, Any]:
    """Errors with and without a disturbance, as a table and as a document."""
    from dataclasses import asdict, replace

    from localreg.commands.console import output
    from localreg.commands.evaluation_tables import growth_table, recovery_table
    from localreg.evaluation.results import SCHEMA, without_nan
    from localreg.evaluation.robustness import loss_growth, outlier_growth

    if what is Disturbance.OUTLIERS:
        share = protocol.quality.outliers or _USUAL_OUTLIERS
        wild = replace(protocol, quality=replace(protocol.quality, outliers=share))
        growths = outlier_growth(motions, database, wild, run, progress=progress)
    else:
        growths = loss_growth(motions, database, protocol, run, progress=progress)
    if not to_output:
        output().print(growth_table(growths).to_rich())
        if growths[0].recovery is not None:
            output().print(recovery_table(growths).to_rich())
    entries = [
        {**asdict(g), "mpjpe_growth": g.mpjpe_growth, "angle_growth": g.angle_growth}
        for g in growths
    ]
    return without_nan({"schema": SCHEMA, "disturbance": what.value, "growth": entries})


def _print(evaluation: "Evaluation", console: "Console", *, verbose: bool) -> None:
    from localreg.commands import evaluation_tables as tables

    console.print(tables.mean_table(evaluation).to_rich())
    if len(evaluation.methods) > 1:
        console.print(tables.difference_table(evaluation).to_rich())
    console.print(tables.worst_table(evaluation).to_rich())
    for line in tables.worse_lines(evaluation):
        console.print(line)
    console.print(tables.more_table(evaluation).to_rich())
    if verbose:
        console.print(tables.activity_table(evaluation).to_rich())
        console.print(tables.joint_table(evaluation).to_rich())
        console.print(tables.clip_table(evaluation).to_rich())


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _leave_out(name: str | None) -> Literal["clip", "subject", "activity"]:
    for known in ("clip", "subject", "activity"):
        if (name or "clip") == known:
            return known
    raise typer.BadParameter(
        f"{name} cannot be left out; choose clip, subject or activity", param_hint="--leave-out"
    )


def _check_writable(path: Path) -> None:
    """Find out before an evaluation of hours, not after, that its file cannot be written."""
    if path.is_dir() or not os.access(path.parent, os.W_OK):
        raise typer.BadParameter(
            f"cannot write {path}; give a file in a folder that exists and may be written",
            param_hint="--json",
        )
