"""Where an emulator takes its poses from: a function of time, or a file of arrays.

A playback file is a plain `.npz`, so that any process can hand a motion to the emulator
without this package knowing bodies:

- `times` (T,) [s], strictly increasing, the first is the zero of the motion;
- `positions` (T, J, 3) [m], world, z up;
- `quaternions` (T, J, 4), w x y z, unit length, tracker to world;
- `names` (J,) of text; station n plays column n - 1.
"""

import math
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sensors import rotation
from sensors.errors import PlaybackError

StationPose = tuple[NDArray[np.float64], NDArray[np.float64]]
PoseSource = Callable[[float], Sequence[StationPose | None]]
"""World poses of all stations at motion time t [s]; None for a station without one."""

MAX_STATIONS = 12


@dataclass(frozen=True, slots=True)
class Playback:
    """A recorded or computed motion of trackers.

    Attributes:
        times: shape (T,) [s], strictly increasing.
        positions: world, shape (T, J, 3) [m].
        quaternions: w x y z, shape (T, J, 4).
        names: J tracker names.

    Raises:
        PlaybackError: if shapes or values make no motion.
    """

    times: NDArray[np.float64]
    positions: NDArray[np.float64]
    quaternions: NDArray[np.float64]
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        T, J = len(self.times), len(self.names)
        if not 1 <= J <= MAX_STATIONS:
            raise PlaybackError(f"there are {J} trackers; an IS-900 has 1 to {MAX_STATIONS}")
        for what, array, shape in (
            ("times", self.times, (T,)),
            ("positions", self.positions, (T, J, 3)),
            ("quaternions", self.quaternions, (T, J, 4)),
        ):
            if array.shape != shape:
                raise PlaybackError(f"{what} has shape {array.shape}; it must be {shape}")
            if not np.isfinite(array).all():
                raise PlaybackError(f"{what} holds values that are not finite; leave none out")
        if T < 1 or (np.diff(self.times) <= 0.0).any():
            raise PlaybackError("times must be at least one and strictly increasing")
        lengths = np.linalg.norm(self.quaternions, axis=-1)
        if (abs(lengths - 1.0) > 1e-3).any():
            raise PlaybackError("quaternions must have unit length, in the order w x y z")

    @property
    def duration(self) -> float:
        """Time from the first row to the last [s]."""
        return float(self.times[-1] - self.times[0])

    def pose_at(self, t: float) -> list[StationPose | None]:
        """Interpolated poses at t [s] after the first row; held at both ends."""
        at = self.times[0] + min(max(t, 0.0), self.duration)
        b = int(np.clip(np.searchsorted(self.times, at), 1, max(1, len(self.times) - 1)))
        a = b - 1
        b = min(b, len(self.times) - 1)
        span = float(self.times[b] - self.times[a])
        f = 0.0 if span == 0.0 else (at - float(self.times[a])) / span
        p = (1.0 - f) * self.positions[a] + f * self.positions[b]
        q = rotation.slerp(self.quaternions[a], self.quaternions[b], np.array(f))
        return [(p[j], q[j]) for j in range(len(self.names))]

    def save(self, path: Path) -> None:
        """Write the playback file."""
        np.savez(
            path,
            times=self.times,
            positions=self.positions,
            quaternions=self.quaternions,
            names=np.array(self.names, dtype=np.str_),
        )

    @classmethod
    def load(cls, path: Path) -> "Playback":
        """Read a playback file; nothing in it is ever executed.

        Raises:
            PlaybackError: saying what is wrong with the file.
        """
        try:
            with np.load(path, allow_pickle=False) as archive:
                if not isinstance(archive, np.lib.npyio.NpzFile):
                    raise PlaybackError(f"{path} holds one array; make it with numpy.savez")
                missing = [k for k in _KEYS if k not in archive]
                if missing:
                    raise PlaybackError(
                        f"{path} lacks {', '.join(missing)}; it must hold {', '.join(_KEYS)}"
                    )
                arrays = [archive[k] for k in _KEYS]
            if not all(isinstance(a, np.ndarray) for a in arrays):
                raise PlaybackError(f"{path} holds bytes that are no arrays; use numpy.savez")
            times, positions, quaternions, names = arrays
            if names.ndim != 1 or names.dtype.kind != "U":
                raise PlaybackError(f"names in {path} must be a list of text")
            return cls(
                times.astype(np.float64),
                positions.astype(np.float64),
                quaternions.astype(np.float64),
                tuple(str(n) for n in names),
            )
        except (OSError, EOFError, ValueError, TypeError, zipfile.BadZipFile) as error:
            raise PlaybackError(f"{path} cannot be played: {error}") from error


_KEYS = ("times", "positions", "quaternions", "names")


def looped(pose_at: PoseSource, duration: float) -> PoseSource:
    """The motion again and again; the seam is a jump, as in the file."""
    if duration <= 0.0:
        return pose_at
    return lambda t: pose_at(math.fmod(max(t, 0.0), duration))


def wandering(stations: int = 6, period: float = 4.0) -> PoseSource:
    """A made-up smooth motion, for trying out a set-up without any file.

    Args:
        stations: how many move.
        period: time of one round [s].
    """

    def pose_at(t: float) -> list[StationPose | None]:
        poses: list[StationPose | None] = []
        for n in range(stations):
            phase = 2.0 * math.pi * (t / period + n / stations)
            p = np.array([0.5 * math.cos(phase), 0.5 * math.sin(phase), 0.3 + 0.25 * n])
            v = 0.5 * np.array([math.sin(phase), math.cos(phase), math.sin(2.0 * phase)])
            poses.append((p, rotation.from_rotation_vector(v)))
        return poses

    return pose_at
