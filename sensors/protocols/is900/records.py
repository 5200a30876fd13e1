"""Data records: what one station says at one instant, and its layout on the wire.

A record is `'0'`, the station as one hexadecimal digit, a status character, then the items
of that station's output list in list order. It carries neither length nor checksum: the
reader must know the list.
"""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sensors import rotation
from sensors.errors import MalformedRecordError, ProtocolError
from sensors.protocols.is900 import items as wire
from sensors.protocols.is900.items import FORMATS, TERMINATORS, Item, Unit, Values

Encoding = Literal["binary", "ascii"]

HEAD = ord("0")
STATIONS = range(1, 13)
DEFAULT_ITEMS: tuple[int, ...] = (2, 4, 1)
HEADER_LENGTH = 3


def station_digit(station: int) -> str:
    """The one hexadecimal digit of a station, 1..C.

    Raises:
        ProtocolError: if there is no such station.
    """
    if station not in STATIONS:
        raise ProtocolError(f"station {station} does not exist; valid are 1 to 12")
    return f"{station:X}"


def station_number(digit: int) -> int | None:
    """The station of a digit byte, None if it is no station."""
    if 0x31 <= digit <= 0x39:
        return digit - 0x30
    if 0x41 <= digit <= 0x43:
        return digit - 0x37
    return None


def is_plausible_status(status: int) -> bool:
    """A status byte is a space or, on error, a letter."""
    return status == 0x20 or 0x41 <= status <= 0x5A or 0x61 <= status <= 0x7A


@dataclass(frozen=True, slots=True)
class Record:
    """One data record, all values in SI and in the tracker's own reference frame.

    Attributes:
        station: 1..12.
        status: a space, or an error letter.
        values: numbers of each item of the list, by item; terminators have none.
    """

    station: int
    status: str
    values: Mapping[Item, Values]

    @property
    def position(self) -> NDArray[np.float64] | None:
        """Position north, east, down, shape (3,) [m], if the list has one."""
        for item in (Item.POSITION, Item.POSITION_14BIT):
            if item in self.values:
                return np.array(self.values[item])
        return None

    @property
    def quaternion(self) -> NDArray[np.float64] | None:
        """Unit quaternion w x y z, body to north-east-down, from the best item there is."""
        for item in (Item.QUATERNION, Item.QUATERNION_14BIT):
            if item in self.values:
                return rotation.normalize(np.array(self.values[item]))
        for item in (Item.EULER, Item.EULER_14BIT):
            if item in self.values:
                return rotation.from_euler(np.array(self.values[item]))
        cosines = (Item.X_COSINES, Item.Y_COSINES, Item.Z_COSINES)
        if all(item in self.values for item in cosines):
            # Each item holds the direction of one body axis, that is a column.
            R = np.array([self.values[item] for item in cosines]).T
            u, _, vt = np.linalg.svd(R)
            return rotation.from_matrix(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)
        return None

    @property
    def time(self) -> float | None:
        """Device time of the capture [s], if the list has item 21."""
        return self.values[Item.TIME][0] if Item.TIME in self.values else None

    @property
    def tracking_status(self) -> float | None:
        """Tracking quality, 0 (lost) to 1, if the list has item 40."""
        if Item.TRACKING_STATUS not in self.values:
            return None
        return self.values[Item.TRACKING_STATUS][0] / 255.0


@dataclass(frozen=True, slots=True)
class Limits:
    """What a plausible record stays within; anything else is a framing error or a fault.

    Attributes:
        position: largest coordinate [m].
        unit_norm: how far the length of a quaternion or direction may be from 1. ASCII
            cosines have two decimals, 14-bit values four digits.
        time: largest device time [s], about 30 years.
    """

    position: float = 100.0
    unit_norm: float = 0.1
    time: float = 1e9

    def check(self, values: Mapping[Item, Values]) -> None:
        """Pass quietly or say what is wrong.

        Raises:
            MalformedRecordError: if a value is not finite or absurd.
        """
        for item, numbers in values.items():
            if not all(map(math.isfinite, numbers)):
                raise MalformedRecordError(f"item {int(item)} is not finite")
            if item is Item.POSITION:
                bad = max(map(abs, numbers)) > self.position
            elif item is Item.EULER:
                bad = max(map(abs, numbers)) > 2.0 * math.pi + 1e-3
            elif item in _UNIT_ITEMS:
                bad = abs(math.hypot(*numbers) - 1.0) > self.unit_norm
            elif item is Item.TIME:
                bad = not 0.0 <= numbers[0] <= self.time
            elif FORMATS[item].kind == "byte":
                bad = not all(0.0 <= n <= 255.0 for n in numbers)
            else:
                bad = False
            if bad:
                raise MalformedRecordError(f"item {int(item)} is absurd: {numbers}")


