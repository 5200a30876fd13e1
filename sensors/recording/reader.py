"""Reads a recording, complete or cut off anywhere."""

import json
import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final

import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

from sensors.errors import RecordingError

# A torn length must not make the reader ask for gigabytes.
_LARGEST_RECORD: Final = 256 * 2**20

# What the reader may stumble over where bytes are damaged: lengths and names among them.
_DAMAGE: Final = (
    McapError, zstandard.ZstdError, struct.error, ValueError, OverflowError, MemoryError,
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class RecordedMessage:
    """One message of a recording.

    Attributes:
        topic: its channel.
        unix_ns: its calendar time [ns since 1970].
        data: its content.
    """

    topic: str
    unix_ns: int
    data: dict[str, Any]


def read_recording(path: Path, topics: Collection[str] = ()) -> Iterator[RecordedMessage]:
    """Everything in a recording, in the order it was written.

    A file whose writer was killed simply ends earlier, as does a damaged one.

    Args:
        path: the file.
        topics: only these channels; a name that ends in a slash stands for all below it.
            By default all.

    Raises:
        RecordingError: if the file cannot be opened or is no recording at all.
    """
    try:
        with path.open("rb") as file:
            if not MCAP0_MAGIC.startswith(file.read(len(MCAP0_MAGIC))):
                raise RecordingError(f"{path} is no recording; give an .mcap file")
            wary: Any = _Wary(file)
            reader = StreamReader(wary, skip_magic=True, record_size_limit=_LARGEST_RECORD)
            yield from _messages(reader, topics)
    except OSError as error:
        raise RecordingError(f"cannot read {path}: {error.strerror or error}") from error
    except _DAMAGE:
        # Cut off in the middle of a record: what came before is good.
        return


class _Wary:
    """A file that never reads more at once than the largest record, whatever a chunk claims."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def read(self, size: int) -> bytes:
        if size > _LARGEST_RECORD:
            raise ValueError(f"{size} bytes at once")
        return self._file.read(size)


def _messages(reader: StreamReader, topics: Collection[str]) -> Iterator[RecordedMessage]:
    channels: dict[int, Channel] = {}
    for record in reader.records:
        if isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            channel = channels.get(record.channel_id)
            if channel is None or channel.message_encoding != "json":
                continue
            if topics and not any(_matches(channel.topic, t) for t in topics):
                continue
            try:
                data = json.loads(record.data)
            except ValueError:
                continue
            if isinstance(data, dict):
                yield RecordedMessage(channel.topic, record.log_time, data)


def _matches(topic: str, wanted: str) -> bool:
    return topic == wanted or (wanted.endswith("/") and topic.startswith(wanted))
