"""From a recording back to the very frames that were made while it was recorded.

Raw chunks with their receive times go through the same decoders, clocks and assembler, and
frames are closed at the recorded instants after the recorded number of samples. Everything
on the way is a function of these alone, so the frames are the same to the last bit.
"""

import base64
import binascii
from collections import deque
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sensors.assembler import AssembledFrame, AssemblerConfig, FrameAssembler
from sensors.chunk import Chunk
from sensors.config import DeviceConfig, device_config
from sensors.devices.decoder import Decoder
from sensors.devices.registry import make_decoder
from sensors.errors import ConfigurationError, RecordingError
from sensors.placement import Placement, RoomTransform
from sensors.recording import schemas
from sensors.recording.reader import RecordedMessage, read_recording
from sensors.recording.recorder import VERSION
from sensors.stream import Received


@dataclass(frozen=True, slots=True)
class RecordedConfiguration:
    """What was recorded.

    Attributes:
        trackers: rows of the frames.
        devices: settings of the devices by their names.
        assembler: settings of the assembler.
        room: settings of the room at the beginning.
        unix_ns_at_monotonic_zero: adds to monotonic times to give calendar times [ns].
    """

    trackers: tuple[str, ...]
    devices: Mapping[str, DeviceConfig]
    assembler: AssemblerConfig
    room: Placement
    unix_ns_at_monotonic_zero: int

    @classmethod
    def parse(cls, data: Mapping[str, Any], path: Path) -> "RecordedConfiguration":
        """Read the message on `/sensors`.

        Raises:
            RecordingError: if this version cannot use it.
        """
        try:
            if data["version"] != VERSION:
                raise RecordingError(
                    f"{path} is a recording of version {data['version']}; this program reads "
                    f"version {VERSION}"
                )
            devices = [device_config(d) for d in data["devices"]]
            return cls(
                tuple(map(str, data["trackers"])),
                {d.name: d for d in devices},
                AssemblerConfig.parse(data["assembler"]),
                Placement.parse(data["room"]),
                int(data["unix_ns_at_monotonic_zero"]),
            )
        except (KeyError, TypeError, ValueError, ConfigurationError) as error:
            raise RecordingError(
                f"the settings in {path} cannot be used: {error}; was it made by another version?"
            ) from error

    def decoders(self) -> dict[str, Decoder]:
        """A fresh decoder for every device."""
        return {name: make_decoder(config) for name, config in self.devices.items()}


def read_configuration(path: Path) -> RecordedConfiguration:
    """What was recorded.

    Raises:
        RecordingError: if the file does not say.
    """
    for message in read_recording(path, (schemas.SENSORS,)):
        return RecordedConfiguration.parse(message.data, path)
    raise RecordingError(f"{path} holds no tracker data; was it recorded with localreg?")


def read_chunks(path: Path) -> Generator[tuple[str, Chunk], None, None]:
    """Device name and chunk, of all devices, in the order they were received.

    Raises:
        RecordingError: if the file cannot be read.
    """
    for message in read_recording(path, (schemas.RAW,)):
        yield _device_of(message), _chunk_of(message)


def replay_frames(path: Path) -> Iterator[AssembledFrame]:
    """The frames of a recording, made again from its raw bytes, bit for bit.

    Args:
        path: the recording; where it was cut off, the frames end.

    Raises:
        RecordingError: if it cannot be read, or lacks samples because the recorder had to
            let messages go.
    """
    wanted = (
        schemas.SENSORS,
        schemas.RAW,
        schemas.DROPPED,
        schemas.ROOM,
        schemas.FRAMES,
        schemas.LOST,
    )
    replay: _Replay | None = None
    for message in read_recording(path, wanted):
        if message.topic == schemas.SENSORS:
            replay = _Replay(RecordedConfiguration.parse(message.data, path), path)
        elif replay is not None:
            yield from replay.take(message)
    if replay is None:
        raise RecordingError(f"{path} holds no tracker data; was it recorded with localreg?")


class _Replay:
    """State of a replay."""

    def __init__(self, configuration: RecordedConfiguration, path: Path) -> None:
        self._path = path
        self._decoders = configuration.decoders()
        self._assembler = FrameAssembler(configuration.trackers, configuration.assembler)
        self._transform = configuration.room.transform
        self._samples: deque[Received] = deque()
        self._taken = 0
        self._drops: deque[tuple[int, int]] = deque()
        self._closing: tuple[float, int] | None = None

    def take(self, message: RecordedMessage) -> Iterator[AssembledFrame]:
        data = message.data
        if message.topic == schemas.FRAMES:
            yield from self._close(float(data["closed_at"]), int(data["taken"]))
        elif message.topic == schemas.DROPPED:
            self._drops.append((int(data["first"]), int(data["count"])))
        elif message.topic == schemas.LOST:
            raise self._incomplete()
        elif message.topic == schemas.ROOM:
            x, y, z = map(float, data["translation"])
            self._transform = RoomTransform(float(data["yaw"]), (x, y, z))
        else:
            decoder = self._decoders.get(_device_of(message))
            if decoder is not None:
                self._samples.extend(decoder.take(_chunk_of(message)))

    def _close(self, closed_at: float, taken: int) -> Iterator[AssembledFrame]:
        if self._closing == (closed_at, taken):
            return  # Several frames closed together: the first call gave all of them.
        self._closing = (closed_at, taken)
        if taken - self._taken > len(self._samples):
            raise self._incomplete()
        while self._taken < taken:
            sample, arrival = self._samples.popleft()
            if not self._was_dropped(self._taken):
                self._assembler.push(sample, arrival)
            self._taken += 1
        for assembled in self._assembler.poll(closed_at):
            yield assembled.placed(self._transform)

    def _incomplete(self) -> RecordingError:
        return RecordingError(
            f"{self._path} lacks raw data after frame {self._assembler.counters.frames}: the "
            "recorder could not keep up; use the frames it holds, or localreg sensors replay"
        )

    def _was_dropped(self, number: int) -> bool:
        while self._drops and number >= sum(self._drops[0]):
            self._drops.popleft()
        return bool(self._drops) and number >= self._drops[0][0]


def _device_of(message: RecordedMessage) -> str:
    return message.topic[len(schemas.RAW) :]


def _chunk_of(message: RecordedMessage) -> Chunk:
    data = message.data
    try:
        opening = data["opening"]
        if not (opening is None or isinstance(opening, dict)):
            raise TypeError(type(opening))
        raw = base64.b64decode(data["data"], validate=True)
        return Chunk(float(data["time"]), raw, str(data["source"]), opening)
    except (KeyError, TypeError, ValueError, binascii.Error) as error:
        raise RecordingError(f"a message on {message.topic} is no chunk: {error!r}") from error
