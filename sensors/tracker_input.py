"""Devices, queue, assembler and room of a configuration, put together."""

from collections.abc import Sequence

from sensors.assembler import FrameAssembler
from sensors.config import SensorsConfig
from sensors.devices.base import Device
from sensors.devices.registry import open_device
from sensors.host_clock import HostClock
from sensors.recording.recorder import Recorder
from sensors.room import Room
from sensors.stream import FrameStream, SampleQueue


class TrackerInput:
    """All trackers of a configuration as one stream of frames; use as a context manager.

    Args:
        config: the tracker side of a configuration.
        trackers: rows of the frames; by default all trackers in the order of the file.
        recorder: records chunks, samples, frames and settings, if given.

    Attributes:
        devices: the drivers, started by entering the context.
        stream: where frames come from.
        room: where the trackers' world sits; move it while running.

    Raises:
        ConfigurationError: for trackers nobody reports.
    """

    def __init__(
        self,
        config: SensorsConfig,
        *,
        trackers: Sequence[str] = (),
        recorder: Recorder | None = None,
    ) -> None:
        self.config = config
        self.trackers = tuple(trackers) or config.trackers
        self.samples = SampleQueue()
        self.assembler = FrameAssembler(self.trackers, config.assembler)
        self.room = Room(config.room)
        configs = config.named_devices()
        self.devices: tuple[Device, ...] = tuple(
            open_device(c, self.samples, recorder) for c in configs
        )
        self.stream = FrameStream(
            self.samples,
            self.assembler,
            room=self.room,
            clock=self._clock(),
            recorder=recorder,
        )
        if recorder is not None:
            recorder.configuration(
                self.trackers,
                [c.model_dump(mode="json") for c in configs],
                config.assembler.model_dump(mode="json"),
                config.room.model_dump(mode="json"),
            )

    def _clock(self) -> HostClock:
        return HostClock()

    def __enter__(self) -> "TrackerInput":
        for device in self.devices:
            device.start()
        return self

    def __exit__(self, *_: object) -> None:
        for device in self.devices:
            device.stop()
