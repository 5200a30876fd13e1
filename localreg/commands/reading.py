"""Motions for commands: read with progress, reported in a table."""

from pathlib import Path
from typing import Annotated, Final

import typer
from rich.table import Table

from localreg.commands.console import notes, progress_bar
from localreg.motion.motion import Motion
from localreg.motion.overrides import Overrides
from localreg.motion.sources import Report, read_sources

Sources = Annotated[
    list[str],
    typer.Argument(
        metavar="SOURCE", help="sample (the sample set), a file, or a folder with motion files."
    ),
]
SourceRate = Annotated[
    float | None,
    typer.Option(help="Frames a second of files that carry no rate (AMC) [Hz]; 120 by default."),
]
OverridesFile = Annotated[
    Path | None,
    typer.Option(help="TOML with rates, units and names for some files.", dir_okay=False),
]

_FEW: Final = 20


def read(
    sources: list[str], source_rate: float | None, overrides: Path | None
) -> tuple[list[Motion], Report]:
    """The motions of some sources, and the report on them.

    Raises:
        MotionError: a source that cannot be read; says which.
    """
    if source_rate is not None and not 0.0 < source_rate < float("inf"):
        raise typer.BadParameter(f"{source_rate} Hz is no rate", param_hint="--source-rate")
    rules = None if overrides is None else Overrides.load(overrides)
    with progress_bar("reading") as bar:
        return read_sources(sources, source_rate=source_rate, overrides=rules, progress=bar)


def report_table(report: Report) -> Table:
    """What became of every file: used under which name at which rate, or skipped and why."""
    table = Table("clip", "frames", "seconds", "rate [Hz]", "rate from", "subject", "activity",
                  "notes", title="What was read")  # fmt: skip
    for column in (1, 2, 3):
        table.columns[column].justify = "right"
    for entry in report.used:
        table.add_row(
            entry.name, str(entry.frames), f"{entry.seconds:.1f}", f"{entry.rate:.4g}",
            entry.rate_rule, entry.subject, entry.activity, "; ".join(entry.notes),
        )  # fmt: skip
    return table


def skipped_table(report: Report) -> Table:
    """The files that were left out, and why."""
    table = Table("file", "why", title="Skipped")
    for entry in report.skipped:
        table.add_row(entry.source, entry.skipped)
    return table


def warn_of_skipped(report: Report) -> None:
    """Say on standard error which files were left out, if any."""
    console = notes()
    for entry in report.skipped[:_FEW]:
        console.print(f"skipped {entry.source}: {entry.skipped}")
    if len(report.skipped) > _FEW:
        console.print(f"and {len(report.skipped) - _FEW} more files")
