"""What all emulators are: a thread that gives a motion away, from a zero on, with faults."""

import os
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal, Self

from sensors.emulators.faults import Fault, FaultMaker, Noise
from sensors.emulators.source import PoseSource
from sensors.errors import ConfigurationError

Start = Literal["continuous", "now", "later"]


@dataclass(slots=True)
class EmulatorCounters:
    """What the emulator has done; only grows.

    Attributes:
        cycles: instants at which records were made.
        records: records handed to the line, spoiled ones included.
        overruns: cycles left out because the line was full or the host did not read.
        command_bytes: bytes received.
    """

    cycles: int = 0
    records: int = 0
    overruns: int = 0
    command_bytes: int = 0


class Emulator(ABC):
    """A device made of software, in a thread of its own; use as a context manager.

    Args:
        pose_at: world poses of the stations at motion time t [s].
        begins: whether the motion starts with the first cycle; else the pose at zero is held
            until `begin`.
        rate: cycles a second [Hz].
        faults: what goes wrong, on motion time.
        noise: what is added to every pose.
        seed: of everything random.
        clock_drift: how much faster the device's clock runs [s/s].
        on_start: called in the emulator's thread with the host's monotonic time of motion
            zero.

    Raises:
        ConfigurationError: for impossible settings.
    """

    def __init__(
        self,
        pose_at: PoseSource,
        *,
        begins: bool,
        rate: float = 40.0,
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
        self._begin_asked = begins
        self._power_on = time.monotonic()
        self._zero: float | None = None
        self._started = threading.Event()
        self._stop = threading.Event()
        self._wake_read, self._wake_write = os.pipe()
        self._thread = threading.Thread(target=self._run, name=type(self).__name__, daemon=True)

    @property
    @abstractmethod
    def address(self) -> str:
        """What a host opens, or where it sends to."""

    @property
    def motion_zero(self) -> float | None:
        """Host's monotonic time of motion time zero [s]; None before the start."""
        return self._zero

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Answer or send from now on."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread and take the line away. Twice is no error."""
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

    @abstractmethod
    def _run(self) -> None:
        """Work until `_stop`; whoever waits also waits for `_wake_read`."""

    @abstractmethod
    def _close(self) -> None:
        """Close line or sockets."""

    def _wake(self) -> None:
        os.write(self._wake_write, b"\0")

    def _begin_motion(self, instant: float) -> None:
        """Let this instant be motion zero, if it was asked for and there is none yet."""
        if self._begin_asked and self._zero is None:
            self._zero = instant
            self._started.set()
            if self._on_start is not None:
                self._on_start(instant)

    def _device_time(self, now: float) -> float:
        """A host time on the device's clock [s]."""
        return (now - self._power_on) * self._speed
