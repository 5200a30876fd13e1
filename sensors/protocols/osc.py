"""Open Sound Control 1.0, reading only: what a datagram of unknown origin holds.

A reader of our own, because that of python-osc (which the senders here use) follows the
lengths inside a bundle without checking them: one datagram with a negative length keeps it
busy forever.
"""

import struct
from dataclasses import dataclass

from sensors.errors import MalformedRecordError

VMC_PORT = 39539
"""Where programs listen for the Virtual Motion Capture protocol."""

VRCHAT_PORT = 9000
"""Where VRChat listens."""

Argument = int | float | str | bytes | bool | None

_BUNDLE = b"#bundle\0"
_MAX_DEPTH = 8
# From 1900, the zero of time tags, to 1970.
_NTP_TO_UNIX = 2_208_988_800


@dataclass(frozen=True, slots=True)
class OscMessage:
    """One message.

    Attributes:
        address: for example `"/VMC/Ext/Tra/Pos"`.
        arguments: in order.
        time: time tag of the bundle it came in, seconds since 1970; None for "at once".
    """

    address: str
    arguments: tuple[Argument, ...]
    time: float | None = None


def decode(data: bytes) -> list[OscMessage]:
    """All messages of a datagram, in order.

    Raises:
        MalformedRecordError: if it is no OSC.
    """
    messages: list[OscMessage] = []
    _decode(data, None, 0, messages)
    return messages


def _decode(data: bytes, time: float | None, depth: int, messages: list[OscMessage]) -> None:
    if not data.startswith(_BUNDLE):
        messages.append(_message(data, time))
        return
    if len(data) < 16 or depth >= _MAX_DEPTH:
        raise MalformedRecordError("a bundle that is too short, or too deep")
    (tag,) = struct.unpack_from(">Q", data, 8)
    time = None if tag <= 1 else tag / 2.0**32 - _NTP_TO_UNIX
    at = 16
    while at < len(data):
        if len(data) - at < 4:
            raise MalformedRecordError("a bundle that ends inside a length")
        (length,) = struct.unpack_from(">i", data, at)
        at += 4
        if length < 4 or length % 4 or length > len(data) - at:
            raise MalformedRecordError("an element longer than its bundle")
        _decode(data[at : at + length], time, depth + 1, messages)
        at += length


def _message(data: bytes, time: float | None) -> OscMessage:
    if data[:1] != b"/":
        raise MalformedRecordError("an address that does not begin with a slash")
    address, at = _text(data, 0)
    if at == len(data):
        return OscMessage(address, (), time)
    tags, at = _text(data, at)
    if tags[:1] != ",":
        raise MalformedRecordError("type tags that do not begin with a comma")
    arguments: list[Argument] = []
    for tag in tags[1:]:
        if tag in _CONSTANTS:
            arguments.append(_CONSTANTS[tag])
        elif tag in _NUMBERS:
            layout = _NUMBERS[tag]
            if len(data) - at < layout.size:
                raise MalformedRecordError("a message shorter than its type tags")
            arguments.append(layout.unpack_from(data, at)[0])
            at += layout.size
        elif tag in "sS":
            text, at = _text(data, at)
            arguments.append(text)
        elif tag == "b":
            blob, at = _blob(data, at)
            arguments.append(blob)
        else:
            raise MalformedRecordError(f"the type tag {tag!r} is unknown")
    return OscMessage(address, tuple(arguments), time)


_NUMBERS = {
    tag: struct.Struct(form)
    for tag, form in (("i", ">i"), ("f", ">f"), ("h", ">q"), ("d", ">d"), ("t", ">Q"))
}
_CONSTANTS: dict[str, Argument] = {"T": True, "F": False, "N": None, "I": None}


def _text(data: bytes, at: int) -> tuple[str, int]:
    end = data.find(b"\0", at)
    if end < 0:
        raise MalformedRecordError("a text without an end")
    after = at + (end - at) // 4 * 4 + 4
    if after > len(data):
        raise MalformedRecordError("a text without padding")
    try:
        return data[at:end].decode("utf-8"), after
    except UnicodeDecodeError:
        raise MalformedRecordError("a text that is none") from None


def _blob(data: bytes, at: int) -> tuple[bytes, int]:
    if len(data) - at < 4:
        raise MalformedRecordError("a message shorter than its type tags")
    (length,) = struct.unpack_from(">i", data, at)
    after = at + 4 + -(-length // 4) * 4
    if length < 0 or after > len(data):
        raise MalformedRecordError("a blob longer than its message")
    return data[at + 4 : at + 4 + length], after
