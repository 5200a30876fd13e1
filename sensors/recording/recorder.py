"""Writes everything down while it happens, without ever holding it up.

The file is MCAP with JSON messages: it opens in Foxglove, and in twenty years with any MCAP
and JSON reader. Callers only put into a bounded queue; a thread of the recorder's own turns
the messages into text and closes a chunk of the file every `flush_interval`. A file whose
writer was killed is a good file up to the last closed chunk. If the disk is full the
recording ends with one message, and nothing else does.
"""

import base64
import json
import logging
import math
import os
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer

from sensors.assembler import AssembledFrame
from sensors.chunk import Chunk
from sensors.errors import RecordingError
from sensors.placement import RoomTransform
from sensors.recording import schemas
from sensors.recording.schemas import Schema
from sensors.stream import Received

_LOG = logging.getLogger(__name__)

VERSION = 1
"""Version of the layout of recordings."""


@dataclass(slots=True)
class RecorderCounters:
    """What became of the messages; only grows.

    Attributes:
        messages: written and flushed.
        lost: let go because the queue was full, or the disk.
        refused: not JSON.
        bytes: of the file.
        flushes: times the file was brought up to date.
    """

    messages: int = 0
    lost: int = 0
    refused: int = 0
    bytes: int = 0
    flushes: int = 0


class _Output:
    """An append-only file that keeps nothing back once an error has occurred."""

    def __init__(self, path: Path) -> None:
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o644)
        self._pending = bytearray()
        self._written = 0

    def write(self, data: bytes) -> int:
        self._pending += data
        return len(data)

    def tell(self) -> int:
        return self._written + len(self._pending)

    def flush(self) -> None:
        while self._pending:
            sent = os.write(self._fd, self._pending)
            self._written += sent
            del self._pending[:sent]

    def close(self) -> None:
        os.close(self._fd)


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """A named channel of a recording; obtained from `Recorder.channel`.

    Attributes:
        topic: its name, for example `"/poses"`.
        schema_name: name of its schema, for example `"foxglove.FrameTransforms"`.
        schema: JSON schema of its messages.
    """

    topic: str
    schema_name: str
    schema: Schema
    _put: Callable[["Channel", float, object], None]

    def write(self, message: Mapping[str, Any], time: float) -> None:
        """Record a message; never blocks, never raises.

        Args:
            message: what JSON can hold, and NumPy arrays; not changed afterward, for it is
                turned into text later. Numbers that are not finite become null.
            time: host's monotonic time it belongs to [s].
        """
        self._put(self, time, message)


