"""`localreg data`: the motions that there are, and getting more."""

from pathlib import Path
from typing import Annotated, Literal

import typer

app = typer.Typer(
    help="Motions to learn from: what there is, and getting more.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.callback()
def _group() -> None:
    """Motions to learn from: what there is, and getting more."""


@app.command(epilog="Example: localreg data sample")
def sample() -> None:
    """List the clips of the sample set, real CMU walks that come as a package."""
    from rich.table import Table

    from localreg.commands.console import output
    from localreg.motion.formats.sample import read_sample

    motions = read_sample()
    table = Table("clip", "frames", "rate [Hz]", "seconds", "subject", "activity")
    for column in (1, 2, 3):
        table.columns[column].justify = "right"
    for motion in motions:
        made = motion.provenance
        table.add_row(
            made.name, str(len(motion)), f"{motion.rate:.4g}", f"{motion.seconds:.1f}",
            made.subject, made.activity,
        )  # fmt: skip
    console = output()
    console.print(table)
    people = {motion.provenance.subject for motion in motions}
    console.print(
        f"{len(motions)} clips of {len(people)} people, "
        f"{sum(len(m) for m in motions)} frames, {sum(m.seconds for m in motions):.0f} s"
    )


@app.command(
    epilog="""Examples:

localreg data fetch cmu --subjects 02,35 --to motions

localreg data fetch cmu --activity walk --activity run --list

localreg data fetch cmu --all --to motions

Then: localreg db build motions --out motions.db"""
)
def fetch(
    collection: Annotated[
        Literal["cmu"],
        typer.Argument(metavar="SET", help="cmu: the database of Carnegie Mellon University."),
    ],
    to: Annotated[
        Path, typer.Option(metavar="DIR", help="Where to put the files.", file_okay=False)
    ] = Path("cmu"),
    subjects: Annotated[
        list[str] | None,
        typer.Option(
            metavar="LIST",
            help="Whose: numbers, ranges and trials with commas between, 02,35,1-5,16_22.",
            show_default=False,
        ),
    ] = None,
    activity: Annotated[
        list[str] | None,
        typer.Option(
            metavar="WORD",
            help="What is done: trials whose description has the word; may be given again.",
            show_default=False,
        ),
    ] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="The whole database, as one archive of over 1 GB.")
    ] = False,
    listing: Annotated[
        bool, typer.Option("--list", help="Only list the trials that would be fetched.")
    ] = False,
    update: Annotated[
        bool,
        typer.Option(
            "--update", help="Fetch again, and take what the site has now as the right thing."
        ),
    ] = False,
    index: Annotated[
        Path | None,
        typer.Option(
            help="An index instead of the site's: tab separated, subject, trial, description.",
            dir_okay=False,
            show_default=False,
        ),
    ] = None,
    site: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="A mirror of CMU's site.", show_default=False),
    ] = None,
    connections: Annotated[int, typer.Option(help="How many files to fetch at once, 1 to 8.")] = 4,
    timeout: Annotated[
        float, typer.Option(min=0.1, help="Silence after which the server is asked anew [s].")
    ] = 30.0,
) -> None:
    """Fetch motions from CMU's site, with their skeletons and CMU's index.

    What is there already is not fetched again, and what broke off goes on where it was. The
    checksum of every file is kept in cmu-lock.json beside them; a file that is not what it was
    is an error. Rates other than 120 Hz go to cmu-rates.toml, for --overrides of other commands.
    """
    from localreg.commands.console import output, progress_bar
    from localreg.errors import LocalregError
    from localreg.motion import fetch as fetching
    from localreg.motion.cmu_index import choose
    from localreg.motion.download import Patience
    from localreg.motion.fetch_rates import RATES_NAME, write_rates

    people = [word for words in subjects or () for word in words.split(",") if word]
    words = [word for word in activity or () if word]
    if everything and (people or words or listing):
        raise typer.BadParameter("stands alone; leave the choice out", param_hint="--all")
    if not (everything or people or words):
        raise typer.BadParameter(
            "choose by --subjects 02,35 or --activity walk, or take --all", param_hint="fetch"
        )
    source = fetching.Source(site or fetching.SITE, connections, Patience(timeout))
    console = output()
    with progress_bar("fetching") as bar:
        if everything:
            known = fetching.load_index(to, source, index=index, update=update)
            report = fetching.fetch_all(to, source, update=update, progress=bar)
            write_rates(known, to)
        else:
            known = fetching.load_index(to, source, index=index, update=update)
            chosen = choose(known, people, words)
            if listing:
                console.print(_trials_table(chosen))
                return
            report = fetching.fetch(chosen, to, source, update=update, progress=bar)
    for reason in report.failed.values():
        console.print(reason, soft_wrap=True)
    size = sum(report.fetched.values()) / 2**20
    console.print(
        f"{to}: {len(report.fetched)} files fetched, {size:.1f} MB; {len(report.kept)} were there",
        soft_wrap=True,
    )
    if (to / RATES_NAME).is_file():
        console.print(f"{to / RATES_NAME} holds rates other than 120 Hz: pass it to "
                      "other commands by --overrides", soft_wrap=True)  # fmt: skip
    console.print(fetching.CREDIT, soft_wrap=True)
    if report.failed:
        count = len(report.failed) + len(report.fetched) + len(report.kept)
        raise LocalregError(
            f"{len(report.failed)} of {count} files could not be had; run this again to try them"
        )


def _trials_table(trials: list):
    """The trials that would be fetched."""
    from rich.table import Table

    table = Table("trial", "description", "rate [Hz]")
    table.columns[2].justify = "right"
    for trial in trials:
        rate = "" if trial.rate is None else f"{trial.rate:g}"
        table.add_row(trial.name, trial.description, rate)
    people = {trial.subject for trial in trials}
    table.caption = f"{len(trials)} trials of {len(people)} people"
    return table
