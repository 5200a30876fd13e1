"""Motions for commands: read with progress, reported in a table."""

import json
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.markup import escape
from rich.table import Table

from localreg.commands.console import notes, progress_bar
from localreg.errors import MotionError
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
SkeletonMapFile = Annotated[
    Path | None,
    typer.Option(
        "--skeleton-map",
        help="TOML that says which joints of foreign files are which bones; those that come with "
        "the program are in its folder localreg/motion/skeletons.",
        dir_okay=False,
    ),
]

_CAPTION: Final = (
    "error: mean distance between a foreign file's joints and ours, over the joints that both "
    "skeletons have, with bones that the file leaves out put back into it"
)
_FEW: Final = 20


def read(
    sources: list[str],
    source_rate: float | None,
    overrides: Path | None,
    skeleton_map: Path | None = None,
) -> tuple[list[Motion], Report]:
    """The motions of some sources, and the report on them.

    Raises:
        MotionError: a source that cannot be read; says which.
    """
    rules = rules_of(source_rate, overrides)
    with progress_bar("reading") as bar:
        return read_sources(
            sources,
            source_rate=source_rate,
            overrides=rules,
            skeleton_map=skeleton_map,
            progress=bar,
        )


def rules_of(source_rate: float | None, overrides: Path | None) -> Overrides | None:
    """What is laid down for some files, once the options are seen to make sense.

    Raises:
        MotionError: a file that cannot be read.
    """
    if source_rate is not None and not 0.0 < source_rate < float("inf"):
        raise typer.BadParameter(f"{source_rate} Hz is no rate", param_hint="--source-rate")
    return None if overrides is None else Overrides.load(overrides)


def report_table(report: Report) -> Table:
    """What became of every file: used under which name, or skipped and why.

    `error` is the mean distance between a foreign file's joints and ours, over the joints
    that both skeletons have. Notes are numbered as in `notes_table`.
    """
    table = Table("clip or file", "", "frames", "seconds", "rate [Hz]", "rate from", "skeleton",
                  "error [cm]", "subject", "activity", "notes, or why",
                  title="What was read", caption=_CAPTION)  # fmt: skip
    for column in (2, 3, 4, 7):
        table.columns[column].justify = "right"
    table.columns[0].overflow = "fold"
    numbers = _numbered(report)
    for entry in report.used:
        error = "" if entry.joint_error is None else f"{100.0 * entry.joint_error:.2f}"
        table.add_row(
            entry.name, "used", str(entry.frames), f"{entry.seconds:.1f}", f"{entry.rate:.4g}",
            entry.rate_rule, entry.skeleton, error, entry.subject, entry.activity,
            ", ".join(f"({numbers[note]})" for note in entry.notes),
        )  # fmt: skip
    for entry in report.skipped:
        why = entry.skipped.removeprefix(entry.source).lstrip(":, ")
        table.add_row(escape(entry.source), "skipped", *[""] * 8, escape(why))
    for entry in report.others:
        table.add_row(escape(entry.source), "", *[""] * 8, escape(entry.skipped))
    return table


def notes_table(report: Report) -> Table:
    """What readers had to assume or mend, numbered, and for how many clips."""
    table = Table("", "clips", "what was assumed or mended", title="Notes")
    table.columns[1].justify = "right"
    counts = Counter(note for entry in report.used for note in entry.notes)
    for note, number in _numbered(report).items():
        table.add_row(f"({number})", str(counts[note]), escape(note))
    return table


def _numbered(report: Report) -> dict[str, int]:
    """A number for every note, in the order in which they first occur."""
    notes = dict.fromkeys(note for entry in report.used for note in entry.notes)
    return {note: number for number, note in enumerate(notes, start=1)}


def write_report(report: Report, path: Path) -> None:
    """Write what became of every file as JSON, with the error of every joint [m].

    Raises:
        MotionError: the file cannot be written.
    """
    document = {
        "schema": 1,
        "entries": [asdict(e) | {"joint_errors": dict(e.joint_errors)} for e in report.entries],
        "others": [{"source": e.source, "why": e.skipped} for e in report.others],
    }
    try:
        path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise MotionError(f"cannot write {path}: {error.strerror}; choose another place") from error


def warn_of_skipped(report: Report) -> None:
    """Say on standard error which files were left out, if any."""
    console = notes()
    for entry in report.skipped[:_FEW]:
        console.print(f"skipped {entry.source}: {entry.skipped}")
    if len(report.skipped) > _FEW:
        console.print(f"and {len(report.skipped) - _FEW} more files")
