"""UDP to one peer, never waiting."""

import socket
from collections.abc import Callable, Iterable

from localreg.errors import LocalregError
from localreg.live.sinks.base import LivePose, Sink

Encode = Callable[[LivePose], Iterable[bytes]]
"""A pose as the datagrams of some protocol."""


class DatagramSender:
    """Sends datagrams; what the system cannot take at once is dropped and counted.

    Args:
        host: name or address of the peer.
        port: its UDP port.

    Attributes:
        sent: datagrams handed to the system.
        dropped: datagrams it had no room for.

    Raises:
        LocalregError: there is no such host.
    """

    def __init__(self, host: str, port: int) -> None:
        try:
            family, kind, protocol, _, self._peer = socket.getaddrinfo(
                host, port, type=socket.SOCK_DGRAM
            )[0]
        except OSError as error:
            raise LocalregError(
                f"cannot send to {host}:{port}: {error.strerror}; give a host's name or address"
            ) from error
        self.sent = self.dropped = 0
        self._socket = socket.socket(family, kind, protocol)
        self._socket.setblocking(False)

    def send(self, data: bytes) -> None:
        """Send one datagram.

        Raises:
            OSError: the network refuses it, for example for want of a route.
        """
        try:
            self._socket.sendto(data, self._peer)
        except BlockingIOError:
            self.dropped += 1
            return
        self.sent += 1

    def close(self) -> None:
        """Close the socket. Doing so twice is no error."""
        self._socket.close()


class DatagramSink(Sink):
    """Sends every pose, as some encoder has it, to one peer.

    Args:
        protocol: what the encoder speaks, for messages.
        encode: the encoder.
        host: name or address of the peer.
        port: its UDP port.

    Raises:
        LocalregError: there is no such host.
    """

    def __init__(self, protocol: str, encode: Encode, host: str, port: int) -> None:
        self.name = f"{protocol} to {host}:{port}"
        self._encode = encode
        self._sender = DatagramSender(host, port)

    def publish(self, live: LivePose) -> None:
        """Send one pose."""
        for datagram in self._encode(live):
            self._sender.send(datagram)

    @property
    def dropped(self) -> int:
        """Datagrams that the system had no room for."""
        return self._sender.dropped

    def close(self) -> None:
        """Close the socket."""
        self._sender.close()
