"""Serial ports, and what answers on them."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

from rich.console import Console
from rich.table import Table
from serial.tools import list_ports

from sensors.devices.serial_link import SerialLink
from sensors.errors import ConnectionFailedError, MalformedRecordError
from sensors.protocols.is900 import Parser, Record, Response, commands, parse_status
from sensors.protocols.is900.responses import parse_station_flags

_ANSWER_TIME = 0.6
_BAUDS = (115200, 38400, 9600)


@dataclass(frozen=True, slots=True)
class Answer:
    """What was found on a port.

    Attributes:
        words: for a human.
        is_tracker: whether it is one that we can read.
    """

    words: str
    is_tracker: bool = False


def show_ports(extra: Sequence[str], probe: bool) -> bool:
    """Print a table of ports.

    Args:
        extra: ports to look at besides those the system knows, such as `socket://...`.
        probe: ask each what it is; that stops a tracker's stream.

    Returns:
        Whether there are any.
    """
    known = {p.device: p.description for p in sorted(list_ports.comports())}
    ports = known | dict.fromkeys(extra, "named by you")
    table = Table("port", "description", "answer")
    for port, description in ports.items():
        answer = ask(port) if probe else Answer("not asked")
        table.add_row(port, description, answer.words)
    if ports:
        Console().print(table)
    return bool(ports)


def ask(port: str) -> Answer:
    """Ask a port for the status record of an IS-900 at the usual rates."""
    heard = 0
    bauds = _BAUDS if "://" not in port else _BAUDS[:1]
    for baud in bauds:
        try:
            link = SerialLink(port, baud)
        except ConnectionFailedError as error:
            return Answer(str(error))
        try:
            answer, count = _converse(link)
        except ConnectionFailedError as error:
            return Answer(str(error))
        finally:
            link.close()
        if answer:
            return Answer(f"{answer} at {baud} baud", is_tracker=True)
        heard += count
    if heard:
        return Answer(f"{heard} bytes of something else")
    return Answer("nothing answers")


def _converse(link: SerialLink) -> tuple[str, int]:
    """What the device calls itself, and how many bytes came."""
    link.write(commands.RESUME + commands.STOP + commands.STATUS + commands.ALL_STATIONS)
    parser = Parser({})
    name, stations, heard = "", "", 0
    give_up = time.monotonic() + _ANSWER_TIME
    while (left := give_up - time.monotonic()) > 0.0 and not (name and stations):
        data = link.read(left)
        heard += len(data)
        for message in parser.feed(data):
            if isinstance(message, Record):
                continue
            name, stations = name or _name(message), stations or _stations(message)
    return (f"{name}{stations}" if name else "", heard)


def _name(response: Response) -> str:
    try:
        status = parse_status(response)
    except MalformedRecordError:
        return ""
    return f"{status.identification or 'IS-900'}, firmware {status.version or 'unknown'}"


def _stations(response: Response) -> str:
    try:
        flags = parse_station_flags(response)
    except MalformedRecordError:
        return ""
    on = [str(n) for n, flag in enumerate(flags, start=1) if flag]
    return f", stations {', '.join(on) or 'none'}"
