"""`localreg run`: trackers in, poses out, for hours."""

from pathlib import Path
from typing import Annotated

import typer

from localreg.commands.view_arguments import PagePort, View

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command(
    epilog="""Examples:

localreg run --config demo  (real walks, no device needed; poses go to VMC)

localreg run --config demo --view web  (then open the address that it prints)

localreg run --config is900 --subject anna.toml --record take1.mcap

localreg run --config my.toml --status-port 8900, then: curl 127.0.0.1:8900 and
curl -X POST 127.0.0.1:8900/recenter

chrt -f 5 localreg run --config is900  (real-time priority on a busy machine, as root)

Copy a configuration that comes along to change it: localreg run --config is900 --show"""
)
def run(
    config: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="A configuration that comes along, or a TOML.")
    ],
    database: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Poses to learn from; default: the sample set.", show_default=False
        ),
    ] = None,
    subject: Annotated[
        Path | None,
        typer.Option(help="Who wears the trackers (TOML); default: usual proportions."),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(help="Stop after so long [s]; default: on Ctrl-C or SIGTERM.")
    ] = None,
    view: Annotated[
        View, typer.Option(help="Watch live: a page for browsers on this machine, or a window.")
    ] = View.NONE,
    view_port: PagePort = None,
    takes: Annotated[
        Path, typer.Option(metavar="DIR", help="Where the view's buttons write motion files.")
    ] = Path("takes"),
    record: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="Record to a new file: .mcap holds everything and can be solved anew, .bvh and "
            ".amc hold the motion. May repeat.",
        ),
    ] = None,
    status_port: Annotated[
        int | None,
        typer.Option(
            min=0, max=65535, help="Serve the state on this port of 127.0.0.1; 0: any free one."
        ),
    ] = None,
    health: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|-", help="Write the state as a line of JSON every second; -: to stderr."
        ),
    ] = None,
    host: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS",
            help="Where servers for other machines (VRPN, the page of --view web) listen; "
            "0.0.0.0: on every network.",
        ),
    ] = "127.0.0.1",
    json: Annotated[
        Path | None, typer.Option(help="Write the final state to this JSON file.")
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Only look whether the configuration is good.")
    ] = False,
    show: Annotated[bool, typer.Option("--show", help="Print the configuration file.")] = False,
) -> None:
    """Turn trackers into the motion of a whole body and send it out, until stopped.

    Trackers, room, method and outputs come from the configuration. A device that is lost is
    waited for; a frame that cannot be solved shows the last good pose. SIGINT (Ctrl-C) and
    SIGTERM stop cleanly with all files closed. SIGUSR1, or POST /recenter on the status
    port, makes the performer's present place the origin and the present heading ahead.
    """
    from contextlib import ExitStack

    from localreg.commands.console import notes, output
    from localreg.live.config_files import find_config

    file = find_config(config)
    if show:
        output().print(file.read_text(encoding="utf-8"), end="", soft_wrap=True)
        return

    from localreg.live.config import read_run_config
    from localreg.live.run_options import RunOptions, wearer_of
    from localreg.live.status_server import ADDRESS, StatusServer
    from localreg.live.view_options import ViewOptions

    settings = read_run_config(file)
    options = RunOptions(
        database=database,
        subject=subject,
        seconds=seconds,
        record=tuple(record or ()),
        health=health,
        host=host,
        view=ViewOptions(view.value, host, view_port, takes),
    )
    wearer = wearer_of(settings, options)
    if check:
        output().print(
            f"{file}: good; {len(settings.devices)} devices, trackers "
            f"{', '.join(wearer.trackers)}, method {settings.synthesis.method}, outputs "
            f"{', '.join(o.protocol for o in settings.outputs) or 'none'}",
            soft_wrap=True,
        )
        return
    console = notes()

    def tell(words: str) -> None:
        console.print(words, soft_wrap=True)

    with ExitStack() as stack:
        status = None
        if status_port is not None:
            status = StatusServer(status_port)
            stack.callback(status.close)
            tell(f"status: http://{ADDRESS}:{status.port}/")
        from localreg.live import daemon

        last = daemon.run(settings, options, tell, status)
    output().print(
        f"{last['frames']} frames, {last['late_frames']} late ({last['late_percent']:.2f} %), "
        f"{last['held_frames']} held, {last['dropped_samples']} samples dropped",
        soft_wrap=True,
    )
    if json is not None:
        from localreg.evaluation.results import write_json

        write_json(last, json)
