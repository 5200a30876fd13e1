"""Commands: `localreg sensors emulate`, `list`, `monitor`, `record`, `replay` and `align`."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from sensors.errors import SensorError

app = typer.Typer(
    name="sensors",
    help="Trackers: find, watch, record, replay, align and emulate them.",
    no_args_is_help=True,
    add_completion=False,
)


@contextlib.contextmanager
def _plain_errors() -> Iterator[None]:
    """One sentence to stderr and exit code 1 instead of a traceback."""
    try:
        yield
    except SensorError as error:
        typer.echo(f"error: {error}", err=True)
        raise typer.Exit(1) from None
    except KeyboardInterrupt:
        raise typer.Exit(0) from None


@app.callback()
def main() -> None:
    """Trackers: find, watch, record, replay, align and emulate them."""


@app.command()
def emulate(
    playback: Annotated[
        Path | None,
        typer.Argument(
            help="Playback file (.npz) or recording (.mcap); without one the stations wander."
        ),
    ] = None,
    protocol: Annotated[
        str, typer.Option(help="is900, is900-udp, vrpn, vmc (OSC) or vrchat (OSC).")
    ] = "is900",
    to: Annotated[str, typer.Option(help="HOST:PORT that is900-udp, vmc and vrchat send to.")] = "",
    stations: Annotated[int, typer.Option(help="Stations without a playback file.")] = 6,
    rate: Annotated[float, typer.Option(help="Cycles a second [Hz].")] = 40.0,
    tcp: Annotated[str, typer.Option(help="Listen on HOST:PORT (is900, vrpn); port 0: any.")] = "",
    link: Annotated[
        Path | None, typer.Option(help="Also make this symbolic link to the pseudo terminal.")
    ] = None,
    start: Annotated[
        str, typer.Option(help="What begins the motion: continuous (mode), now, or later.")
    ] = "continuous",
    at_end: Annotated[
        str, typer.Option(help="After the last row of a playback file: hold, loop or exit.")
    ] = "hold",
    baud: Annotated[int, typer.Option(help="Let bytes take their time; 0: at once.")] = 0,
    noise_position: Annotated[float, typer.Option(help="Standard deviation [m].")] = 0.0,
    noise_orientation: Annotated[float, typer.Option(help="Standard deviation [deg].")] = 0.0,
    seed: Annotated[int, typer.Option(help="Seed of noise and faults.")] = 0,
    clock_drift: Annotated[float, typer.Option(help="Drift of the device's clock [s/s].")] = 0.0,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            help="junk, truncation, corruption, silence, stall, power-cycle, jump, dropout or "
            "swap, for example jump,station=3,start=2,duration=1,dx=0.5; may repeat."
        ),
    ] = None,
    control: Annotated[
        bool,
        typer.Option(help="Obey lines on stdin: begin, fault ..., quit; end of input quits."),
    ] = False,
) -> None:
    """Be a tracker: an IS-900 on a pseudo terminal, a VRPN server, a sender of OSC.

    Events go to stdout, one JSON object a line: `ready` with the address to open, `start`
    with the host's monotonic time of motion zero, `end` with counters.
    """
    from sensors.emulators.run import EmulateOptions, run_emulator

    with _plain_errors():
        run_emulator(
            EmulateOptions(
                playback=playback,
                protocol=protocol,
                to=to,
                stations=stations,
                rate=rate,
                tcp=tcp,
                link=link,
                start=start,
                at_end=at_end,
                baud=baud,
                noise_position=noise_position,
                noise_orientation=noise_orientation,
                seed=seed,
                clock_drift=clock_drift,
                faults=tuple(fault or ()),
                control=control,
            )
        )


Target = Annotated[
    str,
    typer.Argument(
        help="/dev/ttyUSB0, socket://HOST:PORT, vrpn://HOST, is900-udp://[HOST]:PORT, "
        "vmc://[HOST]:PORT, vrchat://[HOST]:PORT, or a recording (.mcap)."
    ),
]


def _found(ctx: Any, file: Path | None) -> Path | None:
    """The file that `--config` means: a program around us may know some by name."""
    find = (ctx.obj or {}).get("find_config", Path)
    return None if file is None else find(str(file))


ConfigFile = Annotated[
    Path | None,
    typer.Option(
        "--config",
        metavar="NAME|FILE",
        callback=_found,
        help="Take the devices from this configuration instead.",
    ),
]
Stations = Annotated[
    list[str] | None,
    typer.Option("--station", help="TRACKER=STATION, like head=1; may repeat. Default: all."),
]
Wait = Annotated[bool, typer.Option("--wait", help="Wait for devices that are not there (yet).")]


@app.command("list")
def list_ports(
    ports: Annotated[
        list[str] | None, typer.Argument(help="Also look at these, like socket://HOST:PORT.")
    ] = None,
    probe: Annotated[
        bool, typer.Option(help="Ask each port what it is; this stops a running stream.")
    ] = True,
) -> None:
    """List serial ports and what answers on them."""
    from sensors.commands.listing import show_ports

    with _plain_errors():
        if not show_ports(ports or (), probe):
            typer.echo("no serial ports; plug one in, or try: localreg sensors emulate")


@app.command()
def monitor(
    target: Target = "",
    config: ConfigFile = None,
    station: Stations = None,
    seconds: Annotated[float, typer.Option(help="Stop after this long; 0: on Ctrl-C.")] = 0.0,
    wait: Wait = False,
) -> None:
    """Watch devices: rate, age, jitter, quality and rejected bytes, live.

    localreg sensors monitor /dev/ttyUSB0

    localreg sensors monitor --config is900
    """
    from sensors.commands.monitor import watch
    from sensors.targets import chosen

    with _plain_errors():
        watch(chosen(target, config, station or ()), seconds, wait)


@app.command()
def record(
    file: Annotated[Path, typer.Argument(help="Recording to make (.mcap); never overwritten.")],
    target: Target = "",
    config: ConfigFile = None,
    station: Stations = None,
    seconds: Annotated[float, typer.Option(help="Stop after this long; 0: on Ctrl-C.")] = 0.0,
    wait: Wait = False,
) -> None:
    """Record raw bytes, samples and frames; opens in Foxglove, survives a kill.

    localreg sensors record walk.mcap /dev/ttyUSB0 --station head=1 --station torso=2
    """
    from sensors.commands.record import record as run
    from sensors.targets import chosen

    with _plain_errors():
        run(chosen(target, config, station or ()), file, seconds, wait)


@app.command()
def replay(
    file: Annotated[Path, typer.Argument(help="A recording (.mcap).")],
    speed: Annotated[float, typer.Option(help="Seconds of the recording in one second.")] = 1.0,
    check: Annotated[
        bool,
        typer.Option("--check", help="Make the frames again from the raw bytes and compare."),
    ] = False,
) -> None:
    """Play a recording back: every byte, at the time it came.

    In a configuration, driver = "replay" with file = "..." does the same for any command.
    """
    from sensors.commands.monitor import watch
    from sensors.commands.record import check as compare
    from sensors.config import SensorsConfig

    with _plain_errors():
        if check:
            compare(file)
        else:
            device = {"driver": "replay", "file": str(file), "speed": speed}
            watch(SensorsConfig.parse({"devices": [device]}), 0.0, wait=False)


@app.command()
def align(
    config: Annotated[Path, typer.Option(help="Configuration file; its [room] is written.")],
    seconds: Annotated[float, typer.Option(help="How long to measure [s].")] = 3.0,
    countdown: Annotated[float, typer.Option(help="Time to take position before [s].")] = 5.0,
    ankle_height: Annotated[
        float, typer.Option(help="Of the ankle trackers above the floor, standing [m].")
    ] = 0.08,
    keep_floor: Annotated[
        bool, typer.Option("--keep-floor", help="The trackers' own height is right.")
    ] = False,
    origin: Annotated[str, typer.Option(help="Tracker above the origin; default torso.")] = "",
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show, but write nothing.")] = False,
) -> None:
    """Find floor, origin and forward direction from a few seconds of standing.

    Stand upright and still at the origin, facing forward, arms hanging.

    localreg sensors align --config configs/is900.toml
    """
    from sensors.alignment import AlignmentConfig
    from sensors.commands.align import align_room

    with _plain_errors():
        settings = AlignmentConfig(
            floor="keep" if keep_floor else "ankles", ankle_height=ankle_height, origin=origin
        )
        align_room(config, settings, seconds=seconds, countdown=countdown, write=not dry_run)
