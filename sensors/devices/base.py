"""What every driver is: something that puts samples into a queue until it is stopped."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

from sensors.protocols.is900.parser import ParserCounters
from sensors.stream import SampleQueue


@dataclass(slots=True)
class DeviceCounters:
    """What a driver has been through; only grows.

    Attributes:
        parser: good and bad records, skipped bytes.
        samples: samples handed on, by tracker.
        unmapped: good records of stations no tracker is configured for.
        flagged: records with an error letter for a status, or without a pose.
        connects: times the port was opened.
        port_losses: times an open port failed.
        recoveries: times the device was set up anew because it had fallen silent.
        failures: attempts to open or set up that failed.
    """

    parser: ParserCounters = field(default_factory=ParserCounters)
    samples: dict[str, int] = field(default_factory=dict)
    unmapped: int = 0
    flagged: int = 0
    connects: int = 0
    port_losses: int = 0
    recoveries: int = 0
    failures: int = 0


class Device(ABC):
    """A driver. It runs from `start` to `stop` and never ends because of data or ports.

    Args:
        samples: where samples go; devices may share one queue.
    """

    def __init__(self, samples: SampleQueue) -> None:
        self.samples = samples
        self.counters = DeviceCounters()
        self.state = "stopped"
        self.last_error = ""

    @property
    @abstractmethod
    def trackers(self) -> tuple[str, ...]:
        """Names of the trackers this device reports."""

    @abstractmethod
    def start(self) -> None:
        """Begin to connect and read, in the background."""

    @abstractmethod
    def stop(self) -> None:
        """Leave the device quiet, close the port, end the thread. Twice is no error."""

    def __enter__(self) -> "Device":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
