"""Driver for trackers sent by OSC: VMC performers and VRChat trackers.

VMC sends a tracker's pose in one message, VRChat in two, of which the first that repeats
tells that a new report has begun. Time stamps: the time tag of the bundle if it has one,
else the sender's own time in `/VMC/Ext/T` of the same datagram, else the even beat behind
the arrivals.
"""

import math
from typing import Literal

import numpy as np
from pydantic import Field

from sensors import rotation
from sensors.arrival_clock import ArrivalClock
from sensors.chunk import Chunk
from sensors.clock import DeviceClock
from sensors.devices.base import ChunkSink
from sensors.devices.decoder import Decoder
from sensors.devices.udp_device import UdpDevice, UdpSettings
from sensors.errors import MalformedRecordError
from sensors.protocols import osc, unity
from sensors.rotation import Array
from sensors.stream import Received, SampleQueue

VMC_TRACKER = "/VMC/Ext/Tra/Pos"
VMC_TIME = "/VMC/Ext/T"
VRCHAT = "/tracking/trackers/"

_MAX_COORDINATE = 100.0
# Several turns are odd but harmless; beyond that sine and cosine lose their digits.
_MAX_ANGLE = 3600.0
_MAX_PENDING = 64
# Position and rotation of one VRChat report come together, or the pair is not one.
_PAIR_WINDOW = 0.05


class OscConfig(UdpSettings):
    """Settings of the driver.

    Attributes:
        port: UDP port: 39539 or 39540 for VMC, 9000 for VRChat trackers.
        stations: what the sender calls each tracker: for VMC the serial number in
            `/VMC/Ext/Tra/Pos`, for VRChat `1` to `8` or `head`.
    """

    driver: Literal["osc"] = "osc"
    port: int = Field(default=osc.VMC_PORT, ge=0, le=65535)


class OscDecoder(Decoder):
    """Datagrams to samples."""

    def __init__(self, config: OscConfig) -> None:
        super().__init__(config)
        self.clock = DeviceClock()
        self._beats: dict[str, ArrivalClock] = {}
        self._pending: dict[str, tuple[str, float, Array]] = {}
        self._timing = ""

    def begin(self, chunk: Chunk) -> None:
        """The port was opened."""
        self.clock.reset()
        self._beats.clear()
        self._pending.clear()
        self._timing = ""

    def feed(self, chunk: Chunk) -> list[Received]:
        """Decode one datagram."""
        try:
            messages = osc.decode(chunk.data)
        except MalformedRecordError:
            self.counters.foreign += 1
            self.counters.parser.skipped_bytes += len(chunk.data)
            return []
        sent = _sent(messages)
        found: list[Received] = []
        for message in messages:
            try:
                pose = self._pose(message, chunk.time)
            except MalformedRecordError:
                self.counters.parser.bad_records += 1
                continue
            if pose is None:
                continue
            station, p, q = pose
            self.counters.parser.records += 1
            name = self.name_of(station)
            if name is not None:
                time = self._captured(station, message.time, sent, chunk.time)
                found.append(self.sample(name, time, p, q, 1.0, chunk.time))
        return found

    def _captured(
        self, station: str, tag: float | None, sent: float | None, arrival: float
    ) -> float:
        timing = "tag" if tag is not None else "sent" if sent is not None else "arrival"
        if timing != self._timing:
            # Another sender, or the same one with another clock.
            self._timing = timing
            self.clock.reset()
        if timing == "arrival":
            if station not in self._beats and len(self._beats) >= _MAX_PENDING:
                return arrival
            return self._beats.setdefault(station, ArrivalClock()).update(arrival)
        return self.clock.update(tag if tag is not None else sent or 0.0, arrival)

    def _pose(self, message: osc.OscMessage, arrival: float) -> tuple[str, Array, Array] | None:
        """Station, position and orientation in the world, once both are known."""
        if message.address == VMC_TRACKER:
            if len(message.arguments) < 8 or not isinstance(message.arguments[0], str):
                raise MalformedRecordError("a tracker without a name")
            x, y, z, qx, qy, qz, qw = _numbers(message.arguments[1:8], 7)
            q = np.array([qw, qx, qy, qz])
            if abs(float(np.linalg.norm(q)) - 1.0) > 0.1:
                raise MalformedRecordError("no orientation")
            return message.arguments[0], _place(x, y, z), _orient(rotation.normalize(q))
        if message.address.startswith(VRCHAT):
            return self._half(message, arrival)
        if message.address == VMC_TIME or message.address.startswith("/VMC/"):
            self.counters.parser.responses += 1
        else:
            self.counters.foreign += 1
        return None

    def _half(self, message: osc.OscMessage, arrival: float) -> tuple[str, Array, Array] | None:
        station, _, part = message.address[len(VRCHAT) :].partition("/")
        if part not in ("position", "rotation"):
            self.counters.foreign += 1
            return None
        x, y, z = _numbers(message.arguments, 3)
        if part == "position":
            value = _place(x, y, z)
        elif max(abs(x), abs(y), abs(z)) > _MAX_ANGLE:
            raise MalformedRecordError("angles that cannot be")
        else:
            value = _orient(unity.euler_to_quaternion(np.radians(np.array([x, y, z]))))
        other = self._pending.pop(station, None)
        if other is None or other[0] == part or arrival - other[1] > _PAIR_WINDOW:
            if len(self._pending) < _MAX_PENDING:
                self._pending[station] = (part, arrival, value)
            return None
        return (station, value, other[2]) if part == "position" else (station, other[2], value)


def _sent(messages: list[osc.OscMessage]) -> float | None:
    """The sender's own time in `/VMC/Ext/T`, if a datagram has it."""
    for message in messages:
        if message.address == VMC_TIME and message.arguments:
            value = message.arguments[0]
            if isinstance(value, float) and math.isfinite(value) and 0.0 <= value < 1e9:
                return value
    return None


def _numbers(arguments: tuple[osc.Argument, ...], count: int) -> list[float]:
    values = [float(a) for a in arguments if isinstance(a, int | float)]
    if len(arguments) != count or len(values) != count or not all(map(math.isfinite, values)):
        raise MalformedRecordError(f"{count} numbers are due")
    return values


def _place(x: float, y: float, z: float) -> Array:
    if max(abs(x), abs(y), abs(z)) > _MAX_COORDINATE:
        raise MalformedRecordError("a position that cannot be")
    return unity.position_to_world(np.array([x, y, z]))


def _orient(q: Array) -> Array:
    return unity.quaternion_to_world(q)


class OscDevice(UdpDevice):
    """A running listener.

    Args:
        config: settings.
        samples: where samples go; by default a queue of its own.
        recorder: who gets every chunk.
    """

    def __init__(
        self,
        config: OscConfig,
        samples: SampleQueue | None = None,
        recorder: ChunkSink | None = None,
    ) -> None:
        super().__init__(config, OscDecoder(config), samples, recorder)
