"""A VRPN server that standard clients read: one device, one sensor for each station."""

import contextlib
import socket
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from sensors.emulators.beat import BeatEmulator
from sensors.emulators.source import PoseSource, StationPose
from sensors.errors import ConnectionFailedError, MalformedRecordError
from sensors.protocols import vrpn

_DEVICE = 1
_TYPES = (vrpn.PING, vrpn.PONG, vrpn.POSE)
_MAX_CLIENTS = 16
_READ_SIZE = 65536
_CALL_BACK_TIMEOUT = 0.5


@dataclass(slots=True, eq=False)
class _Client:
    """One connected client."""

    tcp: socket.socket
    host: str
    reader: vrpn.MessageReader = field(default_factory=lambda: vrpn.MessageReader(True))
    names: vrpn.NameTable = field(default_factory=vrpn.NameTable)
    udp_port: int = 0


class VrpnEmulator(BeatEmulator):
    """A server on one port: TCP for connections, UDP for requests to connect back.

    Clients may be of either kind: those that connect by TCP, and the classic ones that ask
    by UDP and are called back. Reports go by UDP to clients that described a port, else by
    TCP.

    Args:
        pose_at: world poses of the stations; station n is sensor n - 1.
        host: address to listen on.
        port: port; 0 for any free one.
        device: name of the tracker, by which clients ask: `Tracker0@host`.
        settings: as for `BeatEmulator`.

    Raises:
        ConnectionFailedError: if the port cannot be had.
    """

    def __init__(
        self,
        pose_at: PoseSource,
        *,
        host: str = "127.0.0.1",
        port: int = vrpn.DEFAULT_PORT,
        device: str = "Tracker0",
        **settings: Any,
    ) -> None:
        super().__init__(pose_at, **settings)
        self._host = host
        self._senders = (vrpn.CONTROL, device)
        self._clients: list[_Client] = []
        # Wall time of the device's zero: VRPN time stamps are those of the calendar.
        self._epoch = time.time()
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._tcp = socket.create_server((host, port))
            self.port: int = self._tcp.getsockname()[1]
            self._udp.bind((host, self.port))
        except OSError as error:
            self._udp.close()
            raise ConnectionFailedError(
                f"cannot listen on port {port} of {host}: {error.strerror}; choose another port"
            ) from error
        self._tcp.setblocking(False)
        self._udp.setblocking(False)

    @property
    def address(self) -> str:
        """What a client connects to."""
        return f"{self._host}:{self.port}"

    @property
    def client_count(self) -> int:
        """How many clients are connected now."""
        return len(self._clients)

    def _sockets(self) -> list[socket.socket]:
        return [self._tcp, self._udp, *(c.tcp for c in self._clients)]

    def _receive(self, ready: list[socket.socket]) -> None:
        for client in list(self._clients):
            if client.tcp in ready:
                self._listen_to(client)
        if self._tcp in ready:
            with contextlib.suppress(OSError):
                tcp, (host, *_) = self._tcp.accept()
                self._welcome(tcp, host)
        if self._udp in ready:
            with contextlib.suppress(OSError):
                data, (host, *_) = self._udp.recvfrom(_READ_SIZE)
                self._call_back(data, host)

    def _call_back(self, data: bytes, sender: str) -> None:
        try:
            host, port = vrpn.decode_connection_request(data)
        except MalformedRecordError:
            return
        # Only who asks is called: a forged request must not make us knock elsewhere.
        if host != sender:
            return
        with contextlib.suppress(OSError):
            self._welcome(socket.create_connection((host, port), _CALL_BACK_TIMEOUT), host)

    def _welcome(self, tcp: socket.socket, host: str) -> None:
        if len(self._clients) >= _MAX_CLIENTS:
            tcp.close()
            return
        tcp.setblocking(False)
        tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client = _Client(tcp, host)
        self._clients.append(client)
        out = bytearray(vrpn.COOKIE)
        for number, name in enumerate(self._senders):
            out += vrpn.description(vrpn.SENDER_DESCRIPTION, number, name).encode()
        for number, name in enumerate(_TYPES):
            out += vrpn.description(vrpn.TYPE_DESCRIPTION, number, name).encode()
        self._write(client, bytes(out))

    def _listen_to(self, client: _Client) -> None:
        try:
            data = client.tcp.recv(_READ_SIZE)
            if not data:
                raise ConnectionResetError
            self.counters.command_bytes += len(data)
            for message in client.reader.feed(data):
                self._obey(client, message)
        except BlockingIOError:
            return
        except (OSError, MalformedRecordError):
            self._hang_up(client)

    def _obey(self, client: _Client, message: vrpn.Message) -> None:
        if client.names.learn(message):
            return
        if message.kind == vrpn.UDP_DESCRIPTION:
            host = message.payload.split(b"\0", 1)[0]
            if host == client.host.encode() and 0 < message.sender <= 65535:
                client.udp_port = message.sender
        elif client.names.types.get(message.kind) == vrpn.PING:
            asked = client.names.senders.get(message.sender, "")
            number = self._senders.index(asked) if asked in self._senders else _DEVICE
            pong = vrpn.Message(_TYPES.index(vrpn.PONG), number, time.time())
            self._write(client, pong.encode())

    def _send_cycle(self, poses: Sequence[StationPose | None], t: float, now: float) -> None:
        for sensor, pose in enumerate(poses):
            if pose is None:
                continue
            report = vrpn.PoseReport(sensor, *pose).encode()
            message = vrpn.Message(_TYPES.index(vrpn.POSE), _DEVICE, self._epoch + now, report)
            data = message.encode()
            self.counters.records += 1
            for client in list(self._clients):
                if client.udp_port:
                    spoilt = self.faults.spoil(data, t)
                    with contextlib.suppress(OSError):
                        self._udp.sendto(spoilt, (client.host, client.udp_port))
                else:
                    self._write(client, data)

    def _write(self, client: _Client, data: bytes) -> None:
        try:
            if client.tcp.send(data) < len(data):
                raise BlockingIOError
        except BlockingIOError:
            # A client that does not read for so long is not there any more.
            self.counters.overruns += 1
            self._hang_up(client)
        except OSError:
            self._hang_up(client)

    def _hang_up(self, client: _Client) -> None:
        client.tcp.close()
        if client in self._clients:
            self._clients.remove(client)

    def _close(self) -> None:
        for client in list(self._clients):
            self._hang_up(client)
        self._tcp.close()
        self._udp.close()
