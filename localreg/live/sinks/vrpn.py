"""A VRPN server whose one tracker is the body: sensor n is the start of bone n.

Sensors are the root and the 30 bones in the order of `BODY_NAMES`, with world positions in
metres and quaternions that turn bone axes into world axes, z up. Clients may connect by TCP,
or ask by UDP and be called back; reports go by UDP to those that described a port.

Sockets are served by a thread of its own that always sends the newest pose; a client that
does not read is dropped, as VRPN's own servers do, for half a message cannot be mended.
"""

import contextlib
import os
import selectors
import socket
import threading
import time
from dataclasses import dataclass, field
from typing import Final

from localreg.body.subject import Subject
from localreg.errors import LocalregError
from localreg.live.body_frames import ForwardKinematics
from localreg.live.sinks.base import LivePose, Sink
from sensors.errors import MalformedRecordError
from sensors.protocols import vrpn

_TYPES: Final = (vrpn.PING, vrpn.PONG, vrpn.POSE)
_DEVICE: Final = 1
_MAX_CLIENTS: Final = 16
_READ_SIZE: Final = 65536
_CALL_BACK_TIMEOUT: Final = 0.5
_REPORTS_IN_A_DATAGRAM: Final = 16


class VrpnEncoder:
    """One subject's poses as VRPN messages; pure.

    Args:
        subject: whose body.
    """

    def __init__(self, subject: Subject) -> None:
        self._kinematics = ForwardKinematics(subject)

    def __call__(self, live: LivePose, calendar_time: float) -> list[bytes]:
        """One message for each sensor.

        Args:
            live: the pose.
            calendar_time: of its instant, in seconds since 1970.
        """
        frames = self._kinematics(live.pose.qpos)
        kind = _TYPES.index(vrpn.POSE)
        return [
            vrpn.Message(
                kind, _DEVICE, calendar_time, vrpn.PoseReport(sensor, p, q).encode()
            ).encode()
            for sensor, (p, q) in enumerate(zip(*frames, strict=True))
        ]


@dataclass(eq=False)
class _Client:
    tcp: socket.socket
    host: str
    reader: vrpn.MessageReader = field(default_factory=lambda: vrpn.MessageReader(True))
    names: vrpn.NameTable = field(default_factory=vrpn.NameTable)
    udp_port: int = 0


class VrpnServer(Sink):
    """Serves every pose to whoever connects.

    Args:
        subject: whose body.
        host: address to listen on.
        port: port for TCP and UDP, 0 for any.
        device: name of the tracker, by which clients ask: `Body0@host`.

    Attributes:
        port: the port it listens on.

    Raises:
        LocalregError: the port is taken.
    """

    def __init__(
        self,
        subject: Subject,
        host: str = "127.0.0.1",
        port: int = vrpn.DEFAULT_PORT,
        device: str = "Body0",
    ) -> None:
        self._encode = VrpnEncoder(subject)
        self._senders = (vrpn.CONTROL, device)
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._tcp = socket.create_server((host, port))
            self.port: int = self._tcp.getsockname()[1]
            self._udp.bind((host, self.port))
        except OSError as error:
            self._udp.close()
            reason = (error.strerror or str(error)).lower()
            raise LocalregError(
                f"cannot listen on {host}:{port} for VRPN: {reason}; give the output another port"
            ) from error
        self.name = f"vrpn {device}@{host}:{self.port}"
        self._clients: list[_Client] = []
        self._newest: LivePose | None = None
        self._handing = threading.Lock()
        self._lost = 0
        self._is_ending = False
        self._wake_read, self._wake_write = os.pipe()
        os.set_blocking(self._wake_write, False)
        self._selector = selectors.DefaultSelector()
        for readable in (self._tcp, self._udp):
            readable.setblocking(False)
            self._selector.register(readable, selectors.EVENT_READ)
        self._selector.register(self._wake_read, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self._run, name="vrpn", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Poses that a newer one overtook before they were sent."""
        return self._lost

    def publish(self, live: LivePose) -> None:
        """Have one pose sent."""
        if self._is_ending:
            return
        with self._handing:
            if self._newest is not None:
                self._lost += 1
            self._newest = live
        self._wake()

    def close(self) -> None:
        """Hang up and give the port back. Doing so twice is no error."""
        if not self._is_ending:
            self._is_ending = True
            self._wake()
            self._thread.join()
            for fd in (self._wake_read, self._wake_write):
                os.close(fd)

    def _wake(self) -> None:
        # A pipe that is full wakes as well.
        with contextlib.suppress(BlockingIOError):
            os.write(self._wake_write, b"\0")

    def _run(self) -> None:
        while not self._is_ending:
            for key, _ in self._selector.select():
                if key.fileobj is self._tcp:
                    self._accept()
                elif key.fileobj is self._udp:
                    self._call_back()
                elif isinstance(key.data, _Client):
                    self._listen_to(key.data)
                else:
                    os.read(self._wake_read, _READ_SIZE)
            with self._handing:
                live, self._newest = self._newest, None
            if live is not None and self._clients:
                self._send(live)
        for client in list(self._clients):
            self._hang_up(client)
        self._selector.close()
        self._tcp.close()
        self._udp.close()

    def _send(self, live: LivePose) -> None:
        instant = time.time() - (time.monotonic() - live.frame.time)
        reports = self._encode(live, instant)
        whole = b"".join(reports)
        for client in list(self._clients):
            if not client.reader.has_cookie:
                continue
            if not client.udp_port:
                self._write(client, whole)
                continue
            for first in range(0, len(reports), _REPORTS_IN_A_DATAGRAM):
                datagram = b"".join(reports[first : first + _REPORTS_IN_A_DATAGRAM])
                with contextlib.suppress(OSError):
                    self._udp.sendto(datagram, (client.host, client.udp_port))

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            tcp, (host, *_) = self._tcp.accept()
            self._welcome(tcp, host)

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
        client = _Client(tcp, host)
        self._clients.append(client)
        self._selector.register(tcp, selectors.EVENT_READ, client)
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
                self._hang_up(client)
                return
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

    def _write(self, client: _Client, data: bytes) -> None:
        try:
            if client.tcp.send(data) < len(data):
                self._hang_up(client)
        except OSError:
            self._hang_up(client)

    def _hang_up(self, client: _Client) -> None:
        if client in self._clients:
            self._clients.remove(client)
            self._selector.unregister(client.tcp)
            client.tcp.close()
