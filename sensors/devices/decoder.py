"""Chunks to samples, without any line: the part of a driver that a replay shares."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

from sensors.chunk import Chunk
from sensors.devices.settings import DeviceSettings
from sensors.pose import PoseSample
from sensors.protocols.counters import ParserCounters
from sensors.rotation import Array
from sensors.stream import Received


@dataclass(slots=True)
class DeviceCounters:
    """What a driver has been through; only grows.

    Attributes:
        parser: good and bad records, skipped bytes.
        samples: samples handed on, by tracker.
        seen: good reports by the device's own name of the station, configured or not.
        unmapped: good reports of stations no tracker is configured for.
        flagged: reports with an error mark, or without a pose.
        foreign: other people's traffic: datagrams from elsewhere, messages of other kinds.
        lost_records: reports that never arrived, where the protocol numbers them.
        connects: times the port was opened.
        port_losses: times an open port failed.
        recoveries: times the device was set up anew because it had fallen silent.
        failures: attempts to open or set up that failed.
    """

    parser: ParserCounters = field(default_factory=ParserCounters)
    samples: dict[str, int] = field(default_factory=dict)
    seen: dict[str, int] = field(default_factory=dict)
    unmapped: int = 0
    flagged: int = 0
    foreign: int = 0
    lost_records: int = 0
    connects: int = 0
    port_losses: int = 0
    recoveries: int = 0
    failures: int = 0


# Names of unknown stations come from the network: remember no more of them than this.
_MAX_SEEN = 256


class Decoder(ABC):
    """Chunks in, samples out; pure: no clock, no line, no thread.

    Args:
        config: settings of the device.
    """

    def __init__(self, config: DeviceSettings) -> None:
        self.counters = DeviceCounters(samples=dict.fromkeys(config.stations, 0))
        self._names = {str(station): name for name, station in config.stations.items()}
        self._discovers = not config.stations
        self._placement = config.placement.transform

    def take(self, chunk: Chunk) -> list[Received]:
        """Decode one chunk.

        Returns:
            The samples that became complete with it. Bad data is counted, never raised.
        """
        if chunk.opening is not None:
            self.begin(chunk)
        return self.feed(chunk) if chunk.data else []

    @abstractmethod
    def begin(self, chunk: Chunk) -> None:
        """Forget the stream before; `chunk.opening` tells what the decoder must know."""

    @abstractmethod
    def feed(self, chunk: Chunk) -> list[Received]:
        """Decode `chunk.data`."""

    def name_of(self, station: str) -> str | None:
        """The tracker's name of a station that has just reported well, counting it.

        Without configured stations every station is a tracker of its own name.
        """
        counters = self.counters
        if station in counters.seen or len(counters.seen) < _MAX_SEEN:
            counters.seen[station] = counters.seen.get(station, 0) + 1
            if self._discovers:
                return station
        name = self._names.get(station)
        if name is None:
            counters.unmapped += 1
        return name

    def sample(
        self, tracker: str, time: float, p: Array, q: Array, quality: float, arrival: float
    ) -> Received:
        """A sample in the common world, counted.

        Args:
            tracker: its name.
            time: capture instant on the host's clock [s].
            p: position in the device's world, z up, shape (3,) [m].
            q: orientation w x y z, shape (4,).
            quality: 0 lost to 1 perfect.
            arrival: when the last byte was in memory [s].
        """
        counts = self.counters.samples
        counts[tracker] = counts.get(tracker, 0) + 1
        p, q = self._placement.apply(p, q)
        return Received(PoseSample(tracker, time, p, q, quality), arrival)
