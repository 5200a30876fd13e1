"""VRPN, version 07: messages on a TCP stream or in UDP datagrams.

Both sides of a TCP connection begin with a cookie of 24 bytes. Then come messages: a header
of 24 bytes, big endian (length, seconds, microseconds, sender, type, four bytes to ignore)
and a payload padded to a multiple of 8, which the length leaves out. Ids of senders and types
belong to the side that uses them, which describes each by name before its first use.
"""

import math
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sensors import rotation
from sensors.errors import MalformedRecordError

DEFAULT_PORT = 3883
COOKIE = b"vrpn: ver. 07.38  0".ljust(24, b"\0")
_COOKIE_MATCH = COOKIE[: COOKIE.rindex(b".") + 1]

SENDER_DESCRIPTION = -1
TYPE_DESCRIPTION = -2
UDP_DESCRIPTION = -3
LOG_DESCRIPTION = -4

POSE = "vrpn_Tracker Pos_Quat"
PING = "vrpn_Base ping_message"
PONG = "vrpn_Base pong_message"
CONTROL = "VRPN Control"

_HEADER = struct.Struct(">iIIiiI")
HEADER_LENGTH = _HEADER.size
_POSE = struct.Struct(">ii7d")
# VRPN's own buffers hold 64,000 bytes, so no message can be longer.
_MAX_PAYLOAD = 64_000
_MAX_IDS = 2_000
_MAX_COORDINATE = 1_000.0


@dataclass(frozen=True, slots=True)
class Message:
    """One message.

    Attributes:
        kind: type id; negative for descriptions.
        sender: sender id; for descriptions the id or port that is described.
        time: seconds of the sender's clock, since 1970 by convention [s].
        payload: without the padding.
    """

    kind: int
    sender: int
    time: float = 0.0
    payload: bytes = b""

    def encode(self) -> bytes:
        """Header, payload, padding."""
        seconds = math.floor(self.time)
        microseconds = min(999_999, round((self.time - seconds) * 1e6))
        length = HEADER_LENGTH + len(self.payload)
        header = _HEADER.pack(length, seconds, microseconds, self.sender, self.kind, 0)
        return header + self.payload.ljust(_padded(len(self.payload)), b"\0")


@dataclass(frozen=True, slots=True)
class PoseReport:
    """Content of a `vrpn_Tracker Pos_Quat` message.

    Attributes:
        sensor: number of the sensor of its device.
        position: shape (3,) [m].
        quaternion: w x y z, shape (4,), unit length.
    """

    sensor: int
    position: NDArray[np.float64]
    quaternion: NDArray[np.float64]

    def encode(self) -> bytes:
        """The payload; quaternions go x y z w."""
        w, x, y, z = self.quaternion.tolist()
        return _POSE.pack(self.sensor, 0, *self.position.tolist(), x, y, z, w)


def decode_pose(payload: bytes) -> PoseReport:
    """Read a pose.

    Raises:
        MalformedRecordError: for another length, or values that make no pose.
    """
    if len(payload) != _POSE.size:
        raise MalformedRecordError(f"a pose has {_POSE.size} bytes, not {len(payload)}")
    sensor, _, *values = _POSE.unpack(payload)
    norm = math.hypot(*values[3:])
    if not (
        all(map(math.isfinite, values))
        and max(map(abs, values[:3])) <= _MAX_COORDINATE
        and abs(norm - 1.0) < 0.1
        and 0 <= sensor < _MAX_IDS
    ):
        raise MalformedRecordError("a pose that cannot be")
    x, y, z, w = values[3:]
    return PoseReport(sensor, np.array(values[:3]), rotation.normalize(np.array([w, x, y, z])))


def description(kind: int, number: int, name: str) -> Message:
    """The name of a sender (`SENDER_DESCRIPTION`) or type (`TYPE_DESCRIPTION`)."""
    text = name.encode("utf-8") + b"\0"
    return Message(kind, number, payload=struct.pack(">i", len(text)) + text)


def decode_description(payload: bytes) -> str:
    """The name in a description.

    Raises:
        MalformedRecordError: if lengths or letters are wrong.
    """
    if len(payload) < 5:
        raise MalformedRecordError("a description without a name")
    (length,) = struct.unpack_from(">i", payload)
    text = payload[4:]
    if not 1 <= length <= len(text):
        raise MalformedRecordError("a description of another length")
    try:
        return text[:length].split(b"\0", 1)[0].decode("utf-8")
    except UnicodeDecodeError:
        raise MalformedRecordError("a name that is no text") from None


