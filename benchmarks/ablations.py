"""What every part of the default method is worth: one taken out or changed at a time.

    python -m benchmarks.ablations sample
    python -m benchmarks.ablations CMU --overrides configs/cmu-overrides.toml --max-frames 200

Every row is the default method with one change, on the same clips with the same noise, and
shows how much more error it has (paired bootstrap interval of the difference over clips): a
part pays where the interval lies above zero. `--figures` reads what `--json` wrote before.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from benchmarks.marks import put_table
from benchmarks.tables import Column, columns_of
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
from localreg.evaluation.robustness import part_of
from localreg.evaluation.statistics import Difference
from localreg.evaluation.summaries import to_json
from localreg.motion.motion import Motion

OURS: Final = "localreg"
_DEAF: Final = "feature_position_noise=1e3:feature_rotation_noise=1e3"
_BLIND: Final = "metric_position=2e-4:metric_rotation=5e-5"


@dataclass(frozen=True, slots=True)
class Ablation:
    """One row.

    Attributes:
        words: what is changed.
        method: name of the variant that does it.
        is_mirrored: whether the database has mirror images.
    """

    words: str
    method: str
    is_mirrored: bool = True


ABLATIONS: Final = (
    Ablation("database without mirror images", OURS, is_mirrored=False),
    # Weights a ten thousandth of the usual: without a past the trackers still find neighbors.
    Ablation("trackers not in the search", f"{OURS}:{_BLIND}"),
    Ablation("trackers in neither", f"{OURS}:{_BLIND}:{_DEAF}"),
    Ablation("the past not in the search", f"{OURS}:metric_history=0/0/0"),
    Ablation("one past pose, not three", f"{OURS}:history=1:metric_history=0.6"),
    Ablation(
        "no step regression: each frame by itself",
        f"{OURS}:step_floor_position=10:step_floor_angle=10:pose_information=1",
    ),
    Ablation("no drift of the step regression", f"{OURS}:drift_memory=0"),
    Ablation("pose regression as if new in every frame", f"{OURS}:pose_information=1"),
    Ablation("no rivals", f"{OURS}:bearable_surprise=inf"),
    Ablation("no fading where trackers are left", f"{OURS}:bearable_strain=1e9"),
    Ablation("stiff joints as stiff on strange motion", f"{OURS}:strangeness=0"),
    Ablation("300 rehearsals, not 1200", f"{OURS}:rehearsals=300"),
    Ablation("30 rehearsals", f"{OURS}:rehearsals=30"),
    Ablation("hardly any ridge", f"{OURS}:pose_ridge=0.1:step_ridge=1"),
    Ablation("24 neighbors, not 80", f"{OURS}:neighbours=24"),
    Ablation("300 neighbors", f"{OURS}:neighbours=300"),
    Ablation("12 principal directions, not 24", f"{OURS}:components=12"),
    Ablation("64 principal directions", f"{OURS}:components=64"),
    Ablation("no joint limits", f"{OURS}:limit_softness=1e3"),
    Ablation("plain squares, not the Lorentzian", f"{OURS}-squares"),
)
"""What is taken out or changed."""

_HEADINGS: Final = {
    ("both", "deg"): "both\n[deg]",
    ("both", "cm"): "both\n[cm]",
    ("position", "deg"): "position\n[deg]",
    ("orientation", "deg"): "orientation\n[deg]",
}
"""The columns of the table, of those that figures have."""


def run_ablations(
    motions: Sequence[Motion],
    protocol: Protocol,
    ablations: Sequence[Ablation] = ABLATIONS,
    *,
    jobs: int = 1,
    progress: Any = None,
) -> dict[str, Any]:
    """The figures of the default method and of every ablation, as `tables` reads them.

    Args:
        motions: the clips; each is left out in turn.
        protocol: its methods are not looked at.
        ablations: which; each has its words in place of the method in the document.
        jobs: processes.
        progress: is told after every clip.
    """
    documents = []
    for part, is_mirrored in enumerate((True, False)):
        chosen = {a.method: a.words for a in ablations if a.is_mirrored == is_mirrored}
        if is_mirrored:
            chosen = {OURS: OURS, **chosen}
        if not chosen:
            continue
        document = to_json(
            evaluate(
                motions,
                PoseDatabase.build(motions, mirror=is_mirrored),
                replace(protocol, methods=tuple(chosen)),
                jobs=jobs,
                progress=part_of(progress, part, 2),
            )
        )
        for clip in document["clips"]:
            clip["method"] = chosen[clip["method"]]
        documents.append(document)
    return {
        **{key: documents[0][key] for key in ("schema", "settings", "conditions")},
        "clips": [clip for document in documents for clip in document["clips"]],
    }


def ablation_table(columns: Sequence[Column], ablations: Sequence[Ablation] = ABLATIONS) -> Grid:
    """Means of the default method, and how much more error there is with every change."""
    shown = [c for c in columns if (c.signals, c.unit) in _HEADINGS]
    clips = len(shown[0].values[OURS])
    grid = Grid(
        f"Differences over {clips} clips and their 95 % intervals",
        ["changed", *(_HEADINGS[c.signals, c.unit] for c in shown)],
    )
    grid.add_row("nothing", *(f"{column.mean(OURS):.3f}" for column in shown))
    for words in (a.words for a in ablations if a.words in shown[0].values):
        grid.add_row(words, *(_cell(column.minus(words, OURS)) for column in shown))
    return grid


def _cell(found: Difference) -> str:
    """A difference with its interval; bold where the part pays, `less` where it costs."""
    if found.mean is None or found.low is None or found.high is None:
        return "breaks down"
    text = f"{found.mean:+.3f} [{found.low:+.3f}, {found.high:+.3f}]"
    if not found.is_sure:
        return text
    return f"**{text}**" if found.mean > 0.0 else f"{text} less"


def main(
    sources: Annotated[
        list[str] | None, typer.Argument(metavar="SOURCE", help="As for localreg evaluate.")
    ] = None,
    figures: Annotated[
        Path | None, typer.Option(exists=True, help="Figures of --json, not to run it again.")
    ] = None,
    only: Annotated[str, typer.Option(help="Only changes whose words hold this.")] = "",
    signals: Annotated[
        str, typer.Option(help="Kinds of signals, with commas.")
    ] = "both,position,orientation",
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
    mark: Annotated[str, typer.Option(help="Which table of that file.")] = "ablations sample",
) -> None:
    """Print the table as Markdown."""
    if (figures is None) == (not sources):
        raise typer.BadParameter("give sources to evaluate, or --figures of an evaluation")
    chosen = [ablation for ablation in ABLATIONS if only in ablation.words]
    if figures is not None:
        document = json.loads(figures.read_text(encoding="utf-8"))
    else:
        keep_compiled_code()
        motions, _ = read(list(sources or ()), source_rate, overrides)
        protocol = Protocol((OURS,), tuple(signals.split(",")), max_frames=max_frames)
        with progress_bar("ablations") as bar:
            document = run_ablations(
                motions, protocol, chosen, jobs=jobs or default_jobs(), progress=bar
            )
        if json_file is not None:
            write_json(document, json_file)
    columns = columns_of(document)
    if OURS not in columns[0].values:
        raise LocalregError("these figures lack the method itself; make them with --json")
    grid = ablation_table(columns, chosen)
    output().print(f"{grid.title}\n\n{grid.to_markdown()}", soft_wrap=True)
    if readme is not None:
        put_table(readme, grid.to_markdown(), mark)


if __name__ == "__main__":
    typer.run(main)
