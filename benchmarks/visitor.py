"""A visitor of the live view without a screen: takes everything that a browser takes.

    python -m benchmarks.visitor http://127.0.0.1:8080/

It speaks both WebSockets of the page: it asks for pictures as often as a browser does, receives
the panels' drawing and the body's state, and acknowledges. What it does not do is draw, which
elsewhere falls to the graphics hardware of another machine.
"""

import asyncio
import math
import struct
import time
from dataclasses import dataclass
from typing import Annotated, Final

import typer
from websockets.asyncio.client import ClientConnection, connect
from websockets.typing import Origin

WIDTH, HEIGHT = 1000, 600
"""Of the window that it claims to have [pixels]."""

RATE: Final = 60.0
"""How often it asks for pictures [Hz]."""

# The first packet of NetImgui 1.13 (protocol 18): a client's name and its versions.
_HELLO: Final = struct.pack(
    "<IB3x64s16s16sIIIB3x", 120, 0, b"visitor", b"1.92.9b", b"1.13.0", 18, 19291, 11300, 2
)
_INPUT_SIZE: Final = 616
_MOMENT: Final = 0.2


def input_packet(frames_per_second: float) -> bytes:
    """What a browser says of its window, with no key and no button pressed."""
    packet = bytearray(_INPUT_SIZE)
    struct.pack_into("<IB3xHH", packet, 0, _INPUT_SIZE, 2, WIDTH, HEIGHT)
    struct.pack_into("<?xff", packet, 538, True, 1.0, frames_per_second)
    return bytes(packet)


async def visit(url: str, seconds: float, enough: float = math.inf) -> tuple[int, int]:
    """Stay for so long, or until enough has come.

    Args:
        url: of the page.
        seconds: how long at most [s].
        enough: states and pieces of panels after which to leave.

    Returns:
        States of the body and pieces of panels that came.
    """
    address = url.rstrip("/")
    sockets = address.replace("http", "ws", 1)
    end = time.monotonic() + seconds
    origin = Origin(address)
    async with (
        connect(f"{sockets}/state?sid=v", origin=origin, compression=None) as state,
        connect(f"{sockets}/ui?sid=v", origin=origin, compression=None, max_size=None) as panels,
    ):
        await panels.send(_HELLO)
        seen = Seen(end, enough)
        await asyncio.gather(_acknowledge(state, seen), _take(panels, seen), _ask(panels, seen))
    return seen.states, seen.pieces


@dataclass
class Seen:
    """What has come, and how long to stay.

    Attributes:
        end: when to leave [s].
        enough: states and pieces after which to leave before.
        states: of the body.
        pieces: of panels.
    """

    end: float
    enough: float
    states: int = 0
    pieces: int = 0

    @property
    def left(self) -> float:
        """How long to stay yet [s]."""
        if min(self.states, self.pieces) >= self.enough:
            return 0.0
        return max(0.0, self.end - time.monotonic())


async def _acknowledge(state: ClientConnection, seen: Seen) -> None:
    while seen.left:
        message = await _next(state)
        if isinstance(message, bytes):
            seen.states += 1
            await state.send("state_ack")


async def _take(panels: ClientConnection, seen: Seen) -> None:
    while seen.left:
        seen.pieces += await _next(panels) is not None


async def _ask(panels: ClientConnection, seen: Seen) -> None:
    while seen.left:
        await panels.send(input_packet(RATE))
        await asyncio.sleep(1.0 / RATE)


async def _next(connection: ClientConnection) -> str | bytes | None:
    """The next message; None if none comes for a moment."""
    try:
        return await asyncio.wait_for(connection.recv(), _MOMENT)
    except TimeoutError:
        return None


def main(
    url: Annotated[str, typer.Argument(help="Of the page.")],
    seconds: Annotated[float, typer.Option(help="How long to stay [s].")] = 10.0,
) -> None:
    """Visit a page and say what came."""
    states, pieces = asyncio.run(visit(url, seconds))
    print(f"{states / seconds:.1f} states and {pieces / seconds:.1f} pieces of panels a second")


if __name__ == "__main__":
    typer.run(main)
