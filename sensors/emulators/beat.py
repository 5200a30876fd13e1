"""What emulators that only send have in common: a beat, a motion, faults and a clock."""

import os
import select
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Sequence

from sensors.emulators.faults import Fault, FaultMaker, Noise
from sensors.emulators.is900 import EmulatorCounters, Start
from sensors.emulators.source import PoseSource, StationPose
from sensors.errors import ConfigurationError

_MAX_BACKLOG = 0.2
_MAX_HELD = 1024
_STALL_CHECK = 0.01


class BeatEmulator(ABC):
    """Sends the poses of all stations at a fixed rate, in a thread of its own.

    Args:
        pose_at: world poses of the stations at motion time t [s].
        rate: cycles a second [Hz].
        start: `"now"`, or `"later"` for a call of `begin`; until then the pose at zero is
            held.
        faults: what goes wrong, on motion time.
        noise: what is added to every pose.
        seed: of everything random.
        clock_drift: how much faster the device's clock runs [s/s].
        on_start: called with the host's monotonic time of motion zero.

    Raises:
        ConfigurationError: for impossible settings.
    """

    def __init__(
        self,
        pose_at: PoseSource,
        *,
        rate: float = 40.0,
        start: Start = "now",
        faults: Iterable[Fault] = (),
        noise: Noise | None = None,
        seed: int = 0,
        clock_drift: float = 0.0,
        on_start: Callable[[float], None] | None = None,
    ) -> None:
        if not 0.1 <= rate <= 1000.0:
            raise ConfigurationError(f"rate is {rate} Hz; give 0.1 to 1000")
        self.counters = EmulatorCounters()
        self.faults = FaultMaker(faults, noise, seed)
        self._pose_at = pose_at
        self._period = 1.0 / rate
        self._speed = 1.0 + clock_drift
        self._on_start = on_start
        self._begin_asked = start != "later"
        self._power_on = time.monotonic()
        self._zero: float | None = None
        self._started = threading.Event()
        self._held: deque[Callable[[], None]] = deque(maxlen=_MAX_HELD)
        self._stop = threading.Event()
        self._wake_read, self._wake_write = os.pipe()
        self._thread = threading.Thread(target=self._run, name=type(self).__name__, daemon=True)

    @property
    @abstractmethod
    def address(self) -> str:
        """Where it is, or where it sends to."""

    @abstractmethod
    def _send_cycle(self, poses: Sequence[StationPose | None], t: float, now: float) -> None:
        """Send the poses of one instant.

        Args:
            poses: world poses, faults included.
            t: motion time [s].
            now: the instant on the device's clock [s].
        """

    @property
    def motion_zero(self) -> float | None:
        """Host's monotonic time of motion time zero [s]; None before the start."""
        return self._zero

    def __enter__(self) -> "BeatEmulator":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Send from now on."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and close everything. Twice is no error."""
        if not self._stop.is_set():
            self._stop.set()
            self._wake()
            if self._thread.is_alive():
                self._thread.join()
            self._close()
            os.close(self._wake_read)
            os.close(self._wake_write)

    def begin(self) -> None:
        """Start the motion with the next cycle, if it has not started."""
        self._begin_asked = True
        if not self._stop.is_set():
            self._wake()

    def wait_started(self, timeout: float) -> bool:
        """Wait until the motion has started, at most `timeout` [s]."""
        return self._started.wait(timeout)

    def motion_time(self, now: float) -> float:
        """Motion time at a host time [s]; zero before the start."""
        return 0.0 if self._zero is None else max(0.0, now - self._zero)

    def _sockets(self) -> list[socket.socket]:
        """What else to wait on."""
        return []

    def _receive(self, ready: list[socket.socket]) -> None:
        """Serve the sockets that have something."""
        raise NotImplementedError(ready)

    @abstractmethod
    def _close(self) -> None:
        """Close the sockets."""

    def _wake(self) -> None:
        os.write(self._wake_write, b"\0")

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
        if self._begin_asked and self._zero is None:
            self._zero = instant
            self._started.set()
            if self._on_start is not None:
                self._on_start(instant)
        t = self.motion_time(instant)
        if self._zero is not None and self.faults.takes_power_cycle(t):
            self._power_on = instant
        self.counters.cycles += 1
        if self.faults.is_silent(t):
            return
        poses = self.faults.bend_all(self._pose_at(t), t)
        device_time = (instant - self._power_on) * self._speed

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
