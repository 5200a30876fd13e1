"""Answers of the device that are not data: type `'2'` and manufacturer type `'3'` records.

Each is a line: type, station digit, sub-type letter, text, CR LF.
"""

import re
from dataclasses import dataclass

from sensors.errors import MalformedRecordError
from sensors.protocols.is900.records import station_digit, station_number

STATUS_LENGTH = 55
MAX_RESPONSE_LENGTH = 128
RESPONSE_TYPES = b"23"

_FLAG_BINARY, _FLAG_METRIC, _FLAG_COMPENSATION, _FLAG_CONTINUOUS = 1, 2, 4, 8


@dataclass(frozen=True, slots=True)
class Response:
    """One answer line.

    Attributes:
        record_type: `"2"` or `"3"`.
        station: the station it speaks of; 1 where it speaks of the system.
        kind: sub-type letter, for example `"S"` for status.
        payload: the text between the letter and CR LF.
    """

    record_type: str
    station: int
    kind: str
    payload: str

    def encode(self) -> bytes:
        """The line as sent, CR LF included."""
        line = f"{self.record_type}{station_digit(self.station)}{self.kind}{self.payload}\r\n"
        return line.encode("ascii")


@dataclass(frozen=True, slots=True)
class Status:
    """The answer to `S`.

    Attributes:
        station: station the record was sent for.
        binary: records are binary, not ASCII.
        metric: positions are in centimeters, not inches.
        compensation: compensation is on.
        continuous: records stream without being asked for.
        error: three characters, blank or zero when all is well.
        version: firmware version.
        identification: free text of 32 characters.
    """

    station: int = 1
    binary: bool = False
    metric: bool = False
    compensation: bool = False
    continuous: bool = False
    error: str = "  0"
    version: str = ""
    identification: str = ""

    def encode(self) -> bytes:
        """The 55 bytes of the record, CR LF included."""
        flags = (
            self.binary * _FLAG_BINARY
            + self.metric * _FLAG_METRIC
            + self.compensation * _FLAG_COMPENSATION
            + self.continuous * _FLAG_CONTINUOUS
        )
        line = (
            f"2{station_digit(self.station)}S{flags:03X}{self.error[:3]:3}{'':6}"
            f"{self.version[:6]:6}{self.identification[:32]:32}\r\n"
        )
        return line.encode("ascii")


def parse_response(line: bytes) -> Response:
    """Read one line, CR LF included.

    Raises:
        MalformedRecordError: if it is not an answer.
    """
    if len(line) < 5 or line[:1] not in (b"2", b"3") or not line.endswith(b"\r\n"):
        raise MalformedRecordError(f"{line[:16]!r} is no response record")
    station = station_number(line[1])
    body = line[2:-2]
    if station is None or not all(0x20 <= b < 0x7F for b in body) or body[:1] in b"0123456789 ":
        raise MalformedRecordError(f"{line[:16]!r} is no response record")
    text = body.decode("ascii")
    return Response(chr(line[0]), station, text[0], text[1:])


def parse_status(response: Response) -> Status:
    """Read the answer to `S`; some firmware sends one character less.

    Raises:
        MalformedRecordError: if it is another answer, or its flags are not hexadecimal.
    """
    p = response.payload
    if response.record_type != "2" or response.kind != "S" or len(p) < 18:
        raise MalformedRecordError("the answer is not a status record")
    try:
        flags = int(p[:3].replace(" ", "0"), 16)
    except ValueError:
        raise MalformedRecordError(f"status flags {p[:3]!r} are not hexadecimal") from None
    return Status(
        station=response.station,
        binary=bool(flags & _FLAG_BINARY),
        metric=bool(flags & _FLAG_METRIC),
        compensation=bool(flags & _FLAG_COMPENSATION),
        continuous=bool(flags & _FLAG_CONTINUOUS),
        error=p[3:6],
        version=p[12:18].strip(),
        identification=p[18:].strip(),
    )


def output_list_response(station: int, items: tuple[int, ...]) -> Response:
    """The answer to `O<n>`: two characters an item, for example `21O 2 4 1`."""
    return Response("2", station, "O", "".join(f"{i:2d}" for i in items))


def parse_output_list(response: Response) -> tuple[int, ...]:
    """The item numbers of an answer to `O<n>`.

    Raises:
        MalformedRecordError: if it is another answer.
    """
    fields = re.findall(r"..", response.payload)
    if response.kind != "O" or not all(re.fullmatch(r" ?\d+", f) for f in fields):
        raise MalformedRecordError("the answer is not an output list")
    return tuple(int(f) for f in fields)


def station_flags_response(flags: tuple[bool, ...], station: int = 1) -> Response:
    """The answer to `l<n>` (four flags) or `l*` (32 flags)."""
    return Response("2", station, "l", "".join("1" if f else "0" for f in flags))


def parse_station_flags(response: Response) -> tuple[bool, ...]:
    """The flags of an answer to `l<n>` or `l*`.

    Raises:
        MalformedRecordError: if it is another answer.
    """
    if response.kind != "l" or not re.fullmatch(r"[01]+", response.payload):
        raise MalformedRecordError("the answer is not a list of station flags")
    return tuple(c == "1" for c in response.payload)
