"""Plays a recording as if its devices were there.

Samples keep the times they had; so the frames must live on the recording's time, too, which
is the driver's `clock`. (For the very same frames, without waiting, there is
`sensors.recording.replay.replay_frames`.)
"""

import threading
from pathlib import Path
from typing import Literal

from pydantic import Field

from sensors.devices.base import ChunkSink, Device
from sensors.devices.decoder import Decoder, DeviceCounters
from sensors.devices.settings import DeviceSettings
from sensors.errors import RecordingError, SensorError
from sensors.host_clock import ScaledClock
from sensors.stream import SampleQueue


class ReplayConfig(DeviceSettings):
    """Settings of the driver.

    Attributes:
        file: the recording.
        speed: seconds of the recording in one second.
        stations: may be left out: the trackers are those of the recording.
    """

    driver: Literal["replay"] = "replay"
    file: Path
    speed: float = Field(default=1.0, gt=0.0, le=1000.0)

    @property
    def address(self) -> str:
        """The recording."""
        return str(self.file)


class ReplayDevice(Device):
    """A recording that plays.

    Args:
        config: settings.
        samples: where samples go; by default a queue of its own.
        recorder: who gets every chunk.

    Attributes:
        clock: the time of the recording; it begins with `start`.
        finished: set when all has been played.

    Raises:
        RecordingError: if the file is no recording of trackers.
    """

    def __init__(
        self,
        config: ReplayConfig,
        samples: SampleQueue | None = None,
        recorder: ChunkSink | None = None,
    ) -> None:
        # Recordings need the settings of all devices, and so this very module.
        from sensors.recording.replay import read_chunks, read_configuration

        super().__init__(config, samples, recorder)
        self.config = config
        self.recorded = read_configuration(config.file)
        self._chunks = read_chunks(config.file)
        self._first = next(self._chunks, None)
        if self._first is None:
            raise RecordingError(f"{config.file} ends before the first byte; nothing to replay")
        self.clock = ScaledClock(self._first[1].time, config.speed)
        self.finished = threading.Event()
        self._decoders: dict[str, Decoder] = self.recorded.decoders()
        self._counters = DeviceCounters()
        for decoder in self._decoders.values():
            decoder.counters = self._counters
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def counters(self) -> DeviceCounters:
        """What all devices of the recording have been through, together."""
        return self._counters

    @property
    def trackers(self) -> tuple[str, ...]:
        """The trackers of the recording."""
        return self.recorded.trackers

    def start(self) -> None:
        """Begin to play; once only."""
        if self._thread is None:
            self._counters.connects += 1
            self.clock.restart()
            self._thread = threading.Thread(target=self._run, name=self.name, daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Stop playing."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._chunks.close()

    def wait_attempt(self, timeout: float) -> bool:
        """A recording that could be read is there."""
        return True

    def _run(self) -> None:
        self.state = "streaming"
        try:
            self._play()
            self.state = "finished"
        except SensorError as error:
            self._counters.failures += 1
            self.last_error = str(error)
            self.state = "failed"
        self.finished.set()
        self.samples.wake()

    def _play(self) -> None:
        item = self._first
        while item is not None:
            device, chunk = item
            wait = (chunk.time - self.clock.now()) / self.clock.speed
            if self._stop.wait(wait) if wait > 0.0 else self._stop.is_set():
                return
            decoder = self._decoders.get(device)
            self._hand_on(device, chunk, [] if decoder is None else decoder.take(chunk))
            item = next(self._chunks, None)
