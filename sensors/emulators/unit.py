"""The inside of an IS-900: settings, commands, answers and records, without any line.

What it does not know it answers with an error line and goes on, as the real one does.
Alignment, boresight, tip offset and prediction act on the records, so a host that uses them
can be rehearsed too.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sensors import rotation
from sensors.emulators.source import PoseSource, StationPose
from sensors.errors import ProtocolError
from sensors.protocols.is900 import commands
from sensors.protocols.is900.axes import flip_position, flip_quaternion
from sensors.protocols.is900.items import Item, Unit, Values, parse_items
from sensors.protocols.is900.records import (
    DEFAULT_ITEMS,
    Record,
    RecordLayout,
    station_digit,
    station_number,
)
from sensors.protocols.is900.responses import (
    Response,
    Status,
    output_list_response,
    station_flags_response,
)

Array = NDArray[np.float64]

MAX_LINE = 128
VERSION = "4.1300"
IDENTIFICATION = "IS-900 emulated by localreg"


@dataclass(slots=True)
class _Station:
    """Settings of one station; frames are the device's, north-east-down."""

    on: bool = True
    items: tuple[int, ...] = DEFAULT_ITEMS
    prediction: float = 0.0
    filter_level: int = 0
    hemisphere: str = "0,0,-1"
    tip: Array = field(default_factory=lambda: np.zeros(3))
    origin: Array = field(default_factory=lambda: np.zeros(3))
    q_reference: Array = field(default_factory=lambda: rotation.IDENTITY.copy())
    q_boresight: Array = field(default_factory=lambda: rotation.IDENTITY.copy())

    @property
    def is_plain(self) -> bool:
        """Whether poses go out as they are; the usual case, and the quick one."""
        return not (
            self.tip.any()
            or self.origin.any()
            or self.q_reference[1:].any()
            or self.q_boresight[1:].any()
        )


