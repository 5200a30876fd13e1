"""From a few seconds of standing to the floor, the origin and the forward direction.

The person stands upright and still where the origin shall be, facing what shall be forward,
arms hanging. Left and right trackers then span the left-right axis, the ankle trackers tell
the floor, the reference tracker the origin. In the room z is up, the floor is z = 0, and
forward is +x unless the settings say otherwise (the IS-900's north, Unity's forward; the
person's left is +y).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from sensors.errors import ConfigurationError, SensorError
from sensors.placement import Placement
from sensors.pose import TrackerFrame
from sensors.settings import Settings

_MIN_FRAMES = 3
_DISAGREEMENT = math.radians(60.0)


class AlignmentError(SensorError):
    """The standing cannot be used; the message says why and what to do."""


class AlignmentConfig(Settings):
    """Settings.

    Attributes:
        pairs: trackers of the left and the right side that tell the left-right axis; by
            default all whose names differ only in a leading l or left and r or right.
        floor: `"ankles"`: the lowest pair is `ankle_height` above the floor; `"keep"`: the
            height of the trackers' world is right as it is.
        ankle_height: of the ankle trackers above the floor, standing [m].
        origin: the tracker above the origin; by default `torso` if there is one, else the
            middle of all.
        heading: of forward in the room, counterclockwise from +x [deg]; -90 is -y.
        max_motion: a tracker that moves farther from its middle was not standing [m].
    """

    pairs: tuple[tuple[str, str], ...] = ()
    floor: Literal["ankles", "keep"] = "ankles"
    ankle_height: float = Field(default=0.08, ge=0.0, le=0.5)
    origin: str = ""
    heading: float = Field(default=0.0, ge=-360.0, le=360.0)
    max_motion: float = Field(default=0.05, gt=0.0)


@dataclass(frozen=True, slots=True)
class Alignment:
    """What came of it.

    Attributes:
        placement: the trackers' world in the room.
        heights: height of every tracker above the floor now [m].
        motion: farthest that any tracker was from its middle [m].
        warnings: what looks odd, for a human.
    """

    placement: Placement
    heights: dict[str, float]
    motion: float
    warnings: tuple[str, ...]


def align(
    frames: Sequence[TrackerFrame],
    trackers: Sequence[str],
    config: AlignmentConfig | None = None,
    before: Placement | None = None,
) -> Alignment:
    """Find the placement of the trackers' world.

    Args:
        frames: of a standing person, in the trackers' world (not placed in any room).
        trackers: names of their rows.
        config: settings.
        before: the placement so far, of which `keep` keeps the height.

    Raises:
        AlignmentError: if nobody stood still, or trackers are missing.
        ConfigurationError: for names of trackers that do not exist.
    """
    config = config or AlignmentConfig()
    places, motion = _standing(frames, trackers, config.max_motion)
    pairs = _pairs(trackers, config)
    facing, warnings = _facing(places, pairs)
    yaw = math.radians(before.yaw if before else 0.0)
    if facing is not None:
        yaw = math.remainder(math.radians(config.heading) - facing, 2.0 * math.pi)
    c, s = math.cos(yaw), math.sin(yaw)
    center = _center(places, config.origin)
    x, y = float(center[0]), float(center[1])
    z = before.translation[2] if before else 0.0
    if config.floor == "ankles":
        z = config.ankle_height - _ankles(places, pairs)
    placement = Placement(
        yaw=math.degrees(yaw), translation=(-(c * x - s * y), -(s * x + c * y), z)
    )
    heights = {name: float(p[2]) + z for name, p in places.items()}
    low = [name for name, h in heights.items() if h < -0.02]
    if low:
        warnings += (f"{low[0]} is below the floor; is ankle_height right?",)
    return Alignment(placement, heights, motion, warnings)


def _standing(
    frames: Sequence[TrackerFrame], trackers: Sequence[str], max_motion: float
) -> tuple[dict[str, NDArray[np.float64]], float]:
    """Middle of every tracker, and the farthest anybody was from it."""
    places: dict[str, NDArray[np.float64]] = {}
    farthest = 0.0
    for j, name in enumerate(trackers):
        seen = np.array([f.positions[j] for f in frames if f.position_mask[j]])
        if len(seen) < max(_MIN_FRAMES, len(frames) // 2):
            continue
        place = np.median(seen, axis=0)
        # Of all but the worst twentieth, for outliers are no motion.
        moved = float(np.quantile(np.linalg.norm(seen - place, axis=-1), 0.95))
        if moved > max_motion:
            raise AlignmentError(f"{name} moved {100.0 * moved:.0f} cm; stand still and try again")
        places[name] = place
        farthest = max(farthest, moved)
    if not places:
        raise AlignmentError("no tracker was seen half of the time; look at sensors monitor")
    return places, farthest


def default_pairs(trackers: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Left and right trackers whose names differ only in left and right."""
    names = set(trackers)
    found: list[tuple[str, str]] = []
    for name in trackers:
        for left, right in (("left", "right"), ("l", "r")):
            other = right + name[len(left) :]
            if name.startswith(left) and other in names:
                found.append((name, other))
                break
    return tuple(found)


def _pairs(trackers: Sequence[str], config: AlignmentConfig) -> tuple[tuple[str, str], ...]:
    pairs = config.pairs or default_pairs(trackers)
    wanted = [*(name for pair in pairs for name in pair), *([config.origin] * bool(config.origin))]
    for name in wanted:
        if name not in trackers:
            raise ConfigurationError(
                f"there is no tracker {name!r} to align by; there are {', '.join(trackers)}"
            )
    return pairs


def _facing(
    places: dict[str, NDArray[np.float64]], pairs: Sequence[tuple[str, str]]
) -> tuple[float | None, tuple[str, ...]]:
    """Heading in which the person looks [rad], None if no pair tells."""
    rights = {
        (left, right): (places[right] - places[left])[:2]
        for left, right in pairs
        if left in places and right in places
    }
    total = np.sum(list(rights.values()), axis=0) if rights else np.zeros(2)
    if float(np.linalg.norm(total)) < 0.05:
        words = "no left and right trackers tell the forward direction; it stays as it was"
        return None, (words,)
    warnings: list[str] = []
    for (left, right), vector in rights.items():
        angle = abs(math.remainder(_heading(vector) - _heading(total), 2.0 * math.pi))
        if angle > _DISAGREEMENT:
            warnings.append(
                f"{left} and {right} say another forward direction than the rest; are they "
                "exchanged?"
            )
    # Forward is up x right: a quarter turn counterclockwise.
    return _heading(total) + 0.5 * math.pi, tuple(warnings)


def _heading(v: NDArray[np.float64]) -> float:
    return math.atan2(float(v[1]), float(v[0]))


def _center(places: dict[str, NDArray[np.float64]], origin: str) -> NDArray[np.float64]:
    name = origin or "torso"
    if name in places:
        return places[name]
    if origin:
        raise AlignmentError(f"{origin} was not seen; choose another origin")
    return np.mean(list(places.values()), axis=0)


def _ankles(places: dict[str, NDArray[np.float64]], pairs: Sequence[tuple[str, str]]) -> float:
    """Height of the lowest pair, or of the lowest tracker [m]."""
    both = [
        0.5 * float(places[a][2] + places[b][2]) for a, b in pairs if a in places and b in places
    ]
    return min(both) if both else min(float(p[2]) for p in places.values())
