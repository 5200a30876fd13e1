"""A UDP port that hears what one sender, or anybody, says."""

import os
import select
import socket

from sensors.errors import ConnectionFailedError, LinkLostError

_LARGEST = 65536


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
        self._wake_read, self._wake_write = os.pipe()
        self.port: int = self._socket.getsockname()[1]

    def read(self, timeout: float) -> bytes:
        """The next datagram.

        Args:
            timeout: longest wait [s].

        Returns:
            Its bytes; empty after the timeout or `wake`, for a datagram without bytes, and
            for other senders, which count in `foreign`.

        Raises:
            LinkLostError: if the port is gone.
        """
        try:
            ready, _, _ = select.select([self._socket, self._wake_read], [], [], timeout)
            if self._socket not in ready:
                return b""
            data, (address, *_) = self._socket.recvfrom(_LARGEST)
        except BlockingIOError:
            return b""
        except (OSError, ValueError) as error:
            raise LinkLostError(f"the UDP port is lost: {error}") from error
        if self._senders and address not in self._senders:
            self.foreign += 1
            return b""
        return data

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
