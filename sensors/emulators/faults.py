"""What can go wrong between a tracker and its host, on request.

Faults live on the time of the motion: `start` and `duration` are seconds since its zero.
Everything random comes from one seeded generator, so a run can be repeated.
"""

import dataclasses
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sensors import rotation
from sensors.emulators.source import StationPose
from sensors.errors import ConfigurationError


@dataclass(frozen=True, slots=True)
class Fault:
    """Something wrong from `start` for `duration` [s]."""

    name: ClassVar[str] = ""

    start: float = 0.0
    duration: float = math.inf

    def active(self, t: float) -> bool:
        """Whether the fault is on at motion time t [s]."""
        return self.start <= t < self.start + self.duration


@dataclass(frozen=True, slots=True)
class Junk(Fault):
    """Random bytes before records.

    Attributes:
        probability: chance before each record.
        length: most bytes at a time.
    """

    name: ClassVar[str] = "junk"

    probability: float = 0.1
    length: int = 16


@dataclass(frozen=True, slots=True)
class Truncation(Fault):
    """Records that lose bytes from a random place on.

    Attributes:
        probability: chance of each record.
    """

    name: ClassVar[str] = "truncation"

    probability: float = 0.1


@dataclass(frozen=True, slots=True)
class Silence(Fault):
    """Nothing is sent, not even answers, and nothing is caught up afterward."""

    name: ClassVar[str] = "silence"


@dataclass(frozen=True, slots=True)
class PowerCycle(Fault):
    """The unit starts anew once, at `start`: default settings, not streaming, clock at zero."""

    name: ClassVar[str] = "power-cycle"

    duration: float = 0.0


@dataclass(frozen=True, slots=True)
class Jump(Fault):
    """One station reports a pose that is off.

    Attributes:
        station: 1..12.
        dx: offset along world x [m].
        dy: offset along world y [m].
        dz: offset along world z [m].
        turn: rotation about world z [deg].
    """

    name: ClassVar[str] = "jump"

    station: int = 1
    dx: float = 0.0
    dy: float = 0.0
    dz: float = 0.0
    turn: float = 0.0


@dataclass(frozen=True, slots=True)
class Dropout(Fault):
    """One station sends no records.

    Attributes:
        station: 1..12.
    """

    name: ClassVar[str] = "dropout"

    station: int = 1


@dataclass(frozen=True, slots=True)
class Swap(Fault):
    """Two stations report each other's poses, as when two cables are mixed up.

    Attributes:
        station: 1..12.
        other: 1..12.
    """

    name: ClassVar[str] = "swap"

    station: int = 1
    other: int = 2


@dataclass(frozen=True, slots=True)
class Stall(Fault):
    """Everything is held back, and comes at once afterward: a busy network or host."""

    name: ClassVar[str] = "stall"

    duration: float = 0.5


@dataclass(frozen=True, slots=True)
class Corruption(Fault):
    """Records in which single bits are turned over.

    Attributes:
        probability: chance of each record.
    """

    name: ClassVar[str] = "corruption"

    probability: float = 0.1


KINDS: dict[str, type[Fault]] = {
    kind.name: kind
    for kind in (
        Junk,
        Truncation,
        Corruption,
        Silence,
        Stall,
        PowerCycle,
        Jump,
        Dropout,
        Swap,
    )
}


def parse_fault(text: str) -> Fault:
    """Read a fault as written on the command line.

    Args:
        text: kind, then settings, for example `"jump,station=3,start=2,duration=1,dx=0.5"`.

    Raises:
        ConfigurationError: naming what is valid.
    """
    kind_name, *settings = (part.strip() for part in text.split(","))
    kind = KINDS.get(kind_name)
    if kind is None:
        raise ConfigurationError(f"no fault is called {kind_name!r}; there are {', '.join(KINDS)}")
    fields = {f.name: f.type for f in dataclasses.fields(kind)}
    values: dict[str, float | int] = {}
    for setting in settings:
        key, _, value = setting.partition("=")
        try:
            values[key] = int(value) if fields[key] is int else float(value)
        except (KeyError, ValueError):
            raise ConfigurationError(
                f"{setting!r} is no setting of the fault {kind_name}; give {', '.join(fields)} "
                "as name=number"
            ) from None
    return kind(**values)


