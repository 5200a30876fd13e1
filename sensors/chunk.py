"""The raw input of a device: what was read, and when. Everything else follows from it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Chunk:
    """Bytes as they came, or the news that a new stream begins.

    A device's samples are a function of its configuration and its chunks alone; so a
    recording of the chunks is a recording of everything.

    Attributes:
        time: when the last byte was in memory, host's monotonic clock [s].
        data: the bytes.
        source: which of the device's ways they came, for example `"tcp"` or `"udp"`.
        opening: given if a new stream begins here: what the conversation with the device
            brought to light and its decoder must know. Only what JSON can hold.
    """

    time: float
    data: bytes = b""
    source: str = ""
    opening: Mapping[str, Any] | None = None
