"""InterSense IS-900 over a serial line: bytes to records and back.

`items` are the numbers of an output list, `records` the layout of data records, `responses`
everything else the device says, `commands` what the host says, `parser` the stream,
`axes` the way from the device's frame to the world.
"""

from sensors.protocols.is900.axes import flip_position, flip_quaternion
from sensors.protocols.is900.items import Item, Unit
from sensors.protocols.is900.parser import Parser
from sensors.protocols.is900.records import Limits, Record, RecordLayout, layout_variants
from sensors.protocols.is900.responses import (
    Response,
    Status,
    parse_output_list,
    parse_station_flags,
    parse_status,
)

__all__ = [
    "Item",
    "Limits",
    "Parser",
    "Record",
    "RecordLayout",
    "Response",
    "Status",
    "Unit",
    "flip_position",
    "flip_quaternion",
    "layout_variants",
    "parse_output_list",
    "parse_station_flags",
    "parse_status",
]
