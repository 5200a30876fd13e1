"""The stream parser: bytes in any portions in, records and answers out.

There is no checksum and no length on the wire, and a binary float may hold any byte, CR and
LF included. So the parser never searches for line ends in data: it knows each station's
output list, hence the length of its records, and checks head, station, status, terminator
and the plausibility of every value. What fails is not trusted to have that length: the hunt
goes on one byte further, so a truncated record costs itself and not its successor.
"""

from collections.abc import Iterable, Mapping

from sensors.errors import MalformedRecordError
from sensors.protocols.counters import ParserCounters
from sensors.protocols.is900.items import Unit
from sensors.protocols.is900.records import (
    DEFAULT_LIMITS,
    HEAD,
    HEADER_LENGTH,
    Encoding,
    Limits,
    Record,
    RecordLayout,
    is_plausible_status,
    layout_variants,
    station_number,
)
from sensors.protocols.is900.responses import (
    MAX_RESPONSE_LENGTH,
    RESPONSE_TYPES,
    Response,
    parse_response,
)

_HEADS = b"0" + RESPONSE_TYPES


class _Incomplete(Exception):  # noqa: N818 - control flow, not an error
    """More bytes are needed to decide."""


class Parser:
    """Frames and decodes the stream of one device.

    The buffer never holds more than one incomplete record between calls.

    Args:
        output_lists: output list of each station that may send.
        encoding: binary or ASCII.
        unit: unit of positions on the wire.
        limits: what a plausible record stays within.

    Raises:
        ProtocolError: for an output list the encoding cannot express.
    """

    def __init__(
        self,
        output_lists: Mapping[int, Iterable[int]],
        encoding: Encoding = "binary",
        unit: Unit = Unit.CENTIMETER,
        limits: Limits = DEFAULT_LIMITS,
    ) -> None:
        self.counters = ParserCounters()
        self._limits = limits
        self._buffer = bytearray()
        self._layouts: dict[int, tuple[RecordLayout, ...]] = {
            station: layout_variants(tuple(items), encoding, unit)
            for station, items in output_lists.items()
        }

    @property
    def pending(self) -> int:
        """Bytes held back because their record is not complete."""
        return len(self._buffer)

    def reset(self) -> None:
        """Drop what is held back; it counts as skipped."""
        self.counters.skipped_bytes += len(self._buffer)
        self._buffer.clear()

    def feed(self, data: bytes) -> list[Record | Response]:
        """Take the next bytes of the stream.

        Args:
            data: any number of bytes, split anywhere.

        Returns:
            What became complete with them, in order.
        """
        buffer = self._buffer
        buffer += data
        found: list[Record | Response] = []
        at = 0
        try:
            while at < len(buffer):
                message, length = self._match(buffer, at)
                if message is None:
                    self.counters.skipped_bytes += 1
                    at += 1
                else:
                    found.append(message)
                    at += length
        except _Incomplete:
            pass
        del buffer[:at]
        return found

    def _match(self, buffer: bytearray, at: int) -> tuple[Record | Response | None, int]:
        head = buffer[at]
        if head == HEAD:
            return self._match_record(buffer, at)
        if head in RESPONSE_TYPES:
            return self._match_response(buffer, at)
        return None, 0

    def _match_record(self, buffer: bytearray, at: int) -> tuple[Record | None, int]:
        available = len(buffer) - at
        if available < HEADER_LENGTH:
            # Decide on the bytes there are: a wrong second byte needs no third.
            if available == 2 and station_number(buffer[at + 1]) not in self._layouts:
                return None, 0
            raise _Incomplete
        station = station_number(buffer[at + 1])
        if station not in self._layouts or not is_plausible_status(buffer[at + 2]):
            return None, 0
        variants = self._layouts[station]
        for layout in variants:
            if available < layout.length:
                raise _Incomplete
            end = at + layout.length
            # Without CR LF the next head is the only witness that the length was right.
            # It is asked when it is there, never waited for: that would cost a period.
            if not layout.ends_in_crlf and end < len(buffer) and buffer[end] not in _HEADS:
                continue
            try:
                record = layout.decode(bytes(buffer[at:end]), self._limits)
            except MalformedRecordError:
                continue
            if layout is not variants[0]:
                self._layouts[station] = (layout, *(v for v in variants if v is not layout))
            self.counters.records += 1
            return record, layout.length
        self.counters.bad_records += 1
        by_station = self.counters.bad_by_station
        by_station[station] = by_station.get(station, 0) + 1
        return None, 0

    def _match_response(self, buffer: bytearray, at: int) -> tuple[Response | None, int]:
        window = bytes(buffer[at : at + MAX_RESPONSE_LENGTH])
        line_end = window.find(b"\r\n")
        body = window if line_end < 0 else window[: line_end + 2]
        # Binary data cannot pass for text for long: stop waiting at the first byte that
        # no answer holds, so that a stray '2' never delays the records behind it.
        text = body[2:] if line_end < 0 else body[2:-2]
        if len(body) > 1 and station_number(body[1]) is None:
            return None, 0
        if any(not 0x20 <= b < 0x7F and (line_end >= 0 or b != 0x0D) for b in text):
            return None, 0
        if line_end < 0:
            if len(window) == MAX_RESPONSE_LENGTH:
                return None, 0
            raise _Incomplete
        try:
            response = parse_response(body)
        except MalformedRecordError:
            return None, 0
        self.counters.responses += 1
        return response, len(body)
