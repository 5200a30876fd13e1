"""Devices, queue, assembler and room of a configuration, put together."""

from collections.abc import Sequence

from sensors.assembler import FrameAssembler
from sensors.config import SensorsConfig
from sensors.devices.base import Device
from sensors.devices.registry import open_device
from sensors.devices.replay import ReplayDevice
from sensors.errors import ConfigurationError
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
        self.samples = SampleQueue()
        self.room = Room(config.room)
        configs = config.named_devices()
        self.devices: tuple[Device, ...] = tuple(
            open_device(c, self.samples, recorder) for c in configs
        )
        reported = tuple(name for device in self.devices for name in device.trackers)
        self.trackers = tuple(trackers) or reported
        missing = sorted(set(self.trackers) - set(reported))
        if missing:
            raise ConfigurationError(
                f"no device reports the tracker {missing[0]}; there are {', '.join(reported)}"
            )
        self.assembler = FrameAssembler(self.trackers, config.assembler)
        self.stream = FrameStream(
            self.samples,
            self.assembler,
            room=self.room,
            clock=self._clock(),
            recorder=recorder,
        )
        if recorder is not None:
            # What is replayed and recorded again is the devices of the first recording.
            recorded = [
                c
                for device, config_ in zip(self.devices, configs, strict=True)
                for c in (
                    device.recorded.devices.values()
                    if isinstance(device, ReplayDevice)
                    else (config_,)
                )
            ]
            recorder.configuration(
                self.trackers,
                [c.model_dump(mode="json") for c in recorded],
                config.assembler.model_dump(mode="json"),
                config.room.model_dump(mode="json"),
            )

    def _clock(self) -> HostClock:
        replays = [d for d in self.devices if isinstance(d, ReplayDevice)]
        return replays[0].clock if replays else HostClock()

    def __enter__(self) -> "TrackerInput":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start(self) -> None:
        """Start the devices; returns at once."""
        for device in self.devices:
            device.start()

    def stop(self) -> None:
        """Stop the devices."""
        for device in self.devices:
            device.stop()
