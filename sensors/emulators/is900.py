"""An IS-900 that streams: the unit, a line, a clock to keep and faults on request."""

import os
import select
import time
from collections import deque
from typing import Any

from sensors.emulators.base import Emulator, Start
from sensors.emulators.endpoints import Endpoint, PtyEndpoint
from sensors.emulators.source import PoseSource, StationPose
from sensors.emulators.unit import Is900Unit
from sensors.errors import ConfigurationError
from sensors.protocols.is900 import commands

# A slow line may lag this far behind before whole cycles are left out [s].
_MAX_BACKLOG = 0.2
# Nor may a host that does not read let more bytes pile up than this.
_MAX_QUEUED = 4096
_RETRY_PAUSE = 0.01
# A cycle's bytes are made this long before they are due [s]: making six records takes about
# a millisecond, which the host would else see as a delay of the device.
_LEAD = 0.005


class Is900Emulator(Emulator):
    """An IS-900 on a line, in a thread of its own.

    Cycle k is due at a multiple of the period on the monotonic clock, whatever the cycles
    before it took, and carries the pose of exactly that instant. Device time (item 21) is
    that instant too, on a clock that started with the emulator.

    Args:
        pose_at: world poses of the stations at motion time t [s].
        stations: how many stations, 1..12.
        rate: cycles a second [Hz].
        endpoint: the line; by default a new pseudo terminal.
        start: what begins the motion: the first `C` from the host, at once, or a call of
            `begin`. Until then the pose at zero is held.
        baud: if given, bytes leave no faster than on a serial line, 10 bits each.
        settings: as for `Emulator`.

    Raises:
        ConfigurationError: for impossible settings.
    """

    def __init__(
        self,
        pose_at: PoseSource,
        *,
        stations: int = 6,
        rate: float = 40.0,
        endpoint: Endpoint | None = None,
        start: Start = "continuous",
        baud: int | None = None,
        **settings: Any,
    ) -> None:
        if not 1 <= stations <= 12:
            raise ConfigurationError(f"there cannot be {stations} stations; give 1 to 12")
        if baud is not None and baud < 300:
            raise ConfigurationError(f"baud is {baud}; give at least 300, usually 115200")
        super().__init__(pose_at, begins=start == "now", rate=rate, **settings)
        self.unit = Is900Unit(stations)
        self._endpoint = PtyEndpoint() if endpoint is None else endpoint
        self._lead = min(_LEAD, 0.5 / rate)
        self._start: Start = start
        self._seconds_per_byte = 0.0 if baud is None else 10.0 / baud
        self._next_cycle = self._power_on
        self._prepared: tuple[float, list[bytes]] | None = None
        # Portions and when their last byte has crossed the line.
        self._outgoing: deque[tuple[float, bytes]] = deque()
        self._line_free = self._power_on

    @property
    def address(self) -> str:
        """What a host opens."""
        return self._endpoint.address

    def _close(self) -> None:
        self._endpoint.close()

    def _run(self) -> None:
        while not self._stop.is_set():
            now = time.monotonic()
            due = self._next_cycle if not self._outgoing else self._outgoing[0][0]
            if self.faults.is_stalled(self.motion_time(now)):
                due = now + _RETRY_PAUSE
            wake = self._next_cycle - (0.0 if self._prepared else self._lead)
            wait = max(0.0, min(due, wake) - now)
            descriptors = [self._wake_read, *self._endpoint.readable()]
            ready, _, _ = select.select(descriptors, [], [], wait)
            if self._wake_read in ready:
                os.read(self._wake_read, 256)
            if any(fd != self._wake_read for fd in ready):
                self._receive()
            now = time.monotonic()
            if now >= self._next_cycle:
                self._cycle(now)
                self._prepared = None
            elif self._prepared is None and now >= self._next_cycle - self._lead:
                self._prepared = (self._next_cycle, self._make_records(self._next_cycle))
            self._flush(now)

    def _receive(self) -> None:
        data = self._endpoint.read()
        if not data:
            return
        self._prepared = None
        now = time.monotonic()
        self.counters.command_bytes += len(data)
        t = self.motion_time(now)
        answers = self.unit.receive(data, self._device_time(now), self._pose_at, t)
        if self.unit.continuous and self._start == "continuous" and self._zero is None:
            # Motion zero is this very moment: the next cycle is the first, due now.
            self._next_cycle = now
            self._begin_asked = True
        if not self.faults.is_silent(t):
            self._send(answers, now)
            for _ in range(self.unit.polls):
                self._send_records(now)
        self.unit.polls = 0

    def _cycle(self, now: float) -> None:
        instant = self._next_cycle
        if now - instant > _MAX_BACKLOG:
            # The process was held up: leave out what is long past, stay on the grid.
            missed = int((now - instant) / self._period)
            instant += missed * self._period
            self.counters.overruns += missed
        self._next_cycle = instant + self._period
        self._begin_motion(instant)
        t = self.motion_time(instant)
        if self._zero is not None and self.faults.takes_power_cycle(t):
            self.unit.receive(commands.RESET, self._device_time(now), self._pose_at, t)
            self._outgoing.clear()
        if self.faults.is_silent(t):
            self._outgoing.clear()
        elif self.unit.streaming:
            queued = sum(len(data) for _, data in self._outgoing)
            if self._line_free - now > _MAX_BACKLOG or queued > _MAX_QUEUED:
                self.counters.overruns += 1
                return
            self._send_records(instant)

    def _send_records(self, instant: float) -> None:
        prepared = self._prepared
        ready = prepared is not None and prepared[0] == instant
        records = prepared[1] if prepared is not None and ready else self._make_records(instant)
        now = time.monotonic()
        self.counters.cycles += 1
        self.counters.records += len(records)
        for record in records:
            self._send(record, now)

    def _make_records(self, instant: float) -> list[bytes]:
        """The bytes of one cycle; none if nothing would be sent of it."""
        if not (self.unit.streaming or self.unit.polls):
            return []
        t = self.motion_time(instant)

        def bent(at: float) -> list[StationPose | None]:
            return self.faults.bend_all(self._pose_at(at), t)

        records = self.unit.records(bent, t, self._device_time(instant))
        return [self.faults.spoil(self.unit.encode(record), t) for _, record in records]

    def _send(self, data: bytes, now: float) -> None:
        if data:
            self._line_free = max(now, self._line_free) + len(data) * self._seconds_per_byte
            self._outgoing.append((self._line_free, data))

    def _flush(self, now: float) -> None:
        due = bytearray()
        if self.faults.is_stalled(self.motion_time(now)):
            return
        while self._outgoing and self._outgoing[0][0] <= now:
            due += self._outgoing.popleft()[1]
        if due:
            sent = self._endpoint.write(bytes(due))
            if sent < len(due):
                self._outgoing.appendleft((now + _RETRY_PAUSE, bytes(due[sent:])))
