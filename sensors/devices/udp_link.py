"""A UDP port that hears what one sender, or anybody, says."""

import contextlib
import os
import select
import socket
import struct
import time
from collections.abc import Sequence

from sensors.errors import ConnectionFailedError, LinkLostError

_LARGEST = 65536
# Linux: the kernel notes when a datagram came. Not among Python's constants.
_SO_TIMESTAMPNS = 35
_TIMESPEC = struct.Struct("@qq")
_NOTES = socket.CMSG_SPACE(_TIMESPEC.size)
# A note older than this speaks of a clock that was set meanwhile.
_OLDEST = 10.0


class UdpLink:
    """An open UDP port.

    The port is not shared: where two programs may bind the same port, one of them hears
    nothing and does not know why.

    Args:
        host: local address to listen on.
        port: UDP port; 0 for any free one.
        sender: address or name of the only host that is listened to; empty: anybody.

    Raises:
        ConnectionFailedError: if the port cannot be had, or the sender has no address.
    """

    def __init__(self, host: str, port: int, sender: str = "") -> None:
        self.foreign = 0
        self._senders = _addresses(sender) if sender else frozenset[str]()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise ConnectionFailedError(
                f"cannot listen on UDP port {port} of {host}: {error.strerror or error}; close "
                "the other program that has it, or choose another port"
            ) from error
        self._socket.setblocking(False)
        with contextlib.suppress(OSError):
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        self._wake_read, self._wake_write = os.pipe()
        self.port: int = self._socket.getsockname()[1]

    def read(self, timeout: float) -> tuple[bytes, float]:
        """The next datagram.

        Args:
            timeout: longest wait [s].

        Returns:
            Its bytes, and when it arrived on the host's monotonic clock [s], even if nobody
            had time to read it then. Empty after the timeout or `wake`, for a datagram without
            bytes, and for other senders, which count in `foreign`.

        Raises:
            LinkLostError: if the port is gone.
        """
        try:
            ready, _, _ = select.select([self._socket, self._wake_read], [], [], timeout)
            if self._socket not in ready:
                return b"", time.monotonic()
            data, notes, _, (address, *_) = self._socket.recvmsg(_LARGEST, _NOTES)
        except BlockingIOError:
            return b"", time.monotonic()
        except (OSError, ValueError) as error:
            raise LinkLostError(f"the UDP port is lost: {error}") from error
        if self._senders and address not in self._senders:
            self.foreign += 1
            return b"", time.monotonic()
        return data, _arrival(notes)

    def wake(self) -> None:
        """Let `read` return at once, now and from now on; from any thread."""
        os.write(self._wake_write, b"\0")

    def close(self) -> None:
        """Close the port."""
        self._socket.close()
        os.close(self._wake_read)
        os.close(self._wake_write)


def _addresses(name: str) -> frozenset[str]:
    try:
        found = socket.getaddrinfo(name, None, socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        raise ConnectionFailedError(
            f"the sender {name} has no address: {error.strerror or error}; give its IP address"
        ) from error
    return frozenset(str(address[0]) for *_, address in found)


def _arrival(notes: Sequence[tuple[int, int, bytes]]) -> float:
    """Monotonic time of a datagram's arrival [s], by the kernel's note if there is one."""
    now = time.monotonic()
    for level, kind, data in notes:
        if (level, kind, len(data)) == (socket.SOL_SOCKET, _SO_TIMESTAMPNS, _TIMESPEC.size):
            seconds, nanoseconds = _TIMESPEC.unpack(data)
            age = time.time() - (seconds + 1e-9 * nanoseconds)
            if 0.0 <= age < _OLDEST:
                return now - age
    return now
