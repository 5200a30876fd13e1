"""`localreg evaluate`: how well methods synthesize motion that they have not seen."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from localreg.commands.reading import OverridesFile, SourceRate, Sources

if TYPE_CHECKING:
    from rich.console import Console

    from localreg.evaluation.protocol import Protocol
    from localreg.evaluation.results import Evaluation

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command(
    epilog="""Examples:

localreg evaluate sample --methods localreg,ik --signals both

localreg evaluate sample --leave-out subject --json walks.json

localreg evaluate test/ --database train.db --start truth --jobs 4

localreg evaluate sample --trackers head,lhand,rhand --outliers 0.02 --dropout 0.1"""
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
    methods: Annotated[str, typer.Option(help="Methods, with commas.")] = "localreg,paper,ik",
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
        float, typer.Option(min=0.0, max=1.0, help="Probability of an outlier (0.3 m, 60 deg).")
    ] = 0.0,
    dropout: Annotated[
        float, typer.Option(min=0.0, max=0.99, help="Share of time that each tracker is away.")
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
    json_file: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Also write every figure; - for the output."),
    ] = None,
    verbose: Annotated[bool, typer.Option(help="Show every clip.")] = False,
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

    import numpy as np

    from localreg.commands.console import notes, output, progress_bar
    from localreg.commands.reading import read, warn_of_skipped
    from localreg.database import PoseDatabase
    from localreg.errors import SynthesisError
    from localreg.evaluation.leave_one_out import default_jobs
    from localreg.evaluation.leave_one_out import evaluate as run
    from localreg.evaluation.protocol import Protocol
    from localreg.evaluation.results import write_json
    from localreg.evaluation.trackers import TrackerQuality
    from localreg.synthesis.methods import METHODS

    try:
        protocol = Protocol(
            methods=_names(methods),
            signals=_names(signals),
            quality=TrackerQuality(
                noise_position=noise_position,
                noise_orientation=float(np.radians(noise_orientation)),
                outliers=outliers,
                dropout=dropout,
            ),
            trackers=None if trackers is None else _names(trackers),
            start=start,
            leave_out=None if database is not None else _leave_out(leave_out),
            max_frames=max_frames,
            seed=seed,
        )
        unknown = [method for method in protocol.methods if method not in METHODS]
        if unknown:
            raise SynthesisError(
                f"no method named {', '.join(unknown)}; choose among {', '.join(METHODS)}"
            )
    except SynthesisError as error:
        raise typer.BadParameter(str(error)) from error
    motions, report = read(sources, source_rate, overrides)
    warn_of_skipped(report)
    if database is not None:
        learned = PoseDatabase.load(database)
    else:
        learned = PoseDatabase.build(motions, rate=rate, mirror=mirror)
    with progress_bar("evaluating") as bar:
        evaluation = run(
            motions,
            learned,
            protocol,
            folder=database,
            jobs=jobs or default_jobs(),
            progress=bar,
        )
    if evaluation.too_short:
        notes().print(f"too short to be a test: {', '.join(evaluation.too_short)}")
    document = evaluation.to_json()
    if to_output:
        import json

        typer.echo(json.dumps(document, indent=1, allow_nan=False))
    else:
        if json_file is not None:
            write_json(document, json_file)
        _print(evaluation, protocol, output(), verbose=verbose)


def _print(
    evaluation: "Evaluation", protocol: "Protocol", console: "Console", *, verbose: bool
) -> None:
    from localreg.commands.evaluation_tables import (
        clip_table,
        mean_table,
        timing_table,
        worse_than_ik,
        worst_table,
    )

    console.print(mean_table(evaluation))
    console.print(worst_table(evaluation))
    for line in worse_than_ik(evaluation):
        console.print(line)
    console.print(timing_table(evaluation))
    if verbose:
        console.print(clip_table(evaluation))


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
