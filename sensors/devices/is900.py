"""Driver for the InterSense IS-900 on a serial port, or on TCP through `socket://`.

One thread reads. It never gives up: a port that is gone is opened again, a device that is
silent is stopped, reset and set up again, each time after a longer pause; and a stream of
garbage counts as silence, for after a power failure the unit speaks another encoding.
"""

import math
import os
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field

from sensors.clock import DeviceClock
from sensors.devices.base import Device
from sensors.devices.is900_setup import Is900Setup, has_pose
from sensors.devices.serial_link import SerialLink
from sensors.errors import ConfigurationError, ConnectionFailedError, LinkLostError
from sensors.pose import PoseSample
from sensors.protocols.is900 import commands
from sensors.protocols.is900.axes import RoomTransform, flip_position, flip_quaternion
from sensors.protocols.is900.parser import Parser
from sensors.protocols.is900.records import Record, layout_variants
from sensors.stream import Received, SampleQueue

_MAX_WAIT = 0.25


@dataclass(frozen=True)
class Is900Config:
    """Settings of the driver.

    Attributes:
        port: device path or pyserial URL, for example `/dev/ttyUSB0` or
            `socket://192.168.1.20:4001`.
        stations: station number of each tracker name, for example `{"head": 1}`.
        baud: line rate [bit/s].
        items: output list. The default, position, quaternion, tracking status, time and CR
            LF, is 38 bytes: six stations at 50 Hz on 115200 baud.
        room_yaw: turn of the tracker's world in the room, about the vertical [deg].
        room_translation: origin of the tracker's world in the room [m].
        prediction: prediction by the device, 0 to 50 [ms].
        transport_delay: smallest time from capture to arrival, subtracted from time stamps
            [s]. By default the time of one record on the line (3.3 ms) if the port is a
            serial port, and 0 for sockets and pseudo terminals, which carry bytes at once.
        silence_timeout: without a record for this long the device is set up anew [s].
        answer_timeout: how long an answer may take [s].
        reset_timeout: how long the device may be deaf after a reset [s].
        pause: first pause between attempts [s]; it doubles each time.
        max_pause: longest pause [s].
        clock_zero_interval: the device's clock is zeroed this often [s], since float32
            milliseconds grow coarser than 1 ms after 4.7 h; 0 never.
    """

    port: str
    stations: Mapping[str, int]
    baud: int = 115200
    items: tuple[int, ...] = (2, 11, 40, 21, 1)
    room_yaw: float = 0.0
    room_translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    prediction: int = 0
    transport_delay: float | None = None
    silence_timeout: float = 2.0
    answer_timeout: float = 1.0
    reset_timeout: float = 20.0
    pause: float = 0.5
    max_pause: float = 10.0
    clock_zero_interval: float = 7200.0
    room: RoomTransform = field(init=False)

    def __post_init__(self) -> None:
        numbers = list(self.stations.values())
        if not numbers or len(set(numbers)) != len(numbers) or not set(numbers) <= {*range(1, 13)}:
            raise ConfigurationError(
                f"stations are {dict(self.stations)}; give each tracker a station of its own, "
                "1 to 12"
            )
        items = tuple(self.items)
        layout_variants(items)
        if not has_pose(items):
            raise ConfigurationError(
                f"items {','.join(map(str, items))} hold no pose; use 2,11,40,21,1"
            )
        if not 0 <= self.prediction <= 50:
            raise ConfigurationError(f"prediction is {self.prediction} ms; give 0 to 50")
        if len(self.room_translation) != 3:
            raise ConfigurationError("room_translation needs three numbers, x y z in meters")
        for name in ("silence_timeout", "answer_timeout", "pause", "max_pause"):
            if not getattr(self, name) > 0.0:
                raise ConfigurationError(f"{name} must be a positive time in seconds")
        x, y, z = self.room_translation
        room = RoomTransform(math.radians(self.room_yaw), (x, y, z))
        object.__setattr__(self, "items", items)
        object.__setattr__(self, "room", room)

    @property
    def record_time(self) -> float:
        """Time of one record on a serial line, at 10 bits a byte [s]."""
        return layout_variants(tuple(self.items))[0].length * 10.0 / self.baud


def _is_serial_line(port: str) -> bool:
    return "://" not in port and not os.path.realpath(port).startswith("/dev/pts/")


