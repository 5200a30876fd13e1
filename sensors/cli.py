"""Commands: `localreg sensors emulate`, `list` and `monitor`."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer

from sensors.errors import SensorError

app = typer.Typer(
    name="sensors",
    help="Trackers: emulate a device, list ports, watch a stream.",
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
    """Trackers: emulate a device, list ports, watch a stream."""


@app.command()
def emulate(
    playback: Annotated[
        Path | None,
        typer.Argument(help="Playback file (.npz); without one the stations wander about."),
    ] = None,
    stations: Annotated[int, typer.Option(help="Stations without a playback file.")] = 6,
    rate: Annotated[float, typer.Option(help="Cycles a second [Hz].")] = 40.0,
    tcp: Annotated[
        str, typer.Option(help="Listen on HOST:PORT instead of a pseudo terminal; port 0: any.")
    ] = "",
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
        typer.Option(help="For example jump,station=3,start=2,duration=1,dx=0.5; may repeat."),
    ] = None,
    control: Annotated[
        bool,
        typer.Option(help="Obey lines on stdin: begin, fault ..., quit; end of input quits."),
    ] = False,
) -> None:
    """Be an IS-900 on a pseudo terminal or TCP port, until interrupted.

    Events go to stdout, one JSON object a line: `ready` with the address to open, `start`
    with the host's monotonic time of motion zero, `end` with counters.
    """
    from sensors.emulators.run import EmulateOptions, run_emulator

    with _plain_errors():
        run_emulator(
            EmulateOptions(
                playback=playback,
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


@app.command("list")
def list_ports() -> None:
    """List the serial ports of this machine."""
    from rich.console import Console
    from rich.table import Table
    from serial.tools import list_ports as ports

    table = Table("port", "description", "hardware")
    found = sorted(ports.comports())
    for port in found:
        table.add_row(port.device, port.description, port.hwid)
    if found:
        Console().print(table)
    else:
        typer.echo("no serial ports; plug one in, or try: localreg sensors emulate")


@app.command()
def monitor(
    port: Annotated[str, typer.Argument(help="Device path, or socket://host:port.")],
    stations: Annotated[int, typer.Option(help="Watch stations 1 to this.")] = 6,
    baud: Annotated[int, typer.Option(help="Line rate [bit/s].")] = 115200,
    seconds: Annotated[float, typer.Option(help="Stop after this long; 0: on Ctrl-C.")] = 0.0,
) -> None:
    """Watch an IS-900: rate, age, jitter and rejected records of each station."""
    from sensors.monitor import watch

    with _plain_errors():
        watch(port, stations, baud, seconds)
