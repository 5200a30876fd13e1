"""Which addresses processes listen on."""

import contextlib
from pathlib import Path

from tests.localreg.live.daemons import listening_sockets

_LOOPBACK = ("0100007F", "00000000000000000000000001000000")


def ports_beyond_loopback(pid: int) -> set[str]:
    """Addresses other than loopback on which a process listens, as /proc writes them."""
    found = set().union(*listening_sockets(pid).values())
    return {address for address in found if address.partition(":")[0] not in _LOOPBACK}


def listens_on(pid: int, port: int) -> bool:
    """Whether a process listens on a TCP port of 127.0.0.1."""
    return f"0100007F:{port:04X}" in listening_sockets(pid)["tcp"]


def family_of(pid: int) -> list[int]:
    """A process and all its descendants."""
    family = [pid]
    for task in Path(f"/proc/{pid}/task").iterdir():
        with contextlib.suppress(OSError):
            for child in (task / "children").read_text().split():
                family += family_of(int(child))
    return family