class Is900Unit:
    """An IS-900 without its line: `receive` takes what the host sends.

    Args:
        stations: how many stations exist, 1..12; further ones are off and send nothing.
    """

    def __init__(self, stations: int = 6) -> None:
        self.station_count = stations
        self.errors = 0
        self._line = bytearray()
        self._clock_offset = 0.0
        self.power_on()

    def power_on(self) -> None:
        """Back to default settings, as after reset."""
        self.binary = False
        self.metric = False
        self.continuous = False
        self.suspended = False
        self.polls = 0
        self.stations = {n: _Station() for n in range(1, self.station_count + 1)}
        self._line.clear()

    @property
    def streaming(self) -> bool:
        """Whether records go out without being asked for."""
        return self.continuous and not self.suspended

    def receive(self, data: bytes, now: float, pose_at: PoseSource, motion_time: float) -> bytes:
        """Take bytes from the host.

        Args:
            data: any portion of the command stream.
            now: time of the device's own clock, for `MZ` [s].
            pose_at: true poses, for boresight.
            motion_time: where in the motion we are [s].

        Returns:
            Answers. Records asked for by `P` are counted in `polls` instead.
        """
        out = bytearray()
        for byte in data:
            char = bytes((byte,))
            if byte in commands.ONE_BYTE_CONTROL:
                self._line.clear()
                self._control(char, now)
            elif char in b"\r\n":
                # CR LF, CR alone or LF alone: the second of a pair finds an empty line.
                if self._line:
                    out += self._execute(self._line.decode("ascii"), now, pose_at, motion_time)
                self._line.clear()
            elif not self._line and byte in commands.ONE_BYTE:
                out += self._one_byte(char)
            elif 0x20 <= byte < 0x7F and (self._line or byte != 0x20):
                self._line += char
                if len(self._line) > MAX_LINE:
                    self._line.clear()
                    self.errors += 1
            else:
                self._line.clear()
                self.errors += 1
        return bytes(out)

    def records(
        self, pose_at: PoseSource, motion_time: float, device_time: float
    ) -> list[tuple[int, Record]]:
        """One record of each active station that has a pose.

        Args:
            pose_at: world poses.
            motion_time: instant of the motion [s].
            device_time: instant on the device's clock [s].

        Returns:
            Station and record, in the order of the stations.
        """
        out: list[tuple[int, Record]] = []
        poses: dict[float, list[StationPose | None]] = {}
        for n, station in self.stations.items():
            ahead = station.prediction
            if ahead not in poses:
                poses[ahead] = list(pose_at(motion_time + ahead))
            pose = poses[ahead][n - 1] if n <= len(poses[ahead]) else None
            if station.on and pose is not None:
                out.append((n, self._record(n, pose, device_time - self._clock_offset)))
        return out

    def encode(self, record: Record) -> bytes:
        """The record in the station's present list, encoding and unit."""
        return self._layout(self.stations[record.station].items).encode(record)

    def _layout(self, items: tuple[int, ...]) -> RecordLayout:
        unit = Unit.CENTIMETER if self.metric else Unit.INCH
        known = parse_items(items)
        if not self.binary:
            # 14-bit items exist in binary only; in ASCII mode the unit leaves them out.
            known = tuple(i for i in known if i not in _BINARY_ONLY)
        return RecordLayout(known, "binary" if self.binary else "ascii", unit)

    def _record(self, n: int, pose: StationPose, device_time: float) -> Record:
        station = self.stations[n]
        p, q = self._in_reference(station, pose)
        values: dict[Item, Values] = {}
        for item in parse_items(station.items):
            if item in (Item.POSITION, Item.POSITION_14BIT):
                values[item] = tuple(map(float, p))
            elif item in (Item.QUATERNION, Item.QUATERNION_14BIT):
                values[item] = tuple(map(float, q))
            elif item in (Item.EULER, Item.EULER_14BIT):
                values[item] = tuple(map(float, rotation.to_euler(q)))
            elif item in _COSINES:
                column = rotation.to_matrix(q)[:, _COSINES.index(item)]
                values[item] = tuple(map(float, column))
            elif item is Item.TIME:
                # A device zeroed after the instant of this record would say a negative time.
                values[item] = (max(0.0, device_time),)
            elif item in _RESTING:
                values[item] = _RESTING[item]
        return Record(n, " ", values)

    def _in_reference(self, station: _Station, pose: StationPose) -> StationPose:
        # Reference = inverse alignment, body = inverse boresight.
        p, q = flip_position(pose[0]), flip_quaternion(pose[1])
        if station.is_plain:
            return p, q
        back = rotation.conjugate(station.q_reference)
        p = rotation.rotate(back, p + rotation.rotate(q, station.tip) - station.origin)
        q = rotation.multiply(back, q)
        return p, rotation.multiply(q, rotation.conjugate(station.q_boresight))

    def _control(self, char: bytes, now: float) -> None:
        if char == commands.RESET:
            self.power_on()
            self._clock_offset = now
        else:
            self.suspended = char == commands.SUSPEND

    def _one_byte(self, char: bytes) -> bytes:
        if char == commands.STATUS:
            return Status(
                binary=self.binary,
                metric=self.metric,
                continuous=self.continuous,
                version=VERSION,
                identification=IDENTIFICATION,
            ).encode()
        if char == commands.POLL:
            # Bounded: a host that asks faster than the line can answer gets the newest.
            self.polls = min(self.polls + 1, 4)
        elif char in (commands.CONTINUOUS, commands.STOP):
            self.continuous = char == commands.CONTINUOUS
        elif char in (commands.ASCII, commands.BINARY):
            self.binary = char == commands.BINARY
        else:
            self.metric = char == commands.CENTIMETERS
        return b""

    def _execute(self, line: str, now: float, pose_at: PoseSource, t: float) -> bytes:
        try:
            if line.startswith("M"):
                return self._manufacturer(line, now)
            return self._line_command(line, pose_at, t)
        except (ValueError, KeyError, ProtocolError):
            self.errors += 1
            return Response("2", 1, "E", f"*ERROR* {line[:40]}").encode()

    def _line_command(self, line: str, pose_at: PoseSource, t: float) -> bytes:
        letter = line[0]
        if letter in "xv":
            return b""  # Filter settings of the older protocol; accepted, without effect.
        if line == "l*":
            flags = (n in self.stations and self.stations[n].on for n in range(1, 33))
            return station_flags_response(tuple(flags)).encode()
        n, arguments = _split(line[1:])
        if letter == "l" and arguments and n not in self.stations:
            return b""  # A station that is not plugged in can be switched to no effect.
        station = self.stations[n]
        if letter == "O":
            if not arguments:
                return output_list_response(n, station.items).encode()
            items = tuple(int(a) for a in arguments)
            self._layout(items)
            station.items = items
        elif letter == "l":
            if not arguments:
                first = [m in self.stations and self.stations[m].on for m in (n, 2, 3, 4)]
                return station_flags_response(tuple(first), n).encode()
            station.on = int(arguments[0]) != 0
        elif letter == "N":
            if not arguments:
                return _numbers(n, "N", station.tip * 100.0)
            station.tip = 0.01 * _vector(arguments, 3)
        elif letter == "A":
            if not arguments:
                x, y, _ = rotation.to_matrix(station.q_reference).T
                o = station.origin
                return _numbers(n, "A", np.concatenate([o, o + x, o + y]) / self._unit())
            v = _vector(arguments, 9).reshape(3, 3) * self._unit()
            station.origin, station.q_reference = v[0], _alignment(v)
        elif letter == "R":
            station.origin, station.q_reference = np.zeros(3), rotation.IDENTITY.copy()
        elif letter == "B":
            pose = pose_at(t)[n - 1]
            station.q_boresight = rotation.IDENTITY.copy()
            if pose is not None:
                station.q_boresight = self._in_reference(station, pose)[1]
        elif letter == "b":
            station.q_boresight = rotation.IDENTITY.copy()
        elif letter == "H":
            if not arguments:
                return Response("2", n, "H", station.hemisphere).encode()
            station.hemisphere = ",".join(arguments)
        else:
            raise ValueError(line)
        return b""

    def _manufacturer(self, line: str, now: float) -> bytes:
        name, rest = line[:2], line[2:]
        if name == "MZ":
            self._clock_offset = now
        elif name == "MT" or name == "MG":
            pass  # Milliseconds are all there is; MG asks for an option nobody has fitted.
        elif name == "MS":
            return Response("3", 1, "S", "000").encode()
        elif name == "MP":
            quality = "".join("F" if s.on else "0" for s in self.stations.values())
            return Response("3", 1, "P", quality).encode()
        elif name in ("Mp", "MF"):
            n, arguments = _split(rest)
            station = self.stations[n]
            if name == "Mp":
                if not arguments:
                    return Response("3", n, "p", f"{station.prediction * 1e3:.0f}").encode()
                station.prediction = 1e-3 * min(50.0, max(0.0, float(arguments[0])))
            else:
                if not arguments:
                    return Response("3", n, "F", str(station.filter_level)).encode()
                station.filter_level = min(2, max(0, int(arguments[0])))
        else:
            raise ValueError(line)
        return b""

    def _unit(self) -> float:
        return (Unit.CENTIMETER if self.metric else Unit.INCH).value


