"""Tells systemd that the run is ready, alive or stopping; elsewhere does nothing.

Protocol: sd_notify(3), a datagram to the socket named by NOTIFY_SOCKET.
"""

import contextlib
import os
import socket


def notify(state: str) -> None:
    """Send a state such as `READY=1`, `WATCHDOG=1` or `STOPPING=1`."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return
    if address.startswith("@"):  # the abstract name space
        address = "\0" + address[1:]
    with (
        contextlib.suppress(OSError),
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager,
    ):
        manager.setblocking(False)
        manager.sendto(state.encode(), address)
