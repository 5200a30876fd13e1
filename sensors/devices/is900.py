"""Driver for the InterSense IS-900 on a serial port, or on TCP through `socket://`.

One thread reads. It never gives up: a port that is gone is opened again, a device that is
silent is stopped, reset and set up again, each time after a longer pause; and a stream of
garbage counts as silence, for after a power failure the unit speaks another encoding.
A processor with more stations than its line carries has several ports: configure one
device for each.
"""

import os
import time
from collections.abc import Mapping
from typing import Literal, Self

from pydantic import Field, field_validator, model_validator

from sensors.arrival_clock import ArrivalClock
from sensors.chunk import Chunk
from sensors.clock import DeviceClock
from sensors.devices.base import ChunkSink, ThreadedDevice
from sensors.devices.decoder import Decoder
from sensors.devices.is900_setup import Is900Setup, has_pose
from sensors.devices.serial_link import SerialLink
from sensors.devices.settings import DeviceSettings
from sensors.errors import ProtocolError
from sensors.protocols.is900 import commands
from sensors.protocols.is900.axes import flip_position, flip_quaternion
from sensors.protocols.is900.parser import Parser
from sensors.protocols.is900.records import Record, layout_variants
from sensors.stream import Received, SampleQueue

_MAX_WAIT = 0.25


class Is900Config(DeviceSettings):
    """Settings of the driver.

    Attributes:
        port: device path or pyserial URL, for example `/dev/ttyUSB0` or
            `socket://192.168.1.20:4001`.
        stations: station number of each tracker name, 1 to 12, for example `{head = 1}`.
            Empty: all stations that are on, named after their numbers.
        baud: line rate [bit/s].
        items: output list. Without item 21, the time, captures are dated by the even beat
            behind the arrivals. The default, position, quaternion, tracking status, time and CR
            LF, is 38 bytes: six stations at 50 Hz on 115200 baud.
        prediction: prediction by the device, 0 to 50 [ms].
        transport_delay: smallest time from capture to arrival, subtracted from time stamps
            [s]. By default the time of one record on the line (3.3 ms) if the port is a
            serial port, and 0 for sockets and pseudo terminals, which carry bytes at once.
        silence_timeout: without a record for this long the device is set up anew [s].
        answer_timeout: how long an answer may take [s].
        reset_timeout: how long the device may be deaf after a reset [s].
        max_reset_pause: longest pause between attempts to set up a device that does not
            answer [s].
        clock_zero_interval: the device's clock is zeroed this often [s], since float32
            milliseconds grow coarser than 1 ms after 4.7 h; 0 never.
    """

    driver: Literal["is900"] = "is900"
    port: str = Field(min_length=1)
    baud: int = Field(default=115200, ge=300)
    items: tuple[int, ...] = (2, 11, 40, 21, 1)
    prediction: int = 0
    transport_delay: float | None = Field(default=None, ge=0.0)
    silence_timeout: float = Field(default=2.0, gt=0.0)
    answer_timeout: float = Field(default=1.0, gt=0.0)
    reset_timeout: float = Field(default=20.0, gt=0.0)
    max_reset_pause: float = Field(default=10.0, gt=0.0)
    clock_zero_interval: float = Field(default=7200.0, ge=0.0)

    @field_validator("items")
    @classmethod
    def _check_items(cls, items: tuple[int, ...]) -> tuple[int, ...]:
        try:
            layout_variants(items)
        except ProtocolError as error:
            raise ValueError(str(error)) from None
        if not has_pose(items):
            raise ValueError(f"items {','.join(map(str, items))} hold no pose; use 2,11,40,21,1")
        return items

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not all(isinstance(n, int) and 1 <= n <= 12 for n in self.stations.values()):
            raise ValueError(
                f"stations are {dict(self.stations)}; give each tracker a number from 1 to 12"
            )
        if not 0 <= self.prediction <= 50:
            raise ValueError(f"prediction is {self.prediction} ms; give 0 to 50")
        return self

    @property
    def numbers(self) -> tuple[int, ...]:
        """The stations' numbers in the order of the trackers."""
        return tuple(int(n) for n in self.stations.values())

    @property
    def record_time(self) -> float:
        """Time of one record on a serial line, at 10 bits a byte [s]."""
        return layout_variants(self.items)[0].length * 10.0 / self.baud

    @property
    def address(self) -> str:
        """The port."""
        return self.port


