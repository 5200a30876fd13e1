"""Where the trackers' world sits in the room, and moving it while everything runs."""

import threading

from sensors.placement import Placement, RoomTransform
from sensors.pose import TrackerFrame


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
        self._latest: TrackerFrame | None = None

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
        """Remember the newest frame, as it was before it was placed, for re-centring."""
        self._latest = frame