class Recorder:
    """A recording being made; use as a context manager.

    Safe from any thread. It is a sink for devices (`chunk`) and for the `FrameStream`
    (`frame`, `dropped`, `room`); everybody else asks for a channel of their own.

    Args:
        path: file to make; it must not exist yet.
        flush_interval: the file is brought up to date this often [s]; 0.1 is the promise. The
            index that is written at the end takes 900 bytes of memory each time, 65 MB an
            hour. (Without chunks there is no index, but files are twice as large and can
            only be read from end to end.)
        capacity: messages held at most; 20,000 are about half a minute of six trackers.

    Raises:
        RecordingError: if the file cannot be made.
    """

    def __init__(self, path: Path, *, flush_interval: float = 0.05, capacity: int = 20_000) -> None:
        self.path = path
        self.counters = RecorderCounters()
        self.error = ""
        self._interval = flush_interval
        self._capacity = capacity
        self._lock = threading.Lock()
        self._items: list[tuple[Channel, float, object]] = []
        self._channels: dict[str, Channel] = {}
        self._ids: dict[str, int] = {}
        self._epoch = time.time_ns() - time.monotonic_ns()
        self._stop = threading.Event()
        try:
            self._output = _Output(path)
        except OSError as error:
            raise RecordingError(_cannot_make(path, error)) from error
        # The writer takes any object with write, tell and flush.
        output: Any = self._output
        self._writer = Writer(output)
        self._told_lost = 0
        own = self.channel
        self._samples = own(schemas.SAMPLES, "foxglove.FrameTransforms", schemas.FRAME_TRANSFORMS)
        self._frames = own(schemas.FRAMES, "sensors.Frame", schemas.FRAME)
        self._dropped = own(schemas.DROPPED, "sensors.Dropped", schemas.DROPPED_SAMPLES)
        self._room = own(schemas.ROOM, "sensors.Room", schemas.ROOM_PLACEMENT)
        self._lost = own(schemas.LOST, "sensors.Recorder", schemas.RECORDER)
        self._configuration = own(schemas.SENSORS, "sensors.Configuration", schemas.CONFIGURATION)
        try:
            self._writer.start(profile="", library="localreg sensors")
            self._output.flush()
        except OSError as error:
            self._output.close()
            raise RecordingError(_cannot_make(path, error)) from error
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def channel(self, topic: str, schema_name: str, schema: Schema) -> Channel:
        """A channel for messages of one kind; asking again gives the same channel.

        Args:
            topic: its name, beginning with a slash.
            schema_name: name of the schema; those of Foxglove's schemas are drawn by it.
            schema: JSON schema of the messages.

        Raises:
            RecordingError: if the topic exists with another schema.
        """
        with self._lock:
            known = self._channels.get(topic)
            if known is None:
                known = Channel(topic, schema_name, schema, self._put)
                self._channels[topic] = known
        if known.schema_name != schema_name:
            raise RecordingError(
                f"the channel {topic} holds {known.schema_name}; give {schema_name} another topic"
            )
        return known

    def configuration(
        self,
        trackers: Sequence[str],
        devices: Sequence[Mapping[str, Any]],
        assembler: Mapping[str, Any],
        room: Mapping[str, Any],
    ) -> None:
        """Record what is recorded; a replay needs it.

        Args:
            trackers: rows of the frames.
            devices: settings of every device, its unique `name` among them.
            assembler: settings of the assembler.
            room: settings of the room at the beginning.
        """
        message = {
            "version": VERSION,
            "unix_ns_at_monotonic_zero": self._epoch,
            "trackers": list(trackers),
            "devices": list(devices),
            "assembler": assembler,
            "room": room,
        }
        self._configuration.write(message, time.monotonic())

    def chunk(self, device: str, chunk: Chunk, received: Sequence[Received]) -> None:
        """Record raw bytes of a device and the samples they gave."""
        topic = f"{schemas.RAW}{device}"
        channel = self._channels.get(topic)
        if channel is None:
            channel = self.channel(topic, "sensors.RawChunk", schemas.RAW_CHUNK)
        self._put(channel, chunk.time, chunk)
        if received:
            self._put(self._samples, chunk.time, received)

    def frame(self, assembled: AssembledFrame, taken: int) -> None:
        """Record a closed frame and how many samples had been taken from the queue."""
        self._put(self._frames, assembled.closed_at, (assembled, taken))

    def dropped(self, first: int, count: int) -> None:
        """Record that samples gave way in the queue."""
        self._dropped.write({"first": first, "count": count}, time.monotonic())

    def room(self, transform: RoomTransform) -> None:
        """Record where the trackers' world sits from the next frame on."""
        message = {"yaw": transform.yaw, "translation": transform.translation}
        self._room.write(message, time.monotonic())

    def close(self) -> None:
        """Write what is left and finish the file. Twice is no error."""
        if not self._stop.is_set():
            self._stop.set()
            self._thread.join()

    def _put(self, channel: Channel, when: float, message: object) -> None:
        with self._lock:
            if self.error or self._stop.is_set() or len(self._items) >= self._capacity:
                self.counters.lost += 1
            else:
                self._items.append((channel, when, message))

    def _run(self) -> None:
        try:
            while not self._stop.wait(self._interval):
                self._write_down()
            self._write_down()
            self._writer.finish()
            self._output.flush()
        except OSError as error:
            self._give_up(error)
        finally:
            self.counters.bytes = self._output.tell()
            self._output.close()

    def _write_down(self) -> None:
        with self._lock:
            items, self._items = self._items, []
        if self.counters.lost > self._told_lost:
            self._told_lost = self.counters.lost
            # Right here: what stands before is complete.
            items.append((self._lost, time.monotonic(), {"lost": self._told_lost}))
        written = 0
        for channel, when, message in items:
            try:
                text = _to_json(self._plain(message))
            except (TypeError, ValueError, RecursionError) as error:
                self.counters.refused += 1
                _LOG.error(
                    "a message on %s is no JSON and was not recorded: %s", channel.topic, error
                )
                continue
            unix = max(0, round(when * 1e9) + self._epoch)
            self._writer.add_message(self._id(channel), unix, text, unix)
            written += 1
        if items:
            self._writer.flush()
            self.counters.messages += written
            self.counters.flushes += 1
            self.counters.bytes = self._output.tell()

    def _id(self, channel: Channel) -> int:
        known = self._ids.get(channel.topic)
        if known is None:
            text = json.dumps(channel.schema).encode()
            schema = self._writer.register_schema(channel.schema_name, "jsonschema", text)
            known = self._writer.register_channel(channel.topic, "json", schema)
            self._ids[channel.topic] = known
        return known

    def _give_up(self, error: OSError) -> None:
        with self._lock:
            self.error = (
                f"the recording {self.path} ended early: {error.strerror or error}; what was "
                "written before can be read, and everything else goes on. Make room, or record "
                "elsewhere"
            )
            self.counters.lost += len(self._items)
            self._items = []
        _LOG.error("%s", self.error)

    def _plain(self, message: Any) -> object:
        """What JSON holds, of the kinds of message there are."""
        if isinstance(message, Chunk):
            return {
                "time": message.time,
                "data": base64.b64encode(message.data).decode("ascii"),
                "source": message.source,
                "opening": message.opening,
            }
        if isinstance(message, tuple):
            return _frame(*message)
        if isinstance(message, list):
            return {"transforms": [self._transform(r) for r in message]}
        return message

    def _transform(self, received: Received) -> dict[str, object]:
        sample, arrival = received
        sec, nsec = divmod(round(sample.time * 1e9) + self._epoch, 1_000_000_000)
        (x, y, z), (qw, qx, qy, qz) = sample.position.tolist(), sample.quaternion.tolist()
        return {
            "timestamp": {"sec": sec, "nsec": nsec},
            "parent_frame_id": schemas.WORLD,
            "child_frame_id": sample.tracker,
            "translation": {"x": x, "y": y, "z": z},
            "rotation": {"x": qx, "y": qy, "z": qz, "w": qw},
            "time": sample.time,
            "arrival": arrival,
            "quality": sample.quality,
        }


def _frame(assembled: AssembledFrame, taken: int) -> dict[str, object]:
    f = assembled.frame
    return {
        "index": assembled.index,
        "time": f.time,
        "closed_at": assembled.closed_at,
        "taken": taken,
        "newest_arrival": assembled.newest_arrival,
        "positions": f.positions,
        "quaternions": f.quaternions,
        "position_mask": f.position_mask,
        "orientation_mask": f.orientation_mask,
        "swaps": assembled.swaps,
    }


def _to_json(message: object) -> bytes:
    try:
        text = json.dumps(message, default=_array, allow_nan=False, separators=(",", ":"))
    except ValueError:
        # Rare: JSON has no NaN.
        text = json.dumps(_finite(message), allow_nan=False, separators=(",", ":"))
    return text.encode("utf-8")


def _array(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is not JSON")


def _finite(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(k): _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return value


def _cannot_make(path: Path, error: OSError) -> str:
    if isinstance(error, FileExistsError):
        return f"{path} exists already; recordings are never overwritten, choose another name"
    return f"cannot make the recording {path}: {error.strerror or error}; choose another place"
