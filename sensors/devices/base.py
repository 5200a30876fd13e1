"""What every driver is: a thread that puts samples into a queue until it is stopped.

It never gives up: what is gone is opened again after a growing pause. What the driver reads
goes, as `Chunk`s, to the recorder and to a pure `Decoder`.
"""

import logging
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Generic, Protocol, TypeVar, runtime_checkable

from sensors.chunk import Chunk
from sensors.devices.decoder import Decoder, DeviceCounters
from sensors.devices.settings import DeviceSettings
from sensors.errors import ConnectionFailedError, LinkLostError, SensorError
from sensors.stream import Received, SampleQueue

_LOG = logging.getLogger(__name__)

__all__ = ["ChunkSink", "Device", "DeviceCounters", "Link", "ThreadedDevice"]


@runtime_checkable
class ChunkSink(Protocol):
    """Who wants to have every chunk of every device: the recorder."""

    def chunk(self, device: str, chunk: Chunk, received: Sequence[Received]) -> None:
        """Take a chunk and the samples it gave; must neither block nor raise."""


class Device(ABC):
    """A driver. It runs from `start` to `stop` and never ends because of data or ports.

    Args:
        config: settings.
        samples: where samples go; devices may share one queue. By default a queue of its
            own.
        recorder: who gets every chunk.
    """

    def __init__(
        self,
        config: DeviceSettings,
        samples: SampleQueue | None = None,
        recorder: ChunkSink | None = None,
    ) -> None:
        self.settings = config
        self.name = config.name or config.kind
        self.samples = SampleQueue() if samples is None else samples
        self.recorder = recorder
        self.state = "stopped"
        self.last_error = ""

    @property
    @abstractmethod
    def counters(self) -> DeviceCounters:
        """What the driver has been through."""

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

    @abstractmethod
    def wait_attempt(self, timeout: float) -> bool:
        """Wait until the first attempt to open has ended, at most `timeout` [s].

        Returns:
            Whether the device is open; if not, `last_error` says why.
        """

    def _hand_on(self, name: str, chunk: Chunk, received: list[Received]) -> None:
        """Give a chunk of a device to the recorder, and its samples to the queue."""
        # In the order of the queue, so that a replay can put samples in the same order.
        with self.samples.ordered:
            if self.recorder is not None:
                self.recorder.chunk(name, chunk, received)
            if received:
                self.samples.put(received)

    def __enter__(self) -> "Device":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


@runtime_checkable
class Link(Protocol):
    """An open line or socket."""

    def wake(self) -> None:
        """Let a waiting read return at once, now and from now on; from any thread."""

    def close(self) -> None:
        """Close it."""


_Link = TypeVar("_Link", bound=Link)


class ThreadedDevice(Device, Generic[_Link]):
    """A driver with one thread that opens, serves and opens again.

    Args:
        config: settings.
        decoder: makes samples of chunks.
        samples: where samples go.
        recorder: who gets every chunk.
    """

    def __init__(
        self,
        config: DeviceSettings,
        decoder: Decoder,
        samples: SampleQueue | None = None,
        recorder: ChunkSink | None = None,
    ) -> None:
        super().__init__(config, samples, recorder)
        self.decoder = decoder
        self._pause = config.pause
        self._stop = threading.Event()
        self._attempted = threading.Event()
        self._lock = threading.Lock()
        self._link: _Link | None = None
        self._thread: threading.Thread | None = None

    @property
    def counters(self) -> DeviceCounters:
        """What the driver has been through."""
        return self.decoder.counters

    @property
    def trackers(self) -> tuple[str, ...]:
        """Names in the order of the configuration."""
        return tuple(self.settings.stations)

    @abstractmethod
    def _open(self) -> _Link:
        """Open the line; raises `ConnectionFailedError`."""

    @abstractmethod
    def _serve(self, link: _Link) -> None:
        """Read until `_running()` is false; raises `LinkLostError` or `ConnectionFailedError`."""

    def start(self) -> None:
        """Begin to connect and read, in the background; returns at once."""
        if self._thread is None:
            self._stop.clear()
            self._attempted.clear()
            self._thread = threading.Thread(target=self._run, name=self.name, daemon=True)
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

    def wait_attempt(self, timeout: float) -> bool:
        """Wait until the first attempt to open has ended, at most `timeout` [s]."""
        self._attempted.wait(timeout)
        return self.counters.connects > 0

    def _running(self) -> bool:
        return not self._stop.is_set()

    def _run(self) -> None:
        while self._running():
            try:
                self.state = "connecting"
                link = self._open()
            except ConnectionFailedError as error:
                self._fail(error)
                continue
            with self._lock:
                self._link = link
            self.counters.connects += 1
            self._attempted.set()
            try:
                self._serve(link)
            except LinkLostError as error:
                self.counters.port_losses += 1
                self._fail(error)
            except ConnectionFailedError as error:
                self._unanswered()
                self._fail(error)
            except Exception as error:
                # A defect of ours must not silence a tracker for the rest of a performance.
                _LOG.exception("the driver of %s failed and begins anew", self.name)
                self._fail(SensorError(f"a defect in the driver of {self.name}: {error!r}"))
            finally:
                with self._lock:
                    self._link = None
                link.close()
        self.state = "stopped"

    def _unanswered(self) -> None:
        """Called when the line works but the device does not answer."""

    def _fail(self, error: SensorError) -> None:
        if not self._running():
            return
        self.counters.failures += 1
        self.last_error = str(error)
        self._attempted.set()
        self._wait()

    def _wait(self) -> None:
        self.state = "waiting"
        self._stop.wait(self._pause)
        self._pause = min(2.0 * self._pause, self.settings.max_pause)

    def _is_well(self) -> None:
        """Note that data comes: the next failure begins with the shortest pause again."""
        self._pause, self.last_error = self.settings.pause, ""

    def _begin(self, opening: Mapping[str, Any]) -> None:
        """A new stream begins: tell recorder and decoder."""
        self._take(Chunk(time.monotonic(), opening=opening))

    def _take(self, chunk: Chunk) -> None:
        """Hand a chunk to the decoder, then all there is on."""
        self._hand_on(self.name, chunk, self.decoder.take(chunk))
