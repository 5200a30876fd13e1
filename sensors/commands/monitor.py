"""A live table of the devices: is every tracker there, how often, how evenly, how clean?"""

import math
import time
from collections.abc import Sequence

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table

from sensors.config import SensorsConfig
from sensors.devices.base import Device
from sensors.devices.registry import open_device
from sensors.devices.replay import ReplayDevice
from sensors.errors import ConnectionFailedError
from sensors.statistics import StreamStatistics
from sensors.stream import SampleQueue

_REFRESH = 0.25
_FIRST_ATTEMPT = 10.0


def watch(config: SensorsConfig, seconds: float, wait: bool) -> None:
    """Show a table until interrupted.

    Args:
        config: what to watch.
        seconds: stop after this long [s]; 0 for until interrupted.
        wait: wait for devices that are not there, instead of saying so and ending.

    Raises:
        ConnectionFailedError: if a device cannot be opened.
    """
    samples = SampleQueue()
    devices = [open_device(c, samples) for c in config.named_devices()]
    statistics: dict[str, StreamStatistics] = {
        name: StreamStatistics() for device in devices for name in device.trackers
    }
    clocks = [d.clock for d in devices if isinstance(d, ReplayDevice)]
    try:
        start_all(devices, wait)
        give_up = time.monotonic() + seconds if seconds > 0.0 else math.inf
        with Live(console=Console(), auto_refresh=False) as live:
            while time.monotonic() < give_up:
                for sample, arrival in samples.drain(_REFRESH):
                    s = statistics.setdefault(sample.tracker, StreamStatistics())
                    s.observe(sample.time, arrival, sample.quality)
                now = clocks[0].now() if clocks else time.monotonic()
                live.update(_tables(devices, statistics, now), refresh=True)
                if all(isinstance(d, ReplayDevice) and d.finished.is_set() for d in devices):
                    break
                # Samples come in small portions; the table need not keep up with them.
                time.sleep(_REFRESH)
    finally:
        for device in devices:
            device.stop()


def start_all(devices: Sequence[Device], wait: bool) -> None:
    """Start devices; unless `wait`, one that cannot be opened is said at once.

    Raises:
        ConnectionFailedError: naming what cannot be opened.
    """
    for device in devices:
        device.start()
    for device in [] if wait else devices:
        if not device.wait_attempt(_FIRST_ATTEMPT):
            raise ConnectionFailedError(device.last_error or f"{device.name} does not open")


def _tables(
    devices: Sequence[Device], statistics: dict[str, StreamStatistics], now: float
) -> Group:
    trackers = Table("tracker", "samples", "rate [Hz]", "age [ms]", "jitter [ms]", "quality")
    for name, s in statistics.items():
        age = "-" if s.count == 0 else f"{1e3 * (now - s.last):.0f}"
        trackers.add_row(
            name,
            str(s.count),
            f"{s.rate:.1f}",
            age,
            f"{1e3 * s.jitter:.2f}",
            "-" if s.count == 0 else f"{s.quality:.2f}",
        )
    lines = Table(
        "device", "state", "records", "bad", "skipped bytes", "foreign", "lost", "losses", "news"
    )
    for device in devices:
        c = device.counters
        news = device.last_error
        unmapped = sorted(set(c.seen) - _configured(device))
        if not news and unmapped and c.unmapped:
            news = f"stations without a tracker: {', '.join(unmapped[:8])}"
        lines.add_row(
            device.name,
            device.state,
            str(c.parser.records),
            str(c.parser.bad_records),
            str(c.parser.skipped_bytes),
            str(c.foreign),
            str(c.lost_records),
            str(c.port_losses + c.recoveries),
            news,
        )
    return Group(trackers, lines)


def _configured(device: Device) -> set[str]:
    return {str(s) for s in device.settings.stations.values()}
