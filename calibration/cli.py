"""Commands: `localreg calibrate [run]`, `height`, `poses`, `check` and `refine`."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup


class DefaultRun(TyperGroup):
    """A group whose command `run` may be left out."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As always, but options alone belong to `run`."""
        if args and args[0].startswith("-") and args[0] not in ("--help", "-h"):
            args = ["run", *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=DefaultRun,
    name="calibrate",
    help="Fit the body model to a person: bone lengths, and where the trackers sit.",
    epilog="""Examples: `localreg calibrate --config is900 --out anna.toml`,
    `localreg calibrate --simulate sample --out me.toml` (no hardware needed),
    `localreg calibrate poses --png DIR`, `localreg calibrate check anna.toml --config is900`.""",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

Config = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE", help="Configuration of the devices, as for run.", show_default=False
    ),
]
Simulate = Annotated[
    str | None,
    typer.Option(
        metavar="MOTION",
        help="A simulated person with the body of this motion's subject (sample, or a file).",
        show_default=False,
    ),
]
Skeletons = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Folder with ASF files; people's proportions are learned from them, too.",
        show_default=False,
    ),
]
Template = Annotated[
    Path | None,
    typer.Option(
        help="Subject whose trackers are worn, if they are not the usual six.", show_default=False
    ),
]
Height = Annotated[
    float | None,
    typer.Option(help="Standing height without shoes [m], if known.", show_default=False),
]
Seed = Annotated[int, typer.Option(min=0, help="Of the simulated person.")]
Recording = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="A recording (.mcap) of motion.", show_default=False),
]
Truth = Annotated[
    Path | None,
    typer.Option(
        metavar="SUBJECT",
        help="Who the simulated person really is, if not as the subject file says.",
        show_default=False,
    ),
]
Seconds = Annotated[float, typer.Option(min=2.0, help="How much motion to look at [s].")]
Database = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR", help="Poses to learn from; default: the sample set.", show_default=False
    ),
]
Name = Annotated[str, typer.Option(help="Whose body.")]
Out = Annotated[Path, typer.Option(help="Subject file to be written (TOML).")]
SubjectFile = Annotated[Path, typer.Argument(metavar="SUBJECT", help="Subject file (TOML).")]


@app.command()
def run(
    out: Out,
    config: Config = None,
    simulate: Simulate = None,
    quick: Annotated[bool, typer.Option("--quick", help="One pose only: the T.")] = False,
    height: Height = None,
    skeletons: Skeletons = None,
    template: Template = None,
    name: Name = "me",
    pose: Annotated[
        list[str] | None,
        typer.Option(
            help="Record only this pose anew and keep the others of the progress file; may repeat.",
            show_default=False,
        ),
    ] = None,
    progress: Annotated[
        Path | None,
        typer.Option(
            help="File that keeps recorded poses; default: OUT.progress.json.", show_default=False
        ),
    ] = None,
    fresh: Annotated[
        bool, typer.Option("--fresh", help="Forget what an interrupted run recorded.")
    ] = False,
    hold: Annotated[float, typer.Option(min=0.5, max=20.0, help="Hold a pose so long [s].")] = 2.0,
    pose_error: Annotated[
        float, typer.Option(min=0.0, help="Error of the simulated person's joints [deg].")
    ] = 5.0,
    mistake: Annotated[
        list[str] | None,
        typer.Option(
            metavar="POSE=POSE",
            help="Let the simulated person take another pose at first; arms, legs or mirror "
            "exchange left and right; may repeat.",
            show_default=False,
        ),
    ] = None,
    seed: Seed = 0,
    yes: Annotated[bool, typer.Option("--yes", help="Begin without waiting for a key.")] = False,
    motion: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS",
            min=0.0,
            max=600.0,
            help="Walk about for so long after the poses; 0 for not at all. Default: 60, of a "
            "simulated person 20, after --quick 0.",
            show_default=False,
        ),
    ] = None,
    database: Database = None,
) -> None:
    """Lead a person through eight poses and a minute of motion, and write the subject file.

    Stand where all trackers are seen, press Enter and follow the pictures. Each pose is
    recorded once you hold still; the terminal rings. Then walk about as you like: poses and
    motion together tell lengths and mounts better than poses alone (s skips it). What is
    recorded survives a crash: begin again with the same --out to go on. Wrong poses, exchanged
    or slipped trackers and wrong units are named.
    """
    from calibration import run_command

    run_command.run(
        run_command.RunOptions(
            out=out,
            config=config,
            simulate=simulate,
            quick=quick,
            height=height,
            skeletons=skeletons,
            template=template,
            name=name,
            only=tuple(pose or ()),
            progress=progress,
            fresh=fresh,
            hold=hold,
            pose_error=pose_error,
            mistakes=tuple(mistake or ()),
            seed=seed,
            yes=yes,
            motion=motion,
            database=database,
        )
    )


@app.command()
def height(
    metres: Annotated[float, typer.Argument(metavar="HEIGHT", help="Standing height [m].")],
    out: Out,
    skeletons: Skeletons = None,
    name: Name = "me",
) -> None:
    """Guess a body from its height alone, for the impatient: mounts stay the default ones."""
    from calibration import people_commands

    people_commands.height_only(metres, out, skeletons, name)


@app.command()
def poses(
    png: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Draw the poses into this folder.", show_default=False),
    ] = None,
    information: Annotated[
        bool, typer.Option("--information", help="Show what each pose tells of which length.")
    ] = False,
    skeletons: Skeletons = None,
) -> None:
    """Show the eight poses in words, draw them, or show what they tell."""
    from calibration import people_commands

    people_commands.show_poses(png, information, skeletons)


@app.command()
def check(
    subject: SubjectFile,
    config: Config = None,
    recording: Recording = None,
    simulate: Simulate = None,
    seconds: Seconds = 20.0,
    database: Database = None,
    seed: Seed = 0,
    truth: Truth = None,
) -> None:
    """Say whether a tracker has slipped since the calibration, from ordinary motion.

    Walk about and turn. Exit code 1 if a tracker sits elsewhere than the subject file says.
    """
    from calibration import motion_command

    options = motion_command.MotionOptions(
        config, recording, simulate, seconds, database, seed, truth
    )
    motion_command.check(subject, options)


@app.command()
def refine(
    subject: SubjectFile,
    out: Out,
    config: Config = None,
    recording: Recording = None,
    simulate: Simulate = None,
    seconds: Seconds = 60.0,
    database: Database = None,
    seed: Seed = 0,
    truth: Truth = None,
) -> None:
    """Improve lengths and where the trackers sit from a minute of ordinary motion.

    Walk about, turn, sit down, reach for things, whatever the poses of the database are like.
    What the eight poses have found (SUBJECT and the file SUBJECT.known.json beside it) is
    weighed against what motion shows; the better subject knows how good it is, and may be
    refined again. Motion unlike any in the database changes little.
    """
    from calibration import motion_command

    options = motion_command.MotionOptions(
        config, recording, simulate, seconds, database, seed, truth
    )
    motion_command.refine(subject, out, options)
