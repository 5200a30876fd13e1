"""Commands of the host, as bytes. Case matters."""

from sensors.protocols.is900.records import station_digit

CONTINUOUS = b"C"
STOP = b"c"
POLL = b"P"
STATUS = b"S"
ASCII = b"F"
BINARY = b"f"
INCHES = b"U"
CENTIMETERS = b"u"
RESET = b"\x19"
RESUME = b"\x11"
SUSPEND = b"\x13"

ONE_BYTE = CONTINUOUS + STOP + POLL + STATUS + ASCII + BINARY + INCHES + CENTIMETERS
ONE_BYTE_CONTROL = RESET + RESUME + SUSPEND

CLOCK_MILLISECONDS = b"MT\r\n"
CLOCK_ZERO = b"MZ\r\n"
SYSTEM_STATUS = b"MS\r\n"
TRACKING_STATUS = b"MP\r\n"
ALL_STATIONS = b"l*\r\n"


def output_list(station: int, items: tuple[int, ...]) -> bytes:
    """Set the output list of a station; no items reads it back."""
    return ",".join([f"O{station_digit(station)}", *map(str, items)]).encode("ascii") + b"\r\n"


def station_on(station: int, on: bool) -> bytes:
    """Switch a station on or off."""
    return f"l{station_digit(station)},{int(on)}\r\n".encode("ascii")


def prediction(station: int, milliseconds: int) -> bytes:
    """Let the device predict the pose of a station, 0 to 50 ms ahead."""
    return f"Mp{station_digit(station)},{milliseconds}\r\n".encode("ascii")


def position_filter(station: int, level: int) -> bytes:
    """Choose the filter of a station, 0 to 2."""
    return f"MF{station_digit(station)},{level}\r\n".encode("ascii")
