"""Driver for trackers behind a VRPN server.

The connection is made by TCP alone, which every server of the last twenty years accepts.
Reports come by TCP, or by UDP if asked for.
"""

import contextlib
import os
import select
import socket
import time
from collections.abc import Mapping
from typing import Literal, Self

from pydantic import Field, model_validator

from sensors.chunk import Chunk
from sensors.clock import DeviceClock
from sensors.devices.axes import Axes, to_world
from sensors.devices.base import ChunkSink, ThreadedDevice
from sensors.devices.decoder import Decoder
from sensors.devices.settings import DeviceSettings
from sensors.errors import ConnectionFailedError, LinkLostError, MalformedRecordError
from sensors.protocols import vrpn
from sensors.stream import Received, SampleQueue

_MAX_WAIT = 0.25
_PING_INTERVAL = 1.0
_READ_SIZE = 65536


class VrpnConfig(DeviceSettings):
    """Settings of the driver.

    Attributes:
        server: address of the VRPN server, `host` or `host:port`.
        stations: what the server calls each tracker, `"DEVICE:SENSOR"` or just `"DEVICE"`
            for its sensor 0; for example `{head = "Tracker0:0", torso = "Tracker0:1"}`.
        axes: where the server's axes point; VRPN does not say.
        udp: ask for reports by UDP instead of TCP.
        listen_host: local address for reports by UDP; by default the one that the TCP
            connection to the server goes out from.
        connect_timeout: how long connecting may take [s].
        silence_timeout: without any message for this long the connection is made anew [s].
    """

    driver: Literal["vrpn"] = "vrpn"
    server: str = Field(min_length=1)
    axes: Axes = "z-up"
    udp: bool = False
    listen_host: str = ""
    connect_timeout: float = Field(default=3.0, gt=0.0)
    silence_timeout: float = Field(default=10.0, gt=0.0)

    @model_validator(mode="after")
    def _check(self) -> Self:
        for tracker, station in self.stations.items():
            if not isinstance(station, str) or not station:
                raise ValueError(
                    f'station of {tracker} is {station!r}; give "DEVICE:SENSOR", for example '
                    '"Tracker0:0"'
                )
        host, port = self.endpoint
        if not host or not 1 <= port <= 65535:
            raise ValueError(f"server is {self.server!r}; give host or host:port")
        return self

    @property
    def endpoint(self) -> tuple[str, int]:
        """Host and port of the server."""
        host, colon, port = self.server.rpartition(":")
        if not colon:
            return self.server, vrpn.DEFAULT_PORT
        return host, int(port) if port.isdecimal() else 0

    @property
    def full_stations(self) -> Mapping[str, str]:
        """The stations, each with its sensor."""
        return {
            tracker: str(s) if ":" in str(s) else f"{s}:0" for tracker, s in self.stations.items()
        }

    @property
    def address(self) -> str:
        """The server."""
        return f"VRPN server {self.server}"


class VrpnDecoder(Decoder):
    """Messages of a server to samples.

    Attributes:
        broken: nothing more can be understood; the connection must be made anew.
    """

    def __init__(self, config: VrpnConfig) -> None:
        super().__init__(config.model_copy(update={"stations": config.full_stations}))
        self.clock = DeviceClock()
        self.broken = False
        self.messages = 0
        self._position, self._quaternion = to_world(config.axes)
        self._reader = vrpn.MessageReader(with_cookie=True)
        self.names = vrpn.NameTable()

    def begin(self, chunk: Chunk) -> None:
        """A new connection: ids mean nothing any more."""
        self.broken = False
        self.clock.reset()
        self._reader = vrpn.MessageReader(with_cookie=True)
        self.names = vrpn.NameTable()

    def feed(self, chunk: Chunk) -> list[Received]:
        """Decode bytes of the stream, or one datagram."""
        try:
            if chunk.source == "udp":
                messages = vrpn.read_datagram(chunk.data)
            elif self.broken:
                return []
            else:
                messages = self._reader.feed(chunk.data)
        except MalformedRecordError:
            self.counters.parser.skipped_bytes += len(chunk.data)
            if chunk.source == "udp":
                self.counters.foreign += 1
            else:
                self.counters.parser.bad_records += 1
                self.broken = True
            return []
        found: list[Received] = []
        for message in messages:
            self.messages += 1
            try:
                self._add(message, chunk.time, found)
            except MalformedRecordError:
                self.counters.parser.bad_records += 1
        return found

    def _add(self, message: vrpn.Message, arrival: float, found: list[Received]) -> None:
        if self.names.learn(message) or self.names.types.get(message.kind) == vrpn.PONG:
            self.counters.parser.responses += 1
            return
        if self.names.types.get(message.kind) != vrpn.POSE:
            self.counters.foreign += 1
            return
        report = vrpn.decode_pose(message.payload)
        self.counters.parser.records += 1
        device = self.names.senders.get(message.sender, f"#{message.sender}")
        name = self.name_of(f"{device}:{report.sensor}")
        if name is None:
            return
        time = self.clock.update(message.time, arrival)
        p, q = self._position(report.position), self._quaternion(report.quaternion)
        found.append(self.sample(name, time, p, q, 1.0, arrival))