def udp_description(host: str, port: int) -> Message:
    """Where the other side may send by UDP."""
    return Message(UDP_DESCRIPTION, port, payload=host.encode("ascii") + b"\0")


def connection_request(host: str, port: int) -> bytes:
    """The datagram by which a client asks the server to connect back by TCP."""
    return f"{host} {port}".encode("ascii") + b"\0"


def decode_connection_request(data: bytes) -> tuple[str, int]:
    """Address and port of a connection request.

    Raises:
        MalformedRecordError: if it is none.
    """
    text = data.split(b"\0", 1)[0]
    host, _, port = text.partition(b" ")
    if len(text) > 256 or not host.isascii() or not port.strip().isdigit():
        raise MalformedRecordError("no connection request")
    number = int(port)
    if not 1 <= number <= 65535:
        raise MalformedRecordError("no port")
    return host.decode("ascii"), number


def is_cookie(data: bytes) -> bool:
    """Whether the first 24 bytes of a connection are of a version we can speak to."""
    return data.startswith(_COOKIE_MATCH)


class MessageReader:
    """Splits bytes into messages.

    Args:
        with_cookie: whether a cookie comes first, as on TCP.
    """

    def __init__(self, with_cookie: bool) -> None:
        self._buffer = bytearray()
        self._needs_cookie = with_cookie

    @property
    def has_cookie(self) -> bool:
        """Whether the cookie, if one is due, has come."""
        return not self._needs_cookie

    @property
    def pending(self) -> int:
        """Bytes of a message that is not complete."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Message]:
        """Take the next bytes.

        Returns:
            What became complete with them.

        Raises:
            MalformedRecordError: if this is not VRPN, or out of step. Nothing after it can
                be understood; the buffer is empty then.
        """
        self._buffer += data
        messages: list[Message] = []
        try:
            if self._needs_cookie:
                if len(self._buffer) < len(COOKIE):
                    return messages
                if not is_cookie(bytes(self._buffer[: len(COOKIE)])):
                    raise MalformedRecordError("the other side does not speak VRPN 07")
                del self._buffer[: len(COOKIE)]
                self._needs_cookie = False
            while (message := self._next()) is not None:
                messages.append(message)
        except MalformedRecordError:
            self._buffer.clear()
            raise
        return messages

    def _next(self) -> Message | None:
        if len(self._buffer) < HEADER_LENGTH:
            return None
        length, seconds, microseconds, sender, kind, _ = _HEADER.unpack_from(self._buffer)
        payload = length - HEADER_LENGTH
        if not 0 <= payload <= _MAX_PAYLOAD or microseconds > 1_000_000:
            raise MalformedRecordError("a header that cannot be")
        whole = HEADER_LENGTH + _padded(payload)
        if len(self._buffer) < whole:
            return None
        data = bytes(self._buffer[HEADER_LENGTH:length])
        del self._buffer[:whole]
        return Message(kind, sender, seconds + 1e-6 * microseconds, data)


def read_datagram(data: bytes) -> list[Message]:
    """All messages of a UDP datagram.

    Raises:
        MalformedRecordError: if it does not consist of whole messages.
    """
    reader = MessageReader(with_cookie=False)
    messages = reader.feed(data)
    if reader.pending:
        raise MalformedRecordError("a datagram that ends inside a message")
    return messages


class NameTable:
    """Names that the other side gave to its ids; of bounded size."""

    def __init__(self) -> None:
        self.senders: dict[int, str] = {}
        self.types: dict[int, str] = {}

    def learn(self, message: Message) -> bool:
        """Take a description.

        Returns:
            Whether the message was one.

        Raises:
            MalformedRecordError: if it cannot be read.
        """
        table = {SENDER_DESCRIPTION: self.senders, TYPE_DESCRIPTION: self.types}.get(message.kind)
        if table is None:
            return False
        name = decode_description(message.payload)
        if message.sender in table or len(table) < _MAX_IDS:
            table[message.sender] = name
        return True


def _padded(length: int) -> int:
    return -(-length // 8) * 8
