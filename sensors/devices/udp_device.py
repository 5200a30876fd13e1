"""What drivers that only listen to datagrams have in common."""

import time

from sensors.chunk import Chunk
from sensors.devices.base import ChunkSink, ThreadedDevice
from sensors.devices.decoder import Decoder
from sensors.devices.settings import DeviceSettings
from sensors.devices.udp_link import UdpLink
from sensors.stream import SampleQueue

_MAX_WAIT = 0.25


class UdpDevice(ThreadedDevice[UdpLink]):
    """A port that is listened to.

    Args:
        config: settings of the device.
        decoder: makes samples of datagrams.
        host: local address to listen on.
        port: UDP port.
        sender: only this host counts; empty: anybody.
        silence_timeout: without a good report for this long the state says silent [s].
        samples: where samples go.
        recorder: who gets every chunk.
    """

    def __init__(
        self,
        config: DeviceSettings,
        decoder: Decoder,
        *,
        host: str,
        port: int,
        sender: str,
        silence_timeout: float,
        samples: SampleQueue | None = None,
        recorder: ChunkSink | None = None,
    ) -> None:
        super().__init__(config, decoder, samples, recorder)
        self.port = port
        self._host = host
        self._sender = sender
        self._silence_timeout = silence_timeout

    def _open(self) -> UdpLink:
        link = UdpLink(self._host, self.port, self._sender)
        self.port = link.port
        return link

    def _serve(self, link: UdpLink) -> None:
        """Listen until stopped."""
        self._begin({})
        self.state = "listening"
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
            elif self.state == "streaming" and arrival - last_record > self._silence_timeout:
                # There is nobody to ask: a sender that comes back is simply heard again.
                self.state = "silent"
                self.last_error = f"nothing heard for {self._silence_timeout:g} s; is it sending?"
                self.counters.recoveries += 1
