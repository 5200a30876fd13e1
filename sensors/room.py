"""Where the trackers' world sits in the room, and moving it while everything runs."""

import threading
from collections import deque
from collections.abc import Sequence

from sensors.alignment import Alignment, AlignmentConfig, align
from sensors.placement import Placement, RoomTransform
from sensors.pose import TrackerFrame

_REMEMBERED = 64


class Room:
    """The present placement of the trackers' world; any thread may change it.

    It acts on assembled frames, not on samples: a change is seen by the next frame as a
    whole, and interpolation never mixes two rooms.

    Args:
        placement: where to begin.
    """

    def __init__(self, placement: Placement | None = None) -> None:
        self._lock = threading.Lock()
        self._placement = placement or Placement()
        self._transform = self._placement.transform
        self._recent: deque[TrackerFrame] = deque(maxlen=_REMEMBERED)

    @property
    def placement(self) -> Placement:
        """The present placement, as a configuration file would hold it."""
        return self._placement

    @property
    def transform(self) -> RoomTransform:
        """The present transform from the trackers' world to the room."""
        return self._transform

    def move(self, placement: Placement) -> None:
        """Place the trackers' world anew, from the next frame on."""
        with self._lock:
            self._placement, self._transform = placement, placement.transform

    def observe(self, frame: TrackerFrame) -> None:
        """Remember a frame, as it was before it was placed, for `recenter`."""
        with self._lock:
            self._recent.append(frame)

    def recenter(
        self,
        trackers: Sequence[str],
        config: AlignmentConfig | None = None,
        seconds: float = 0.5,
    ) -> Alignment:
        """Where the person stands now becomes the origin, where they look forward.

        Heights stay as they are unless the settings say otherwise. Takes effect with the next
        frame.

        Args:
            trackers: rows of the frames.
            config: settings; by default the height is kept.
            seconds: how long the person has been standing still [s].

        Returns:
            What was found.

        Raises:
            AlignmentError: if there were no frames lately, or somebody moved.
        """
        config = config or AlignmentConfig(floor="keep")
        with self._lock:
            recent = list(self._recent)
        since = recent[-1].time - seconds if recent else 0.0
        standing = [f for f in recent if f.time >= since]
        alignment = align(standing, trackers, config, self._placement)
        self.move(alignment.placement)
        return alignment
