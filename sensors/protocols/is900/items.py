"""The data items of an IS-900 output list and how each is written.

Inside the project every value is SI: metres, radians, seconds. An item knows the factor
from its wire unit. Source: the manual's table of output items and its section on data
records.
"""

import math
import re
import struct
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Literal

from sensors.errors import MalformedRecordError, ProtocolError

Values = tuple[float, ...]


class Item(IntEnum):
    """Item numbers of the output list."""

    SPACE = 0
    CRLF = 1
    POSITION = 2
    EULER = 4
    X_COSINES = 5
    Y_COSINES = 6
    Z_COSINES = 7
    QUATERNION = 11
    POSITION_14BIT = 18
    EULER_14BIT = 19
    QUATERNION_14BIT = 20
    TIME = 21
    BUTTONS = 22
    JOYSTICK = 23
    TRACKING_STATUS = 40


class Unit(Enum):
    """Unit of item 2; the value is metres per unit."""

    INCH = 0.0254
    CENTIMETER = 0.01


Kind = Literal["literal", "float", "14bit", "byte"]

_DEGREE = math.pi / 180.0


@dataclass(frozen=True, slots=True)
class ItemFormat:
    """How one item is written.

    Attributes:
        kind: literal bytes, float32, 14-bit pairs, or unsigned bytes.
        count: how many numbers.
        scale: SI value of one wire unit; None for item 2, which follows the unit command.
        widths: possible ASCII widths of one number, the likeliest first; empty if the
            item exists in binary only. Firmware differs for items 22 and 23.
        decimals: digits after the point in ASCII, -1 for an integer.
        literal: the bytes themselves for items 0 and 1.
    """

    kind: Kind
    count: int
    scale: float | None = 1.0
    widths: tuple[int, ...] = ()
    decimals: int = 2
    literal: bytes = b""

    @property
    def binary_length(self) -> int:
        """Bytes of this item in a binary record."""
        per_number = {"literal": 0, "float": 4, "14bit": 2, "byte": 1}[self.kind]
        return len(self.literal) + self.count * per_number


FORMATS: dict[Item, ItemFormat] = {
    Item.SPACE: ItemFormat("literal", 0, widths=(0,), literal=b" "),
    Item.CRLF: ItemFormat("literal", 0, widths=(0,), literal=b"\r\n"),
    Item.POSITION: ItemFormat("float", 3, None, (7,)),
    Item.EULER: ItemFormat("float", 3, _DEGREE, (7,)),
    Item.X_COSINES: ItemFormat("float", 3, 1.0, (7,)),
    Item.Y_COSINES: ItemFormat("float", 3, 1.0, (7,)),
    Item.Z_COSINES: ItemFormat("float", 3, 1.0, (7,)),
    Item.QUATERNION: ItemFormat("float", 4, 1.0, (7,), decimals=4),
    Item.POSITION_14BIT: ItemFormat("14bit", 3, 3.0),
    Item.EULER_14BIT: ItemFormat("14bit", 3, math.pi),
    Item.QUATERNION_14BIT: ItemFormat("14bit", 4, 1.0),
    Item.TIME: ItemFormat("float", 1, 1e-3, (14,), decimals=-1),
    Item.BUTTONS: ItemFormat("byte", 1, 1.0, (3, 4, 5), decimals=-1),
    Item.JOYSTICK: ItemFormat("byte", 2, 1.0, (3, 4), decimals=-1),
    Item.TRACKING_STATUS: ItemFormat("byte", 1, 1.0, (4,), decimals=-1),
}

TERMINATORS = (Item.SPACE, Item.CRLF)

_NUMBER = re.compile(rb" *[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)? *")


def parse_items(items: tuple[int, ...]) -> tuple[Item, ...]:
    """Turn item numbers into items.

    Raises:
        ProtocolError: if a number is unknown.
    """
    try:
        return tuple(Item(i) for i in items)
    except ValueError:
        valid = ",".join(str(int(i)) for i in Item)
        raise ProtocolError(
            f"output list {','.join(map(str, items))} has an unknown item; valid are {valid}"
        ) from None


def _wire_scale(item: Item, unit: Unit) -> float:
    scale = FORMATS[item].scale
    return unit.value if scale is None else scale


def encode_binary(item: Item, values: Values, unit: Unit) -> bytes:
    """Write SI values of one item in binary, IEEE-754 little endian."""
    form = FORMATS[item]
    if len(values) != form.count:
        raise ProtocolError(f"item {int(item)} takes {form.count} numbers, not {len(values)}")
    scale = _wire_scale(item, unit)
    if form.kind == "float":
        return struct.pack(f"<{form.count}f", *(v / scale for v in values))
    if form.kind == "byte":
        return bytes(min(255, max(0, round(v))) for v in values)
    if form.kind == "14bit":
        out = bytearray()
        for v in values:
            n = min(8191, max(-8192, round(v / scale * 8192.0)))
            out += bytes((n & 0x7F, (n >> 7) & 0x7F))
        return bytes(out)
    return form.literal


def decode_binary(item: Item, data: bytes, unit: Unit) -> Values:
    """Read one binary item of exactly `FORMATS[item].binary_length` bytes into SI values.

    Raises:
        MalformedRecordError: if a literal item is not what it must be.
    """
    form = FORMATS[item]
    scale = _wire_scale(item, unit)
    if form.kind == "float":
        return tuple(v * scale for v in struct.unpack(f"<{form.count}f", data))
    if form.kind == "byte":
        return tuple(float(b) for b in data)
    if form.kind == "14bit":
        values: list[float] = []
        for low, high in zip(data[::2], data[1::2], strict=True):
            n = (low & 0x7F) | (high & 0x7F) << 7
            values.append((n - 16384 if n >= 8192 else n) * scale / 8192.0)
        return tuple(values)
    if data != form.literal:
        raise MalformedRecordError(f"item {int(item)} is {data!r}, not {form.literal!r}")
    return ()


def encode_ascii(item: Item, values: Values, unit: Unit, width: int) -> bytes:
    """Write SI values of one item as fixed-width text; too large numbers saturate."""
    form = FORMATS[item]
    if len(values) != form.count:
        raise ProtocolError(f"item {int(item)} takes {form.count} numbers, not {len(values)}")
    scale = _wire_scale(item, unit)
    out = form.literal
    for v in values:
        wire = v / scale
        if form.decimals < 0:
            # "digits after the floating point are ignored", but 2.0 stored as
            # 1.9999999 is 2: round first to what a float32 could tell apart.
            text = f"{int(wire + 1e-6):{width}d}"
        else:
            limit = 10.0 ** (width - form.decimals - 2) - 10.0**-form.decimals
            text = f"{min(limit, max(-limit, wire)):{width}.{form.decimals}f}"
        out += text.encode("ascii")
    return out


def decode_ascii(item: Item, data: bytes, unit: Unit, width: int) -> Values:
    """Read one ASCII item, split by width: neighboring numbers may touch.

    Raises:
        MalformedRecordError: if a field is no number, or a literal item is wrong.
    """
    form = FORMATS[item]
    if form.kind == "literal":
        if data != form.literal:
            raise MalformedRecordError(f"item {int(item)} is {data!r}, not {form.literal!r}")
        return ()
    scale = _wire_scale(item, unit)
    values: list[float] = []
    for i in range(form.count):
        field = data[i * width : (i + 1) * width]
        if not _NUMBER.fullmatch(field):
            raise MalformedRecordError(f"item {int(item)} holds {field!r}, not a number")
        values.append(float(field) * scale)
    return tuple(values)
