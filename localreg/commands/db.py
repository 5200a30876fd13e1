"""`localreg db`: build a pose database, or look at one."""

import os
from pathlib import Path
from typing import Annotated

import typer

from localreg.commands.reading import OverridesFile, SkeletonMapFile, SourceRate, Sources

app = typer.Typer(
    help="Build a pose database, or look at one.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.callback()
def _group() -> None:
    """Build a pose database, or look at one."""


@app.command(
    epilog="""Examples:

localreg db build sample --out walks.db

localreg db build motions/ more.bvh --out all.db --rate 60 --overrides rates.toml"""
)
def build(
    sources: Sources,
    out: Annotated[Path, typer.Option(help="Folder to make; replaces a database there.")],
    rate: Annotated[float, typer.Option(help="Poses a second [Hz].")] = 40.0,
    mirror: Annotated[bool, typer.Option(help="Also store the mirror image of every clip.")] = True,
    source_rate: SourceRate = None,
    overrides: OverridesFile = None,
    skeleton_map: SkeletonMapFile = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Processes that read files; one a core by default.")
    ] = None,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Also write what was read, joint by joint."),
    ] = None,
) -> None:
    """Build a pose database from motions, and say of every file what became of it.

    Files with another skeleton than ours are retargeted: their joints are told by name, or
    by the shape of the skeleton, and their bone lengths are kept. Units and the axis that
    points up are guessed where files do not say them; the notes say how.
    """
    from functools import partial

    from localreg.commands.console import output, progress_bar
    from localreg.commands.reading import notes_table, report_table, rules_of, write_report
    from localreg.database import PoseDatabase
    from localreg.database.store import prepare
    from localreg.motion.sources import Report, iterate_sources, no_motion

    if not 0.0 < rate < float("inf"):
        raise typer.BadParameter(f"{rate} Hz is no rate", param_hint="--rate")
    rules, report = rules_of(source_rate, overrides), Report()
    with progress_bar("building") as bar:

        def told():
            for motion, entry in iterate_sources(
                sources,
                source_rate=source_rate,
                overrides=rules,
                skeleton_map=skeleton_map,
                progress=bar,
                jobs=jobs or len(os.sched_getaffinity(0)),
                prepare=partial(prepare, rate=rate),
            ):
                (report.entries if entry.is_motion else report.others).append(entry)
                if motion is not None:
                    yield motion
            if not report.used:
                raise no_motion(sources, report)
            bar(1, 1, "looking for copies")

        database = PoseDatabase.build(told(), rate=rate, mirror=mirror, prepared=True)
    database.save(out)
    console = output()
    console.print(report_table(report))
    if any(entry.notes for entry in report.used):
        console.print(notes_table(report))
    if json_file is not None:
        write_report(report, json_file)
    groups = len({clip.group for clip in database.clips})
    read_clips = sum(clip.image_of < 0 for clip in database.clips)
    if groups < read_clips:
        console.print(f"{read_clips - groups} clips hold recordings that others hold as well")
    line = f"{len(report.used)} clips used, {len(report.skipped)} files skipped"
    errors = [(e.joint_error, e.name) for e in report.used if e.joint_error is not None]
    if errors:
        error, name = max(errors)
        line += f"; joints of foreign files lie at most {100.0 * error:.2f} cm off ({name}, mean)"
    console.print(line)
    console.print(
        f"{out}: {len(database.clips)} clips, {len(database)} poses at {database.rate:g} Hz, "
        f"{database.seconds:.0f} s",
    )


@app.command(epilog="Example: localreg db info walks.db")
def info(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="The database.")],
) -> None:
    """Verify a database by its checksums and list its clips."""
    from rich.table import Table

    from localreg.commands.console import output
    from localreg.database import PoseDatabase

    database = PoseDatabase.load(folder, verify=True)
    table = Table("clip", "poses", "seconds", "subject", "trial", "activity", "group", "source")
    for column in (1, 2, 6):
        table.columns[column].justify = "right"
    for clip in database.clips:
        table.add_row(
            clip.name, str(clip.length), f"{clip.length / database.rate:.1f}", clip.subject,
            clip.trial, clip.activity, str(clip.group), clip.source,
        )  # fmt: skip
    console = output()
    console.print(table)
    if database.skipped:
        console.print(f"without a frame: {', '.join(database.skipped)}")
    settings = ", ".join(f"{name} {value}" for name, value in database.settings.items())
    console.print(
        f"{folder}: {len(database.clips)} clips of {len(database.offsets)} skeletons, "
        f"{len(database)} poses at {database.rate:g} Hz, {database.seconds:.0f} s; "
        f"all checksums match; made with {settings}",
    )