class VrpnLink:
    """A connection to a server.

    Args:
        config: settings.

    Raises:
        ConnectionFailedError: if there is no server.
    """

    def __init__(self, config: VrpnConfig) -> None:
        host, port = config.endpoint
        try:
            self._tcp = socket.create_connection((host, port), config.connect_timeout)
        except OSError as error:
            raise ConnectionFailedError(
                f"cannot connect to the VRPN server {host}:{port}: {error.strerror or error}; "
                "check that it runs, its name and its port"
            ) from error
        self._udp: socket.socket | None = None
        self._wake_read, self._wake_write = os.pipe()
        try:
            self._tcp.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._server_address = self._tcp.getpeername()[0]
            self.write(vrpn.COOKIE)
            if config.udp:
                self._describe_udp(config.listen_host)
            self._describe_ping()
        except ConnectionFailedError:
            self.close()
            raise

    def _describe_udp(self, listen_host: str) -> None:
        host = listen_host or self._tcp.getsockname()[0]
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._udp.bind((host, 0))
        except OSError as error:
            raise ConnectionFailedError(
                f"cannot listen for VRPN reports on {host}: {error.strerror or error}; set "
                "listen_host to an address of this machine, or udp to false"
            ) from error
        self._udp.setblocking(False)
        address, port = self._udp.getsockname()
        self.write(vrpn.udp_description(address, port).encode())

    def _describe_ping(self) -> None:
        out = vrpn.description(vrpn.SENDER_DESCRIPTION, 0, vrpn.CONTROL)
        ping = vrpn.description(vrpn.TYPE_DESCRIPTION, 0, vrpn.PING)
        self.write(out.encode() + ping.encode())

    def ping(self) -> None:
        """Ask for a sign of life."""
        self.write(vrpn.Message(0, 0, time.time()).encode())

    def write(self, data: bytes) -> None:
        """Send to the server by TCP.

        Raises:
            LinkLostError: if the connection is gone.
        """
        try:
            self._tcp.sendall(data)
        except OSError as error:
            raise LinkLostError(f"the VRPN server takes nothing: {error}") from error

    def read(self, timeout: float) -> list[tuple[str, bytes]]:
        """Wait for bytes, then take what there is.

        Returns:
            Way (`"tcp"` or `"udp"`) and bytes; none after the timeout or `wake`.

        Raises:
            LinkLostError: if the server hung up.
        """
        sockets = [self._tcp] if self._udp is None else [self._tcp, self._udp]
        found: list[tuple[str, bytes]] = []
        try:
            ready, _, _ = select.select([*sockets, self._wake_read], [], [], timeout)
            if self._tcp in ready:
                data = self._tcp.recv(_READ_SIZE)
                if not data:
                    raise LinkLostError("the VRPN server hung up")
                found.append(("tcp", data))
            if self._udp is not None and self._udp in ready:
                data, (sender, *_) = self._udp.recvfrom(_READ_SIZE)
                if sender == self._server_address and data:
                    found.append(("udp", data))
        except BlockingIOError:
            pass
        except (OSError, ValueError) as error:
            raise LinkLostError(f"the VRPN connection is lost: {error}") from error
        return found

    def wake(self) -> None:
        """Let `read` return at once, now and from now on; from any thread."""
        os.write(self._wake_write, b"\0")

    def close(self) -> None:
        """Close the connection."""
        with contextlib.suppress(OSError):
            self._tcp.close()
        if self._udp is not None:
            self._udp.close()
        os.close(self._wake_read)
        os.close(self._wake_write)


class VrpnDevice(ThreadedDevice[VrpnLink]):
    """A running client.

    Args:
        config: settings.
        samples: where samples go; by default a queue of its own.
        recorder: who gets every chunk.
    """

    decoder: VrpnDecoder

    def __init__(
        self,
        config: VrpnConfig,
        samples: SampleQueue | None = None,
        recorder: ChunkSink | None = None,
    ) -> None:
        super().__init__(config, VrpnDecoder(config), samples, recorder)
        self.config = config

    def _open(self) -> VrpnLink:
        return VrpnLink(self.config)

    def _serve(self, link: VrpnLink) -> None:
        """Read until stopped."""
        self._begin({})
        self.state = "connected"
        last_message = pinged = time.monotonic()
        messages, records = self.decoder.messages, self.counters.parser.records
        while self._running():
            for source, data in link.read(_MAX_WAIT):
                self._take(Chunk(time.monotonic(), data, source))
            now = time.monotonic()
            if self.decoder.broken:
                raise ConnectionFailedError(
                    f"what answers at {self.config.server} does not speak VRPN 07; check the port"
                )
            if self.decoder.messages > messages:
                messages, last_message = self.decoder.messages, now
            elif now - last_message > self.config.silence_timeout:
                self.counters.recoveries += 1
                raise ConnectionFailedError(
                    f"the VRPN server {self.config.server} has been silent for "
                    f"{self.config.silence_timeout:g} s"
                )
            if self.counters.parser.records > records:
                records = self.counters.parser.records
                self.state = "streaming"
                self._is_well()
            if now - pinged > _PING_INTERVAL:
                pinged = now
                link.ping()