class Is900Decoder(Decoder):
    """Bytes of a set-up IS-900 to samples."""

    def __init__(self, config: Is900Config) -> None:
        super().__init__(config)
        self.clock = DeviceClock()
        self._beats: dict[int, ArrivalClock] = {}
        self._transport_delay = 0.0
        self._parser = Parser({})

    def begin(self, chunk: Chunk) -> None:
        """A stream of records with the output lists that the device has confirmed."""
        opening = chunk.opening or {}
        self._parser.reset()
        self._parser = Parser({int(n): tuple(items) for n, items in opening["lists"].items()})
        self._parser.counters = self.counters.parser
        self._transport_delay = float(opening["transport_delay"])
        self.clock.reset()
        self._beats.clear()

    def feed(self, chunk: Chunk) -> list[Received]:
        """Decode records; answers are passed over."""
        found: list[Received] = []
        for message in self._parser.feed(chunk.data):
            if isinstance(message, Record):
                self._add(message, chunk.time, found)
        return found

    def _add(self, record: Record, arrival: float, found: list[Received]) -> None:
        p, q, device_time = record.position, record.quaternion, record.time
        if record.status != " ":
            self.counters.flagged += 1
        name = self.name_of(str(record.station))
        if name is None or p is None or q is None:
            return
        if device_time is None:
            captured = self._beats.setdefault(record.station, ArrivalClock()).update(arrival)
        else:
            captured = self.clock.update(device_time, arrival)
        quality = 1.0 if record.tracking_status is None else record.tracking_status
        p, q = flip_position(p), flip_quaternion(q)
        time = captured - self._transport_delay
        found.append(self.sample(name, time, p, q, quality, arrival))


def _is_serial_line(port: str) -> bool:
    return "://" not in port and not os.path.realpath(port).startswith("/dev/pts/")


class Is900Device(ThreadedDevice[SerialLink]):
    """A running IS-900.

    Args:
        config: settings.
        samples: where samples go; by default a queue of its own.
        recorder: who gets every chunk.
    """

    def __init__(
        self,
        config: Is900Config,
        samples: SampleQueue | None = None,
        recorder: ChunkSink | None = None,
    ) -> None:
        super().__init__(config, Is900Decoder(config), samples, recorder)
        self.config = config
        self._needs_reset = False
        self._reset_pause = config.pause

    def _open(self) -> SerialLink:
        return SerialLink(self.config.port, self.config.baud)

    def _unanswered(self) -> None:
        # The port works, the device does not answer. Opening the port anew costs little and
        # is what a replugged adapter needs.
        self._needs_reset = True
        self._wait_before_reset()

    def _serve(self, link: SerialLink) -> None:
        """Set up and read until stopped; failures raise."""
        while self._running():
            self.state = "setting up"
            setup = Is900Setup(
                link, self.config.answer_timeout, self.config.reset_timeout, self._running
            )
            lists = setup.run(
                self.config.numbers, self.config.items, self.config.prediction, self._needs_reset
            )
            self._read(link, lists)
            if self._running():
                self._needs_reset = True
                self.counters.recoveries += 1
                self._wait_before_reset()

    def _wait_before_reset(self) -> None:
        self.state = "waiting"
        self._stop.wait(self._reset_pause)
        self._reset_pause = min(2.0 * self._reset_pause, self.config.max_reset_pause)

    def _read(self, link: SerialLink, lists: Mapping[int, tuple[int, ...]]) -> None:
        """Stream until stopped or silent."""
        delay = self.config.transport_delay
        if delay is None:
            delay = self.config.record_time if _is_serial_line(self.config.port) else 0.0
        self._begin(
            {"lists": {str(n): list(i) for n, i in lists.items()}, "transport_delay": delay}
        )
        link.write(commands.CONTINUOUS)
        self.state = "streaming"
        last_record = zeroed = time.monotonic()
        records = self.counters.parser.records
        while self._running():
            data = link.read(_MAX_WAIT)
            arrival = time.monotonic()
            if data:
                self._take(Chunk(arrival, data))
            if self.counters.parser.records > records:
                records = self.counters.parser.records
                last_record = arrival
                self._is_well()
                self._needs_reset, self._reset_pause = False, self.config.pause
            elif arrival - last_record > self.config.silence_timeout:
                self.last_error = (
                    f"no record for {self.config.silence_timeout:g} s; resetting the device"
                )
                return
            interval = self.config.clock_zero_interval
            if interval > 0.0 and arrival - zeroed > interval:
                link.write(commands.CLOCK_ZERO)
                zeroed = arrival
        link.write(commands.STOP)
