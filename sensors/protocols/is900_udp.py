"""InterSense's native UDP packet: one station's report in 44 bytes, little endian.

0xFF, type 1, sequence, checksum (sum of bytes 4 to 43), model (4: IS-900), station,
status 0..255, buttons, 8 bytes of analog inputs, then as float32 yaw, pitch, roll [deg],
x, y, z [m] and the time [s].
"""

import math
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sensors import rotation
from sensors.errors import MalformedRecordError

LENGTH = 44
START = 0xFF
POSE_TYPE = 1
IS900 = 4
DEFAULT_PORT = 5001

_LAYOUT = struct.Struct("<8B8s7f")
_MAX_COORDINATE = 100.0
_MAX_TIME = 1e9


@dataclass(frozen=True, slots=True)
class Packet:
    """One report; frames are the device's, north-east-down.

    Attributes:
        sequence: 0..255, one more with every packet of a station.
        station: its number.
        status: tracking quality, 0 (lost) to 255.
        euler: yaw, pitch, roll, shape (3,) [rad].
        position: shape (3,) [m].
        time: device time of the capture [s].
        buttons: one bit a button.
        model: 4 for an IS-900.
    """

    sequence: int
    station: int
    status: int
    euler: NDArray[np.float64]
    position: NDArray[np.float64]
    time: float
    buttons: int = 0
    model: int = IS900

    @property
    def quaternion(self) -> NDArray[np.float64]:
        """Unit quaternion w x y z, body to north-east-down, shape (4,)."""
        return rotation.from_euler(self.euler)

    def encode(self) -> bytes:
        """The 44 bytes."""
        data = bytearray(
            _LAYOUT.pack(
                START,
                POSE_TYPE,
                self.sequence,
                0,
                self.model,
                self.station,
                self.status,
                self.buttons,
                bytes((127, 127, 0, 0, 0, 0, 0, 0)),
                *np.degrees(self.euler),
                *self.position,
                self.time,
            )
        )
        data[3] = sum(data[4:]) % 256
        return bytes(data)


def decode(data: bytes) -> Packet:
    """Read one datagram.

    Raises:
        MalformedRecordError: if it is no packet, is damaged, or says what cannot be.
    """
    if len(data) != LENGTH or data[0] != START or data[1] != POSE_TYPE:
        raise MalformedRecordError(f"{data[:4]!r} begins no packet of {LENGTH} bytes")
    if sum(data[4:]) % 256 != data[3]:
        raise MalformedRecordError("the checksum is wrong")
    _, _, sequence, _, model, station, status, buttons, _, *floats = _LAYOUT.unpack(data)
    if not all(map(math.isfinite, floats)):
        raise MalformedRecordError("a value is not finite")
    angles, position, time = floats[:3], floats[3:6], floats[6]
    if max(map(abs, angles)) > 360.5 or max(map(abs, position)) > _MAX_COORDINATE:
        raise MalformedRecordError("the pose is absurd")
    if not 0.0 <= time <= _MAX_TIME:
        raise MalformedRecordError("the time is absurd")
    return Packet(
        sequence,
        station,
        status,
        np.radians(np.array(angles, dtype=np.float64)),
        np.array(position, dtype=np.float64),
        time,
        buttons,
        model,
    )
