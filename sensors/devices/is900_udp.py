"""Driver for the native UDP stream of an InterSense tracker."""

from typing import Literal

from pydantic import Field

from sensors.chunk import Chunk
from sensors.clock import DeviceClock
from sensors.devices.base import ChunkSink
from sensors.devices.decoder import Decoder
from sensors.devices.udp_device import UdpDevice, UdpSettings
from sensors.errors import MalformedRecordError
from sensors.protocols import is900_udp
from sensors.protocols.is900.axes import flip_position, flip_quaternion
from sensors.stream import Received, SampleQueue


class Is900UdpConfig(UdpSettings):
    """Settings of the driver.

    Attributes:
        port: UDP port.
        stations: station number of each tracker name, for example `{head = 1}`.
    """

    driver: Literal["is900-udp"] = "is900-udp"
    port: int = Field(default=is900_udp.DEFAULT_PORT, ge=0, le=65535)


class Is900UdpDecoder(Decoder):
    """Datagrams to samples."""

    def __init__(self, config: Is900UdpConfig) -> None:
        super().__init__(config)
        self.clock = DeviceClock()
        self._sequences: dict[int, int] = {}

    def begin(self, chunk: Chunk) -> None:
        """The port was opened."""
        self.clock.reset()
        self._sequences.clear()

    def feed(self, chunk: Chunk) -> list[Received]:
        """Decode one datagram."""
        counters = self.counters
        try:
            packet = is900_udp.decode(chunk.data)
        except MalformedRecordError:
            # What has not even the shape is not a damaged packet but somebody else's.
            if len(chunk.data) == is900_udp.LENGTH and chunk.data[0] == is900_udp.START:
                counters.parser.bad_records += 1
            else:
                counters.foreign += 1
            counters.parser.skipped_bytes += len(chunk.data)
            return []
        counters.parser.records += 1
        before = self._sequences.get(packet.station)
        self._sequences[packet.station] = packet.sequence
        if before is not None:
            missed = (packet.sequence - before - 1) % 256
            # A packet that was overtaken looks like 254 missed ones.
            counters.lost_records += missed if missed < 128 else 0
        name = self.name_of(str(packet.station))
        if name is None:
            return []
        time = self.clock.update(packet.time, chunk.time)
        p, q = flip_position(packet.position), flip_quaternion(packet.quaternion)
        return [self.sample(name, time, p, q, packet.status / 255.0, chunk.time)]


class Is900UdpDevice(UdpDevice):
    """A running listener.

    Args:
        config: settings.
        samples: where samples go; by default a queue of its own.
        recorder: who gets every chunk.
    """

    def __init__(
        self,
        config: Is900UdpConfig,
        samples: SampleQueue | None = None,
        recorder: ChunkSink | None = None,
    ) -> None:
        super().__init__(config, Is900UdpDecoder(config), samples, recorder)
