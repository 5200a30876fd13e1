"""What goes from the live loop to the process that shows it, and what comes back.

Every frame is one vector of numbers of fixed layout, so that handing it over costs the loop
some ten microseconds; what changes slowly goes a few times a second, as JSON.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.skeleton import QPOS_SIZE
from localreg.view.moment import Heard, Moment, NeighborClip, Observer, Timing
from sensors.pose import TrackerFrame

ABOUT_SIZE: Final = 1 << 16
"""Room for the slowly changing part [bytes]."""

_SCALARS: Final = 6


@dataclass(frozen=True, eq=False, slots=True)
class Glimpse:
    """One frame as the loop publishes it.

    Attributes:
        index: number of its instant.
        frame: what the trackers said.
        qpos: the body.
        confidence: 0 to 1; NaN if unknown.
        is_held: whether an earlier pose is shown again.
        is_start: whether the body was just found anew.
        ghost: a body to compare with, or None.
    """

    index: int
    frame: TrackerFrame
    qpos: Float[ndarray, "63"]
    confidence: float
    is_held: bool
    is_start: bool
    ghost: Float[ndarray, "63"] | None


def glimpse_size(trackers: int) -> int:
    """How long a packed glimpse is [bytes]."""
    return 8 * (_SCALARS + 2 * QPOS_SIZE + 9 * trackers)


def pack(glimpse: Glimpse) -> bytes:
    """The bytes of a glimpse."""
    frame, ghost = glimpse.frame, glimpse.ghost
    J = len(frame.position_mask)
    at = _SCALARS
    values = np.empty(glimpse_size(J) // 8)
    values[:at] = (
        glimpse.index, frame.time, glimpse.confidence,
        glimpse.is_held, glimpse.is_start, ghost is not None,
    )  # fmt: skip
    values[at : at + QPOS_SIZE] = glimpse.qpos
    values[at + QPOS_SIZE : at + 2 * QPOS_SIZE] = glimpse.qpos if ghost is None else ghost
    rest = values[at + 2 * QPOS_SIZE :]
    rest[: 3 * J] = frame.positions.ravel()
    rest[3 * J : 7 * J] = frame.quaternions.ravel()
    rest[7 * J : 8 * J] = frame.position_mask
    rest[8 * J :] = frame.orientation_mask
    return values.tobytes()


def unpack(data: bytes, trackers: int) -> Glimpse:
    """The glimpse of some bytes.

    Args:
        data: what `pack` made.
        trackers: how many the frame has.

    Raises:
        ValueError: the length is another.
    """
    if len(data) != glimpse_size(trackers):
        raise ValueError(f"{len(data)} bytes are no glimpse of {trackers} trackers")
    values = np.frombuffer(data, dtype=np.float64)
    J, at = trackers, _SCALARS
    index, time, confidence, is_held, is_start, has_ghost = values[:at].tolist()
    qpos, ghost = values[at : at + QPOS_SIZE], values[at + QPOS_SIZE : at + 2 * QPOS_SIZE]
    rest = values[at + 2 * QPOS_SIZE :]
    frame = TrackerFrame(
        time=time,
        positions=rest[: 3 * J].reshape(J, 3),
        quaternions=rest[3 * J : 7 * J].reshape(J, 4),
        position_mask=rest[7 * J : 8 * J] != 0.0,
        orientation_mask=rest[8 * J :] != 0.0,
    )
    return Glimpse(
        int(index), frame, qpos, confidence, bool(is_held), bool(is_start),
        ghost if has_ghost else None,
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class About:
    """What changes slowly.

    Attributes:
        timing: how the loop keeps up.
        heard: how each tracker's reports come in.
        neighbors: clips that the nearest poses of the database are of.
        title: what is being played.
        ghost_name: what the ghost is.
        note: the last thing that a button brought about.
        notice: what stands above all else, such as that no pose is live yet.
        is_recording: whether a take is being recorded.
    """

    timing: Timing = field(default_factory=Timing)
    heard: Mapping[str, Heard] = field(default_factory=dict)
    neighbors: tuple[NeighborClip, ...] = ()
    title: str = ""
    ghost_name: str = ""
    note: str = ""
    notice: str = ""
    is_recording: bool = False

    def to_bytes(self) -> bytes:
        """As JSON; what is not known is null."""
        timing = self.timing
        document = {
            "timing": [
                timing.p50, timing.p99, timing.frames, timing.late_frames,
                timing.compute_p50, timing.compute_p99,
            ],
            "heard": {name: [heard.rate, heard.age] for name, heard in self.heard.items()},
            "neighbors": [[clip.name, clip.activity, clip.share] for clip in self.neighbors],
            "title": self.title,
            "ghost_name": self.ghost_name,
            "note": self.note,
            "notice": self.notice,
            "is_recording": self.is_recording,
        }  # fmt: skip
        return json.dumps(_without_nan(document), allow_nan=False).encode()

    @classmethod
    def of_bytes(cls, data: bytes) -> "About":
        """What `to_bytes` wrote."""
        document = json.loads(data)
        p50, p99, frames, late, compute_p50, compute_p99 = document["timing"]
        return cls(
            timing=Timing(
                _number(p50), _number(p99), frames, late, _number(compute_p50), _number(compute_p99)
            ),
            heard={
                name: Heard(_number(rate), _number(age))
                for name, (rate, age) in document["heard"].items()
            },
            neighbors=tuple(
                NeighborClip(name, activity, _number(share))
                for name, activity, share in document["neighbors"]
            ),
            title=document["title"],
            ghost_name=document["ghost_name"],
            note=document["note"],
            notice=document["notice"],
            is_recording=document["is_recording"],
        )


def moment_of(glimpse: Glimpse, about: About, observer: Observer) -> Moment:
    """What is to be seen of a frame."""
    seen = observer.observe(
        glimpse.frame.time,
        glimpse.qpos,
        glimpse.frame,
        heard=about.heard,
        is_start=glimpse.is_start,
    )
    return replace(
        seen,
        index=glimpse.index,
        ghost=glimpse.ghost,
        ghost_name=about.ghost_name,
        confidence=glimpse.confidence,
        neighbors=about.neighbors,
        timing=about.timing,
        is_held=glimpse.is_held,
        title=about.title,
    )


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _without_nan(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_nan(item) for item in value]
    return value
