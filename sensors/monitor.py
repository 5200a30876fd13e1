"""A live table of one device: is every tracker there, how often, how evenly, how clean?"""

import math
import time
from dataclasses import dataclass

from rich.console import Console
from rich.live import Live
from rich.table import Table

from sensors.devices.is900 import Is900Config, Is900Device

_REFRESH = 0.25


@dataclass(slots=True)
class StreamStatistics:
    """Running figures of one tracker's arrivals, forgetting with the given time constant.

    Attributes:
        constant: time over which the figures forget [s].
        last: newest arrival [s].
        mean: mean interval [s].
        variance: variance of the interval [s^2].
        count: samples seen.
    """

    constant: float = 2.0
    last: float = math.nan
    mean: float = 0.0
    variance: float = 0.0
    count: int = 0

    def observe(self, arrival: float) -> None:
        """Take one arrival time [s]."""
        if self.count > 0:
            interval = arrival - self.last
            weight = max(1.0 / self.count, 1.0 - math.exp(-interval / self.constant))
            change = interval - self.mean
            self.mean += weight * change
            self.variance = (1.0 - weight) * (self.variance + weight * change * change)
        self.last = arrival
        self.count += 1

    @property
    def rate(self) -> float:
        """Samples a second [Hz]; 0 before the second sample."""
        return 1.0 / self.mean if self.mean > 0.0 else 0.0

    @property
    def jitter(self) -> float:
        """Standard deviation of the interval [s]."""
        return math.sqrt(self.variance)


def watch(port: str, stations: int, baud: int, seconds: float) -> None:
    """Show a table until interrupted.

    Args:
        port: device path or pyserial URL.
        stations: watch stations 1 to this.
        baud: line rate [bit/s].
        seconds: stop after this long [s]; 0 for until interrupted.

    Raises:
        ConfigurationError: for impossible settings.
    """
    names = {f"station{n}": n for n in range(1, stations + 1)}
    device = Is900Device(Is900Config(port=port, stations=names, baud=baud))
    statistics = {name: StreamStatistics() for name in names}
    give_up = time.monotonic() + seconds if seconds > 0.0 else math.inf
    with device, Live(console=Console(), auto_refresh=False) as live:
        while (now := time.monotonic()) < give_up:
            for sample, arrival in device.samples.drain(_REFRESH):
                statistics[sample.tracker].observe(arrival)
            live.update(_table(device, statistics, names, now), refresh=True)
            # Samples come in small portions; the table need not keep up with them.
            time.sleep(_REFRESH)


def _table(
    device: Is900Device, statistics: dict[str, StreamStatistics], names: dict[str, int], now: float
) -> Table:
    parser = device.counters.parser
    table = Table(
        "tracker",
        "samples",
        "rate [Hz]",
        "age [ms]",
        "jitter [ms]",
        "bad records",
        title=f"{device.config.port}: {device.state}",
        caption=(
            f"skipped bytes {parser.skipped_bytes}, recoveries {device.counters.recoveries}, "
            f"port losses {device.counters.port_losses} {device.last_error}"
        ),
    )
    for name, s in statistics.items():
        age = "-" if s.count == 0 else f"{1e3 * (now - s.last):.0f}"
        table.add_row(
            name,
            str(s.count),
            f"{s.rate:.1f}",
            age,
            f"{1e3 * s.jitter:.2f}",
            str(parser.bad_by_station.get(names[name], 0)),
        )
    return table
