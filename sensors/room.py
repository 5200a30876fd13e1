"""Where the trackers' world sits in the room, and moving it while everything runs."""

from sensors.placement import Placement, RoomTransform


class Room:
    """The present placement of the trackers' world; any thread may change it.

    It acts on assembled frames, not on samples: a change is seen by the next frame as a
    whole, and interpolation never mixes two rooms.

    Args:
        placement: where to begin.
    """

    def __init__(self, placement: Placement | None = None) -> None:
        self._transform = (placement or Placement()).transform

    @property
    def transform(self) -> RoomTransform:
        """The present transform from the trackers' world to the room."""
        return self._transform

    def move(self, placement: Placement) -> None:
        """Place the trackers' world anew, from the next frame on."""
        self._transform = placement.transform
