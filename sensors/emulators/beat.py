"""What emulators that only send have in common: a beat that they keep."""

import os
import select
import socket
import time
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from sensors.emulators.base import Emulator, Start
from sensors.emulators.source import PoseSource, StationPose

_MAX_BACKLOG = 0.2
_MAX_HELD = 1024
_STALL_CHECK = 0.01


class BeatEmulator(Emulator):
    """Sends the poses of all stations at a fixed rate, in a thread of its own.

    Args:
        pose_at: world poses of the stations at motion time t [s].
        start: `"now"`, or `"later"` for a call of `begin`; until then the pose at zero is
            held.
        settings: as for `Emulator`.

    Raises:
        ConfigurationError: for impossible settings.
    """

    def __init__(self, pose_at: PoseSource, *, start: Start = "now", **settings: Any) -> None:
        super().__init__(pose_at, begins=start != "later", **settings)
        self._held: deque[Callable[[], None]] = deque(maxlen=_MAX_HELD)

    @abstractmethod
    def _send_cycle(self, poses: Sequence[StationPose | None], t: float, now: float) -> None:
        """Send the poses of one instant.

        Args:
            poses: world poses, faults included.
            t: motion time [s].
            now: the instant on the device's clock [s].
        """

    def _sockets(self) -> list[socket.socket]:
        """What else to wait on."""
        return []

    def _receive(self, ready: list[socket.socket]) -> None:
        """Serve the sockets that have something."""
        raise NotImplementedError(ready)

    def _run(self) -> None:
        due = time.monotonic()
        while not self._stop.is_set():
            now = time.monotonic()
            wait = max(0.0, due - now)
            if self._held:
                wait = min(wait, _STALL_CHECK)
            ready, _, _ = select.select([self._wake_read, *self._sockets()], [], [], wait)
            if self._wake_read in ready:
                os.read(self._wake_read, 256)
            sockets = [s for s in ready if isinstance(s, socket.socket)]
            if sockets:
                self._receive(sockets)
            now = time.monotonic()
            if self._held and not self.faults.is_stalled(self.motion_time(now)):
                while self._held:
                    self._held.popleft()()
            if now >= due:
                if now - due > _MAX_BACKLOG:
                    missed = int((now - due) / self._period)
                    self.counters.overruns += missed
                    due += missed * self._period
                self._cycle(due)
                due += self._period

    def _cycle(self, instant: float) -> None:
        self._begin_motion(instant)
        t = self.motion_time(instant)
        if self._zero is not None and self.faults.takes_power_cycle(t):
            self._power_on = instant
        self.counters.cycles += 1
        if self.faults.is_silent(t):
            return
        poses = self.faults.bend_all(self._pose_at(t), t)
        device_time = self._device_time(instant)

        def send() -> None:
            self._send_cycle(poses, t, device_time)

        if self.faults.is_stalled(t):
            self._held.append(send)
        else:
            send()


def datagrams_of(data: bytes, spoilt: bytes) -> list[bytes]:
    """Junk before a record is, for datagrams, a datagram of its own."""
    if len(spoilt) > len(data) and spoilt.endswith(data):
        return [spoilt[: len(spoilt) - len(data)], data]
    return [spoilt]