_COSINES = (Item.X_COSINES, Item.Y_COSINES, Item.Z_COSINES)
_RESTING: dict[Item, Values] = {
    Item.BUTTONS: (0.0,),
    Item.JOYSTICK: (127.0, 127.0),
    Item.TRACKING_STATUS: (255.0,),
}
_BINARY_ONLY = (Item.POSITION_14BIT, Item.EULER_14BIT, Item.QUATERNION_14BIT)


def _split(text: str) -> tuple[int, list[str]]:
    station = station_number(ord(text[0])) if text else 1
    if station is None or text[1:2] not in ("", ","):
        raise ValueError(text)
    return station, text[2:].split(",") if text[2:] else []


def _vector(arguments: list[str], size: int) -> Array:
    v = np.array([float(a) for a in arguments])
    if v.shape != (size,) or not np.isfinite(v).all():
        raise ValueError(arguments)
    return v


def _numbers(station: int, kind: str, values: Array) -> bytes:
    station_digit(station)
    return Response("2", station, kind, "".join(f"{v:7.2f}" for v in values)).encode()


def _alignment(v: Array) -> Array:
    """Rotation of the frame with this origin, a point on +x and one in the xy half plane."""
    x, y = v[1] - v[0], v[2] - v[0]
    z = np.asarray(np.cross(x, y), dtype=np.float64)
    if float(np.linalg.norm(z)) <= 1e-9:
        raise ValueError("the three alignment points lie on a line")
    x, z = rotation.normalize(x), rotation.normalize(z)
    y = np.asarray(np.cross(z, x), dtype=np.float64)
    return rotation.from_matrix(np.stack([x, y, z], axis=1))
