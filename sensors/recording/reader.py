"""Reads a recording, complete or cut off anywhere."""

import json
import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zstandard
from mcap.exceptions import InvalidMagic, McapError
from mcap.records import Channel, Message
from mcap.stream_reader import CRCValidationError, StreamReader

from sensors.errors import RecordingError

# A torn length must not make the reader ask for gigabytes.
_LARGEST_RECORD = 256 * 2**20


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

    A file whose writer was killed simply ends earlier.

    Args:
        path: the file.
        topics: only these channels; a name that ends in a slash stands for all below it.
            By default all.

    Raises:
        RecordingError: if the file cannot be opened or is no recording at all.
    """
    try:
        with path.open("rb") as file:
            yield from _messages(StreamReader(file, record_size_limit=_LARGEST_RECORD), topics)
    except OSError as error:
        raise RecordingError(f"cannot read {path}: {error.strerror or error}") from error
    except InvalidMagic:
        raise RecordingError(f"{path} is no recording; give an .mcap file") from None
    except (McapError, CRCValidationError, zstandard.ZstdError, struct.error):
        # Cut off in the middle of a record: what came before is good.
        return


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
