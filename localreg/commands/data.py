"""`localreg data`: the motions that there are."""

import typer

app = typer.Typer(
    help="Motions to learn from: what there is.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


@app.callback()
def _group() -> None:
    """Motions to learn from: what there is."""


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
