"""Frames of a recording, made again from its raw bytes exactly as they were made live.

Bytes go through the decoders of the recorded devices with the receive times that were
recorded, and frames are closed at the recorded instants, each when as many samples had been
taken from the queue as then. Nothing depends on the present clock.
"""

import base64
from collections import deque
from collections.abc import Iterator
from pathlib import Path

from localreg.errors import LocalregError
from sensors.assembler import AssembledFrame, AssemblerConfig, FrameAssembler
from sensors.chunk import Chunk
from sensors.config import device_config
from sensors.devices.decoder import Decoder
from sensors.devices.registry import make_decoder
from sensors.placement import Placement, RoomTransform
from sensors.recording import RecordedMessage, read_recording, schemas
from sensors.stream import Received


def frames_from_raw(path: Path) -> Iterator[AssembledFrame]:
    """The frames of a recording, complete or cut off, placed in the room as they were.

    Raises:
        LocalregError: it does not say what was recorded.
        SensorError: it is no recording, or of devices that this version does not know.
    """
    topics = (schemas.SENSORS, schemas.RAW, schemas.FRAMES, schemas.DROPPED, schemas.ROOM)
    messages = read_recording(path, topics)
    early: list[RecordedMessage] = []
    for message in messages:
        if message.topic == schemas.SENSORS:
            line = _Line(message)
            for before in early:
                yield from line.take(before)
            break
        early.append(message)
    else:
        raise LocalregError(f"{path} does not say which devices were recorded; nothing to repeat")
    for message in messages:
        yield from line.take(message)


class _Line:
    """Decoders, queue, assembler and room, driven by the messages of a recording."""

    def __init__(self, configuration: RecordedMessage) -> None:
        data = configuration.data
        self._decoders: dict[str, Decoder] = {}
        for values in data["devices"]:
            config = device_config(values)
            self._decoders[schemas.RAW + config.name] = make_decoder(config)
        self._assembler = FrameAssembler(
            data["trackers"], AssemblerConfig.parse(data["assembler"], "the recorded assembler")
        )
        self._transform = Placement.parse(data["room"], "the recorded room").transform
        self._waiting: deque[Received] = deque()
        self._first = 0
        self._closed = -1

    def take(self, message: RecordedMessage) -> Iterator[AssembledFrame]:
        """Go on by one message."""
        data = message.data
        if message.topic == schemas.FRAMES:
            yield from self._close(data["index"], data["closed_at"], data["taken"])
        elif message.topic == schemas.DROPPED:
            self._skip(data["first"] + data["count"])
        elif message.topic == schemas.ROOM:
            x, y, z = data["translation"]
            self._transform = RoomTransform(data["yaw"], (x, y, z))
        elif message.topic in self._decoders:
            chunk = Chunk(
                data["time"], base64.b64decode(data["data"]), data["source"], data["opening"]
            )
            self._waiting.extend(self._decoders[message.topic].take(chunk))

    def _close(self, index: int, closed_at: float, taken: int) -> Iterator[AssembledFrame]:
        if index <= self._closed:  # closed together with one before
            return
        while self._first < taken and self._waiting:
            sample, arrival = self._waiting.popleft()
            self._first += 1
            self._assembler.push(sample, arrival)
        for assembled in self._assembler.poll(closed_at):
            self._closed = assembled.index
            yield assembled.placed(self._transform)

    def _skip(self, until: int) -> None:
        while self._first < until and self._waiting:
            self._waiting.popleft()
            self._first += 1