@dataclass(frozen=True, slots=True)
class Noise:
    """Independent Gaussian noise on every report.

    Attributes:
        position: standard deviation of each coordinate [m].
        orientation: standard deviation of the rotation about each axis [deg].
    """

    position: float = 0.0
    orientation: float = 0.0


class FaultMaker:
    """Applies faults and noise.

    Args:
        faults: what goes wrong and when; `inject` adds more while running.
        noise: what is always added.
        seed: of everything random.
    """

    def __init__(self, faults: Iterable[Fault] = (), noise: Noise | None = None, seed: int = 0):
        self._faults: tuple[Fault, ...] = tuple(faults)
        self._noise = noise or Noise()
        self._rng = np.random.default_rng(seed)
        self._cycled: set[int] = set()

    def inject(self, fault: Fault) -> None:
        """Add a fault; safe from any thread."""
        self._faults = (*self._faults, fault)

    def is_silent(self, t: float) -> bool:
        """Whether nothing may leave the device."""
        return any(isinstance(f, Silence) and f.active(t) for f in self._faults)

    def is_stalled(self, t: float) -> bool:
        """Whether what is sent must wait."""
        return any(isinstance(f, Stall) and f.active(t) for f in self._faults)

    def takes_power_cycle(self, t: float) -> bool:
        """Whether a power cycle is due; true once for each."""
        due = [
            i
            for i, f in enumerate(self._faults)
            if isinstance(f, PowerCycle) and f.start <= t and i not in self._cycled
        ]
        self._cycled.update(due)
        return bool(due)

    def bend_all(self, poses: Sequence[StationPose | None], t: float) -> list[StationPose | None]:
        """What the stations 1, 2, ... report instead of their true poses."""
        order = list(range(len(poses)))
        for f in self._faults:
            if isinstance(f, Swap) and f.active(t) and max(f.station, f.other) <= len(order):
                a, b = f.station - 1, f.other - 1
                order[a], order[b] = order[b], order[a]
        return [self.bend(n, poses[j], t) for n, j in enumerate(order, start=1)]

    def bend(self, station: int, pose: StationPose | None, t: float) -> StationPose | None:
        """What the station reports instead of its true pose; None for no report."""
        faults = [f for f in self._faults if f.active(t)]
        if pose is None or any(isinstance(f, Dropout) and f.station == station for f in faults):
            return None
        position, quaternion = pose
        for f in faults:
            if isinstance(f, Jump) and f.station == station:
                position = position + np.array([f.dx, f.dy, f.dz])
                turn = rotation.from_rotation_vector(np.array([0.0, 0.0, math.radians(f.turn)]))
                quaternion = rotation.multiply(turn, quaternion)
        if self._noise.position > 0.0:
            position = position + self._rng.normal(0.0, self._noise.position, 3)
        if self._noise.orientation > 0.0:
            v = self._rng.normal(0.0, math.radians(self._noise.orientation), 3)
            quaternion = rotation.multiply(quaternion, rotation.from_rotation_vector(v))
        return position, quaternion

    def spoil(self, record: bytes, t: float) -> bytes:
        """The bytes that leave instead of a record's."""
        for f in self._faults:
            if not f.active(t):
                continue
            if isinstance(f, Corruption) and record and self._rng.random() < f.probability:
                spoilt = bytearray(record)
                spoilt[int(self._rng.integers(len(spoilt)))] ^= 1 << int(self._rng.integers(8))
                record = bytes(spoilt)
            if isinstance(f, Truncation) and record and self._rng.random() < f.probability:
                record = record[: int(self._rng.integers(0, len(record)))]
            if isinstance(f, Junk) and self._rng.random() < f.probability:
                record = self._rng.bytes(int(self._rng.integers(1, f.length + 1))) + record
        return record
