"""The command `localreg`: finds its sub-commands and imports only the one that is used.

The built-in ones are in the table below. Other packages bring theirs by entry points of
the group `localreg.commands`: a typer application, or a function that becomes a command.
"""

import difflib
import os
import sys
from importlib import import_module
from importlib.metadata import PackageNotFoundError, entry_points, version
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, Final, NamedTuple

import typer
from typer.core import TyperGroup

GROUP: Final = "localreg.commands"
"""Entry point group of further commands."""


class Command(NamedTuple):
    """Where a command is, and what it does in a few words.

    Attributes:
        target: `module:attribute`, a typer application or a function.
        summary: for the list of commands, which imports none of them.
    """

    target: str
    summary: str


BUILT_IN: Final = {
    "demo": Command(
        "localreg.commands.demo:demo", "Play real walks through a serial line and synthesize them."
    ),
    "data": Command("localreg.commands.data:app", "Motions to learn from: list, fetch more."),
    "db": Command("localreg.commands.db:app", "Build a pose database, or look at one."),
    "run": Command(
        "localreg.commands.run:app", "Turn live trackers into motion and send it out, for hours."
    ),
    "synthesize": Command("localreg.commands.synthesize:app", "Turn trackers into a motion file."),
    "convert": Command(
        "localreg.commands.convert:app", "Turn motion files into other kinds, and clean them."
    ),
    "view": Command(
        "localreg.commands.view:app", "See a motion: window, browser, picture or video."
    ),
    "evaluate": Command(
        "localreg.commands.evaluate:app", "Measure how well motion is synthesized."
    ),
    "doctor": Command(
        "localreg.commands.doctor:app", "Say what works on this machine and what to do."
    ),
}
"""The commands of this package, in the order of the list."""

# What the commands of our other packages do; importing them to ask would take too long.
_SUMMARIES: Final = {
    "calibrate": "Fit the body model to a person in eight poses.",
    "sensors": "Trackers: emulate, list, record, replay and watch them.",
}

_DEBUG: Final = "--debug"


class LazyGroup(TyperGroup):
    """A group of commands that are imported when they are called."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Names of all commands that are installed."""
        return list(_commands())

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """The command of a name, imported; None if there is no such command."""
        command = _commands().get(cmd_name)
        return None if command is None else _load(cmd_name, command)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """As always, but an unknown name is answered with the ones that are near."""
        known = _commands()
        if args and args[0] not in known and not args[0].startswith("-"):
            near = difflib.get_close_matches(args[0], known, n=2)
            hint = f"did you mean {' or '.join(near)}?" if near else f"try {', '.join(known)}"
            ctx.fail(f"no command {args[0]!r}; {hint}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """The list of commands, without importing any."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, entry.summary) for name, entry in _commands().items()])

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As always, but `--debug` may stand anywhere."""
        end = args.index("--") if "--" in args else len(args)
        ctx.obj = {"debug": _DEBUG in args[:end], "find_config": _find_config}
        args = [arg for i, arg in enumerate(args) if arg != _DEBUG or i >= end]
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; what the user can mend is one sentence, not a traceback."""
        from localreg.errors import LocalregError
        from sensors.errors import SensorError

        try:
            return super().invoke(ctx)
        except (LocalregError, SensorError) as error:
            if ctx.obj["debug"]:
                raise
            typer.echo(f"error: {error}", err=True)
            raise typer.Exit(1) from None
        except BrokenPipeError:
            # Whoever read the output has seen enough; let the interpreter not complain.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise typer.Exit(0) from None


app = typer.Typer(
    cls=LazyGroup,
    name="localreg",
    help="Turn six 6-DoF trackers into the motion of a whole body.",
    epilog="""Start with `localreg demo`, or on your own motions with
    `localreg db build FOLDER --out DATABASE` and `localreg evaluate FOLDER`.
    `localreg COMMAND --help` shows examples; `localreg doctor` checks this machine.""",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _print_version(value: bool) -> bool:
    if value:
        try:
            typer.echo(f"localreg {version('localreg-mocap')}")
        except PackageNotFoundError:
            typer.echo("localreg (not installed)")
        raise typer.Exit
    return value


@app.callback()
def _options(
    debug: Annotated[
        bool, typer.Option(_DEBUG, help="Show the traceback of an error (may stand anywhere).")
    ] = False,
    show_version: Annotated[
        bool,
        typer.Option(
            "--version", help="Print the version.", callback=_print_version, is_eager=True
        ),
    ] = False,
) -> None:
    """Turn six 6-DoF trackers into the motion of a whole body."""


def main() -> None:
    """Run the command line."""
    from localreg.compile_cache import keep_compiled_code

    keep_compiled_code()
    app()


def _find_config(name: str) -> Path:
    """For commands of other packages that take a configuration."""
    from localreg.live.config_files import find_config

    return find_config(name)


def _commands() -> dict[str, Command]:
    """All commands that are installed, by name."""
    found = {name: c for name, c in BUILT_IN.items() if _is_there(c.target)}
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
        if _is_there(entry.value):
            found.setdefault(entry.name, Command(entry.value, _summary(entry)))
    return found


def _is_there(target: str) -> bool:
    try:
        return find_spec(target.partition(":")[0]) is not None
    except ModuleNotFoundError:
        return False


def _summary(entry: Any) -> str:
    if entry.name in _SUMMARIES:
        return _SUMMARIES[entry.name]
    return f"From {entry.dist.name}." if entry.dist is not None else ""


def _load(name: str, command: Command) -> Any:
    """The command as the parser wants it, from an application or a function."""
    module, _, attribute = command.target.partition(":")
    target = getattr(import_module(module), attribute)
    if not isinstance(target, typer.Typer):
        own = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        own.command(name, epilog=getattr(target, "epilog", None))(target)
        target = own
    loaded = typer.main.get_command(target)
    loaded.name = name
    _make_plain(loaded)
    return loaded


def _make_plain(command: Any) -> None:
    """Plain help for a command and its own: rich markup takes units such as [m] for styles."""
    command.rich_markup_mode = None
    for own in getattr(command, "commands", {}).values():
        _make_plain(own)
