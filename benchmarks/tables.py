"""One table of all methods for every kind of signals, as the README shows it.

    python -m benchmarks.tables sample
    python -m benchmarks.tables --figures figures.json
    python -m benchmarks.tables sample --settings benchmarks/rivals.toml --set sample

Evaluates (leaving one clip out) or takes the figures of `localreg evaluate --json`. Every method
has one setting, whatever the motion; with `--settings` each rival has a row more, with what
`benchmarks.tune_baselines` found best for this set of motion alone, where that differs. In every
column the lowest mean is marked, those that cannot be told from it are tied (the paired
bootstrap interval of the difference holds zero), the others have lost. Below it the order
that was published is compared with what was found, step by step.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import typer

from benchmarks.marks import put_table
from benchmarks.tune_baselines import read_settings
from localreg.commands.console import output, progress_bar
from localreg.commands.grids import Grid
from localreg.commands.reading import OverridesFile, SourceRate, read
from localreg.compile_cache import keep_compiled_code
from localreg.database import PoseDatabase
from localreg.errors import LocalregError
from localreg.evaluation.execution import default_jobs
from localreg.evaluation.leave_one_out import evaluate
from localreg.evaluation.protocol import Protocol
from localreg.evaluation.results import write_json
from localreg.evaluation.statistics import Difference, paired_difference
from localreg.evaluation.summaries import to_json
from localreg.evaluation.variants import TRUTH, find_variant

METHODS: Final = ("ik", "lpca", "lpcr", "paper", "joint", "localreg", "ik-truth")
"""The rows, in the published order of quality, the default last; then what IK could be."""

PUBLISHED: Final = ("ik", "lpca", "lpcr", "paper")
"""From the greatest published error to the least (IK 4.76; LPCA 1.97, 1.42; LPCR 1.75, 1.19;
paper 1.43, 0.87 degrees, for 65,609 and 1.1 million poses of their own)."""

SIGNALS: Final = ("both", "position", "orientation")

_FIGURES: Final = {
    "both": (("joint_angle_error_deg", "deg"), ("mpjpe_cm", "cm")),
    "position": (("joint_angle_error_deg", "deg"), ("mpjpe_cm", "cm")),
    # Orientations alone do not say where in the room the body is.
    "orientation": (("joint_angle_error_deg", "deg"), ("mpjpe_root_aligned_cm", "cm aligned")),
}
_LOWEST, _TIED = " **lowest**", " tied"


@dataclass(frozen=True)
class Column:
    """One figure with one kind of signals, clip by clip.

    Attributes:
        signals: what trackers measured.
        figure: name of the figure.
        unit: for the heading.
        values: for every method, a value for every clip in the same order.
    """

    signals: str
    figure: str
    unit: str
    values: Mapping[str, Sequence[float | None]]

    def mean(self, method: str) -> float:
        """Mean over the clips; not a number where one is missing."""
        return float(np.mean([np.nan if v is None else v for v in self.values[method]]))

    def minus(self, method: str, other: str) -> Difference:
        """One method's figure minus another's."""
        return paired_difference(self.values[method], self.values[other])

    def lowest(self, methods: Sequence[str]) -> str:
        """The method with the least mean."""
        return min(methods, key=lambda method: np.nan_to_num(self.mean(method), nan=np.inf))


def columns_of(document: Mapping[str, Any]) -> list[Column]:
    """The columns that a document of figures has something for.

    Args:
        document: as `localreg evaluate --json` writes it.

    Raises:
        LocalregError: it is no such document.
    """
    try:
        clips = document["clips"]
        kinds = [s for s in SIGNALS if any(clip["signals"] == s for clip in clips)]
        methods = list(dict.fromkeys(clip["method"] for clip in clips))
        return [
            Column(
                signals,
                figure,
                unit,
                {
                    method: [
                        clip[figure]
                        for clip in clips
                        if (clip["method"], clip["signals"]) == (method, signals)
                    ]
                    for method in methods
                },
            )
            for signals in kinds
            for figure, unit in _FIGURES[signals]
        ]
    except (KeyError, TypeError) as error:
        raise LocalregError(
            f"these are not the figures of an evaluation ({error} is missing); make them with "
            "localreg evaluate --json"
        ) from error


def method_table(columns: Sequence[Column], words: Mapping[str, str] | None = None) -> Grid:
    """Methods by signals; `ik-truth` is shown but does not compete, since it was given more.

    Args:
        columns: the figures.
        words: what rows are called, where that is not the name of the method.
    """
    methods = list(columns[0].values)
    rivals = rivals_of(columns[0])
    clips = len(columns[0].values[methods[0]])
    grid = Grid(
        f"Means over {clips} clips", ["method", *(f"{c.signals}\n[{c.unit}]" for c in columns)]
    )
    for method in methods:
        cells = []
        for column in columns:
            best, mark = column.lowest(rivals), ""
            if method == best:
                mark = _LOWEST
            elif method in rivals and not column.minus(method, best).is_sure:
                mark = _TIED
            cells.append(f"{column.mean(method):.2f}{mark}")
        grid.add_row((words or {}).get(method, method), *cells)
    return grid


def rows_of(methods: Sequence[str], chosen: Mapping[str, str]) -> dict[str, str]:
    """The variants to run, with what their rows are called.

    Args:
        methods: with their own settings.
        chosen: by method, the variant that suits this set of motion best.
    """
    rows = {method: method for method in methods}
    for method in methods:
        variant = find_variant(method)
        if variant.method not in chosen:
            continue
        name = chosen[variant.method] + (TRUTH if variant.is_given_truth else "")
        if find_variant(name).settings != variant.settings:
            rows[name] = f"{method}, chosen for this set"
    return rows


def rivals_of(column: Column) -> list[str]:
    """The methods that were not given the truth."""
    return [name for name in column.values if not find_variant(name).is_given_truth]


def published_order(columns: Sequence[Column]) -> list[str]:
    """For each step of the published order, whether it was found."""
    lines = []
    for column in columns:
        # A rival may run as a variant, such as paper-floor8.
        names = {find_variant(name).method: name for name in reversed(rivals_of(column))}
        known = [names[method] for method in PUBLISHED if method in names]
        for worse, better in pairwise(known):
            found = column.minus(worse, better)
            if found.mean is None:
                continue
            interval = "" if found.low is None else f" [{found.low:+.2f}, {found.high:+.2f}]"
            verdict = "not told apart"
            if found.is_sure:
                verdict = "as published" if found.mean > 0.0 else "the other way round"
            lines.append(
                f"{column.signals}, {column.unit}: {worse} minus {better} "
                f"{found.mean:+.2f}{interval}: {verdict}"
            )
    return lines


def main(
    sources: Annotated[
        list[str] | None, typer.Argument(metavar="SOURCE", help="As for localreg evaluate.")
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option(exists=True, help="Figures of localreg evaluate --json, not to run it again."),
    ] = None,
    methods: Annotated[str, typer.Option(help="The rows, with commas.")] = ",".join(METHODS),
    settings: Annotated[
        Path | None,
        typer.Option(exists=True, help="What benchmarks.tune_baselines --out wrote."),
    ] = None,
    of_set: Annotated[
        str | None,
        typer.Option(
            "--set", help="Which set's settings to show beside; the first source's name by default."
        ),
    ] = None,
    signals: Annotated[str, typer.Option(help="The columns, with commas.")] = ",".join(SIGNALS),
    max_frames: Annotated[int | None, typer.Option(help="Only so many frames a clip.")] = None,
    source_rate: SourceRate = None,
    overrides: OverridesFile = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes; one a core.")] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", metavar="FILE", help="Also write every figure.")
    ] = None,
    readme: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            exists=True,
            help="Also put the table into this file, between <!-- MARK --> and <!-- /MARK -->.",
        ),
    ] = None,
    mark: Annotated[str, typer.Option(help="Which table of that file.")] = "methods sample",
) -> None:
    """Print the table as Markdown, and what became of the published order."""
    if (figures is None) == (not sources):
        raise typer.BadParameter("give sources to evaluate, or --figures of an evaluation")
    rows = rows_of(methods.split(","), _chosen(settings, of_set or Path((sources or [""])[0]).name))
    if figures is not None:
        document = json.loads(figures.read_text(encoding="utf-8"))
    else:
        keep_compiled_code()
        motions, _ = read(list(sources or ()), source_rate, overrides)
        protocol = Protocol(tuple(rows), tuple(signals.split(",")), max_frames=max_frames)
        with progress_bar("evaluating") as bar:
            evaluation = evaluate(
                motions, PoseDatabase.build(motions), protocol,
                jobs=jobs or default_jobs(), progress=bar,
            )  # fmt: skip
        document = to_json(evaluation)
        if json_file is not None:
            write_json(document, json_file)
    columns = columns_of(document)
    grid = method_table(columns, rows)
    console = output()
    console.print(f"{grid.title}\n\n{grid.to_markdown()}\n", soft_wrap=True)
    if readme is not None:
        put_table(readme, grid.to_markdown(), mark)
    for line in published_order(columns):
        console.print(f"* {line}", soft_wrap=True)


def _chosen(settings: Path | None, name: str) -> dict[str, str]:
    if settings is None:
        return {}
    found = read_settings(settings)
    if name not in found:
        raise typer.BadParameter(
            f"{settings} knows no set {name!r}; choose one of {', '.join(found)}",
            param_hint="--set",
        )
    return found[name]


if __name__ == "__main__":
    typer.run(main)
