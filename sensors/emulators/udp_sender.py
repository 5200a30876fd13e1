"""A socket that sends datagrams and does not mind if nobody listens."""

import contextlib
import socket

from sensors.errors import ConfigurationError


class UdpSender:
    """Sends to one address.

    Args:
        host: address or name.
        port: UDP port.

    Raises:
        ConfigurationError: if the host has no address.
    """

    def __init__(self, host: str, port: int) -> None:
        try:
            self._to = (socket.gethostbyname(host), port)
        except OSError as error:
            raise ConfigurationError(
                f"{host} has no address: {error.strerror or error}; give its IP address"
            ) from error
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self.address = f"udp://{host}:{port}"

    def send(self, data: bytes) -> None:
        """Send one datagram, or not."""
        # A closed port answers with an error on the next send; that is no concern of ours.
        with contextlib.suppress(OSError):
            self._socket.sendto(data, self._to)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