_UNIT_ITEMS = (
    Item.X_COSINES,
    Item.Y_COSINES,
    Item.Z_COSINES,
    Item.QUATERNION,
    Item.QUATERNION_14BIT,
)

DEFAULT_LIMITS = Limits()


@dataclass(frozen=True, slots=True)
class RecordLayout:
    """The layout of one station's records.

    Attributes:
        items: the output list.
        encoding: binary or ASCII records.
        unit: unit of item 2.
        widths: ASCII width of one number of each item; by default the likeliest.
        length: bytes of the whole record.
    """

    items: tuple[Item, ...]
    encoding: Encoding = "binary"
    unit: Unit = Unit.CENTIMETER
    widths: tuple[int, ...] = ()
    length: int = field(init=False)

    def __post_init__(self) -> None:
        if len(set(self.items) - set(TERMINATORS)) != len(
            [i for i in self.items if i not in TERMINATORS]
        ):
            raise ProtocolError(
                f"output list {','.join(str(int(i)) for i in self.items)} names an item twice; "
                "each item may stand once"
            )
        forms = [FORMATS[i] for i in self.items]
        if self.encoding == "ascii":
            missing = [str(int(i)) for i in self.items if not FORMATS[i].widths]
            if missing:
                raise ProtocolError(
                    f"item {', '.join(missing)} exists in binary only; send 'f' first"
                )
            if not self.widths:
                object.__setattr__(self, "widths", tuple(f.widths[0] for f in forms))
            sizes = [len(f.literal) + f.count * w for f, w in zip(forms, self.widths, strict=True)]
        else:
            sizes = [f.binary_length for f in forms]
        object.__setattr__(self, "length", HEADER_LENGTH + sum(sizes))

    @property
    def ends_in_crlf(self) -> bool:
        """Whether the record closes with the strong terminator CR LF."""
        return bool(self.items) and self.items[-1] is Item.CRLF

    def encode(self, record: Record) -> bytes:
        """Write a record; items it lacks are a `ProtocolError`."""
        out = bytearray((HEAD, ord(station_digit(record.station)), ord(record.status)))
        for i, item in enumerate(self.items):
            values = record.values.get(item, ())
            if self.encoding == "ascii":
                out += wire.encode_ascii(item, values, self.unit, self.widths[i])
                continue
            part = wire.encode_binary(item, values, self.unit)
            if i == 0 and FORMATS[item].kind == "14bit":
                # The mark by which a reader of 14-bit lists finds the start of the data.
                part = bytes((part[0] | 0x80,)) + part[1:]
            out += part
        return bytes(out)

    def decode(self, data: bytes, limits: Limits = DEFAULT_LIMITS) -> Record:
        """Read exactly `length` bytes.

        Raises:
            MalformedRecordError: if head, station, status, terminators or values are not
                what they can be.
        """
        station = station_number(data[1]) if len(data) == self.length else None
        if station is None or data[0] != HEAD or not is_plausible_status(data[2]):
            raise MalformedRecordError(f"no record head in {data[:3]!r}")
        values: dict[Item, Values] = {}
        at = HEADER_LENGTH
        for i, item in enumerate(self.items):
            form = FORMATS[item]
            if self.encoding == "ascii":
                size = len(form.literal) + form.count * self.widths[i]
                numbers = wire.decode_ascii(item, data[at : at + size], self.unit, self.widths[i])
            else:
                size = form.binary_length
                part = data[at : at + size]
                if form.kind == "14bit" and (
                    any(b & 0x80 for b in part[1:]) or (i == 0) != bool(part[0] & 0x80)
                ):
                    raise MalformedRecordError("14-bit data is out of step")
                numbers = wire.decode_binary(item, part, self.unit)
            if form.kind != "literal":
                values[item] = numbers
            at += size
        limits.check(values)
        return Record(station, chr(data[2]), values)


def layout_variants(
    items: tuple[int, ...], encoding: Encoding = "binary", unit: Unit = Unit.CENTIMETER
) -> tuple[RecordLayout, ...]:
    """Every layout a device may use for an output list, the likeliest first.

    Binary has one. In ASCII the widths of items 22 and 23 depend on the firmware, so a
    reader tries each and keeps what fits.

    Raises:
        ProtocolError: for unknown or repeated items, or items ASCII does not have.
    """
    known = wire.parse_items(items)
    if encoding == "binary":
        return (RecordLayout(known, encoding, unit),)
    first = RecordLayout(known, encoding, unit)
    widths = [FORMATS[i].widths for i in known]
    rest = [RecordLayout(known, encoding, unit, w) for w in itertools.product(*widths)]
    return (first, *(layout for layout in rest if layout != first))
