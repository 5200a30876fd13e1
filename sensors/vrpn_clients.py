"""The server's side of VRPN: a port, and the clients that came to it.

Clients may connect by TCP, or ask by UDP and be called back. No thread of its own: whoever
has one waits for `sockets` and hands those that have something to `receive`.
"""

import contextlib
import socket
import time
from collections.abc import Collection
from dataclasses import dataclass, field

from sensors.errors import MalformedRecordError
from sensors.protocols import vrpn

DEVICE = 1
"""Number of the sender of poses."""

TYPES = (vrpn.PING, vrpn.PONG, vrpn.POSE)
"""Types of message by their numbers."""

_MAX_CLIENTS = 16
_READ_SIZE = 65536
_CALL_BACK_TIMEOUT = 0.5


@dataclass(slots=True, eq=False)
class VrpnClient:
    """One connected client.

    Attributes:
        tcp: the connection.
        host: address it came from.
        reader: of what it sends.
        names: that it gave to its ids.
        udp_port: where it wants reports; 0: by TCP.
    """

    tcp: socket.socket
    host: str
    reader: vrpn.MessageReader = field(default_factory=lambda: vrpn.MessageReader(True))
    names: vrpn.NameTable = field(default_factory=vrpn.NameTable)
    udp_port: int = 0


class VrpnClients:
    """Everybody who is connected to a port; never blocks for long.

    A client that does not read is dropped, as VRPN's own servers do, for half a message
    cannot be mended.

    Args:
        host: address to listen on.
        port: port for TCP and UDP; 0 for any.
        device: name of the tracker, by which clients ask: `Tracker0@host`.

    Attributes:
        port: the port it listens on.

    Raises:
        OSError: the port cannot be had.
    """

    def __init__(self, host: str, port: int, device: str) -> None:
        self._senders = (vrpn.CONTROL, device)
        self._clients: list[VrpnClient] = []
        self._tcp = socket.create_server((host, port))
        self.port: int = self._tcp.getsockname()[1]
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._udp.bind((host, self.port))
        except OSError:
            self.close()
            raise
        self._tcp.setblocking(False)
        self._udp.setblocking(False)

    @property
    def sockets(self) -> list[socket.socket]:
        """What to wait on for `receive`."""
        return [self._tcp, self._udp, *(c.tcp for c in self._clients)]

    @property
    def present(self) -> tuple[VrpnClient, ...]:
        """Who is connected now."""
        return tuple(self._clients)

    def receive(self, ready: Collection[object]) -> int:
        """Serve those of `sockets` that have something.

        Returns:
            How many bytes clients sent by TCP.
        """
        count = sum(self._listen_to(c) for c in self.present if c.tcp in ready)
        if self._tcp in ready:
            with contextlib.suppress(OSError):
                tcp, (host, *_) = self._tcp.accept()
                self._welcome(tcp, host)
        if self._udp in ready:
            self._call_back()
        return count

    def send(self, client: VrpnClient, data: bytes) -> bool:
        """Send whole messages by TCP.

        Returns:
            Whether the client took them; if not, it has been dropped.
        """
        with contextlib.suppress(OSError):
            if client.tcp.send(data) == len(data):
                return True
        self._hang_up(client)
        return False

    def send_datagram(self, client: VrpnClient, data: bytes) -> None:
        """Send to the port that the client described, or not."""
        with contextlib.suppress(OSError):
            self._udp.sendto(data, (client.host, client.udp_port))

    def close(self) -> None:
        """Hang up and give the port back."""
        for client in self.present:
            self._hang_up(client)
        self._tcp.close()
        self._udp.close()

    def _call_back(self) -> None:
        with contextlib.suppress(OSError, MalformedRecordError):
            data, (sender, *_) = self._udp.recvfrom(_READ_SIZE)
            host, port = vrpn.decode_connection_request(data)
            # Only who asks is called: a forged request must not make us knock elsewhere.
            if host == sender:
                self._welcome(socket.create_connection((host, port), _CALL_BACK_TIMEOUT), host)

    def _welcome(self, tcp: socket.socket, host: str) -> None:
        if len(self._clients) >= _MAX_CLIENTS:
            tcp.close()
            return
        tcp.setblocking(False)
        tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client = VrpnClient(tcp, host)
        self._clients.append(client)
        out = bytearray(vrpn.COOKIE)
        for number, name in enumerate(self._senders):
            out += vrpn.description(vrpn.SENDER_DESCRIPTION, number, name).encode()
        for number, name in enumerate(TYPES):
            out += vrpn.description(vrpn.TYPE_DESCRIPTION, number, name).encode()
        self.send(client, bytes(out))

    def _listen_to(self, client: VrpnClient) -> int:
        data = b""
        try:
            data = client.tcp.recv(_READ_SIZE)
            if not data:
                raise ConnectionResetError
            for message in client.reader.feed(data):
                self._obey(client, message)
        except BlockingIOError:
            pass
        except (OSError, MalformedRecordError):
            self._hang_up(client)
        return len(data)

    def _obey(self, client: VrpnClient, message: vrpn.Message) -> None:
        if client.names.learn(message):
            return
        if message.kind == vrpn.UDP_DESCRIPTION:
            host = message.payload.split(b"\0", 1)[0]
            if host == client.host.encode() and 0 < message.sender <= 65535:
                client.udp_port = message.sender
        elif client.names.types.get(message.kind) == vrpn.PING:
            asked = client.names.senders.get(message.sender, "")
            number = self._senders.index(asked) if asked in self._senders else DEVICE
            pong = vrpn.Message(TYPES.index(vrpn.PONG), number, time.time())
            self.send(client, pong.encode())

    def _hang_up(self, client: VrpnClient) -> None:
        client.tcp.close()
        if client in self._clients:
            self._clients.remove(client)
