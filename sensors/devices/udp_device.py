"""What drivers that only listen to datagrams have in common."""

import time

from pydantic import Field

from sensors.chunk import Chunk
from sensors.devices.base import ChunkSink, ThreadedDevice
from sensors.devices.decoder import Decoder
from sensors.devices.settings import DeviceSettings
from sensors.devices.udp_link import UdpLink
from sensors.stream import SampleQueue

_MAX_WAIT = 0.25


class UdpSettings(DeviceSettings):
    """Settings of a driver that listens to a port.

    Attributes:
        host: local address to listen on; "0.0.0.0" hears every network.
        port: UDP port.
        sender: only datagrams from this address count; empty: from anybody.
        silence_timeout: without a good report for this long the state says silent [s].
    """

    host: str = "127.0.0.1"
    port: int = Field(ge=0, le=65535)
    sender: str = ""
    silence_timeout: float = Field(default=2.0, gt=0.0)

    @property
    def address(self) -> str:
        """Where it listens."""
        return f"UDP {self.host}:{self.port}"


class UdpDevice(ThreadedDevice[UdpLink]):
    """A port that is listened to.

    Args:
        config: settings.
        decoder: makes samples of datagrams.
        samples: where samples go; by default a queue of its own.
        recorder: who gets every chunk.

    Attributes:
        port: the port it listens on, once it is open.
    """

    def __init__(
        self,
        config: UdpSettings,
        decoder: Decoder,
        samples: SampleQueue | None = None,
        recorder: ChunkSink | None = None,
    ) -> None:
        super().__init__(config, decoder, samples, recorder)
        self.config = config
        self.port = config.port

    def _open(self) -> UdpLink:
        link = UdpLink(self.config.host, self.port, self.config.sender)
        self.port = link.port
        return link

    def _serve(self, link: UdpLink) -> None:
        """Listen until stopped."""
        self._begin({})
        self.state = "listening"
        silence = self.config.silence_timeout
        last_record = time.monotonic()
        parser = self.counters.parser
        records = parser.records
        while self._running():
            foreign = link.foreign
            data, arrival = link.read(_MAX_WAIT)
            self.counters.foreign += link.foreign - foreign
            if data:
                self._take(Chunk(arrival, data))
            if parser.records > records:
                records, last_record = parser.records, arrival
                self.state = "streaming"
                self._is_well()
            elif self.state == "streaming" and arrival - last_record > silence:
                # There is nobody to ask: a sender that comes back is simply heard again.
                self.state = "silent"
                self.last_error = f"nothing heard for {silence:g} s; is it sending?"
                self.counters.recoveries += 1