class Is900Device(Device):
    """A running IS-900.

    Args:
        config: settings.
        samples: where samples go; by default a queue of its own.
    """

    def __init__(self, config: Is900Config, samples: SampleQueue | None = None) -> None:
        super().__init__(SampleQueue() if samples is None else samples)
        self.config = config
        self.clock = DeviceClock()
        self.counters.samples = dict.fromkeys(config.stations, 0)
        self._names = {station: name for name, station in config.stations.items()}
        self._pause = config.pause
        self._needs_reset = False
        delay = config.transport_delay
        if delay is None:
            delay = config.record_time if _is_serial_line(config.port) else 0.0
        self._transport_delay = delay
        self._stop = threading.Event()
        self._lock = threading.Lock()
        self._link: SerialLink | None = None
        self._thread: threading.Thread | None = None

    @property
    def trackers(self) -> tuple[str, ...]:
        """Names in the order of the configuration."""
        return tuple(self.config.stations)

    def start(self) -> None:
        """Begin to connect and read, in the background; returns at once."""
        if self._thread is None:
            self._stop.clear()
            self._thread = threading.Thread(target=self._run, name="is900", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Stop the stream, close the port and end the thread."""
        self._stop.set()
        with self._lock:
            if self._link is not None:
                self._link.wake()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _running(self) -> bool:
        return not self._stop.is_set()

    def _run(self) -> None:
        while self._running():
            try:
                self.state = "connecting"
                link = SerialLink(self.config.port, self.config.baud)
            except ConnectionFailedError as error:
                self._fail(error)
                continue
            with self._lock:
                self._link = link
            self.counters.connects += 1
            try:
                self._serve(link)
            except LinkLostError as error:
                self.counters.port_losses += 1
                self._fail(error)
            except ConnectionFailedError as error:
                # The port works, the device does not answer. Opening the port anew costs
                # little and is what a replugged adapter needs.
                self._needs_reset = True
                self._fail(error)
            finally:
                with self._lock:
                    self._link = None
                link.close()
        self.state = "stopped"

    def _serve(self, link: SerialLink) -> None:
        """Set up and read until stopped; failures raise."""
        stations = tuple(self.config.stations.values())
        while self._running():
            self.state = "setting up"
            setup = Is900Setup(
                link, self.config.answer_timeout, self.config.reset_timeout, self._running
            )
            lists = setup.run(
                stations, self.config.items, self.config.prediction, self._needs_reset
            )
            self._read(link, lists)
            if self._running():
                self._needs_reset = True
                self.counters.recoveries += 1
                self._wait()

    def _read(self, link: SerialLink, lists: Mapping[int, tuple[int, ...]]) -> None:
        """Stream until stopped or silent."""
        parser = Parser(lists)
        parser.counters = self.counters.parser
        self.clock.reset()
        link.write(commands.CONTINUOUS)
        self.state = "streaming"
        last_record = zeroed = time.monotonic()
        try:
            while self._running():
                data = link.read(_MAX_WAIT)
                arrival = time.monotonic()
                records = [m for m in parser.feed(data) if isinstance(m, Record)]
                if records:
                    last_record = arrival
                    self._pause, self.last_error = self.config.pause, ""
                    self._needs_reset = False
                    self.samples.put([r for m in records for r in self._samples(m, arrival)])
                elif arrival - last_record > self.config.silence_timeout:
                    self.last_error = (
                        f"no record for {self.config.silence_timeout:g} s; resetting the device"
                    )
                    return
                interval = self.config.clock_zero_interval
                if interval > 0.0 and arrival - zeroed > interval:
                    link.write(commands.CLOCK_ZERO)
                    zeroed = arrival
        finally:
            parser.reset()
        link.write(commands.STOP)

    def _samples(self, record: Record, arrival: float) -> list[Received]:
        name = self._names.get(record.station)
        if name is None:
            self.counters.unmapped += 1
            return []
        p, q, device_time = record.position, record.quaternion, record.time
        if record.status != " ":
            self.counters.flagged += 1
        if p is None or q is None:
            return []
        captured = arrival if device_time is None else self.clock.update(device_time, arrival)
        quality = 1.0 if record.tracking_status is None else record.tracking_status
        p, q = self.config.room.apply(flip_position(p), flip_quaternion(q))
        self.counters.samples[name] += 1
        sample = PoseSample(name, captured - self._transport_delay, p, q, quality)
        return [Received(sample, arrival)]

    def _fail(self, error: ConnectionFailedError) -> None:
        if not self._running():
            return
        self.counters.failures += 1
        self.last_error = str(error)
        self._wait()

    def _wait(self) -> None:
        self.state = "waiting"
        self._stop.wait(self._pause)
        self._pause = min(2.0 * self._pause, self.config.max_pause)
