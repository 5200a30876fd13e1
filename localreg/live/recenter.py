"""Re-centring: the performer's present place becomes the origin, the present heading ahead.

It acts on what is published, poses and trackers alike, behind the estimator: the estimator
goes on in the room as it is, and nothing jumps but the place. Heights stay.
"""

import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.live.sinks.base import LivePose
from sensors import rotation
from sensors.placement import RoomTransform

AHEAD = (1.0, 0.0)
"""Where a re-centred performer faces, x and y in the world: Unity's forward, IS-900's north."""

_ROOT_FORWARD = np.array([0.0, 0.0, 1.0])


def facing_ahead(qpos: Float[ndarray, "63"]) -> RoomTransform:
    """What brings a pose's root above the origin, facing `AHEAD`.

    Of a root that lies on its back or belly, its up counts for forward or backward.
    """
    forward = rotation.rotate(qpos[3:7], _ROOT_FORWARD)
    if math.hypot(forward[0], forward[1]) < 0.3:
        up = rotation.rotate(qpos[3:7], np.array([0.0, 1.0, 0.0]))
        forward = up if forward[2] < 0.0 else -up
    yaw = math.atan2(AHEAD[1], AHEAD[0]) - math.atan2(forward[1], forward[0])
    c, s = math.cos(yaw), math.sin(yaw)
    x, y = float(qpos[0]), float(qpos[1])
    return RoomTransform(yaw, (-(c * x - s * y), -(s * x + c * y), 0.0))


def placed(live: LivePose, transform: RoomTransform) -> LivePose:
    """The published frame elsewhere: the root and all trackers."""
    qpos = live.pose.qpos.copy()
    qpos[:3], qpos[3:7] = transform.apply(qpos[:3], qpos[3:7])
    positions, quaternions = transform.apply(live.frame.positions, live.frame.quaternions)
    frame = live.frame._replace(positions=positions, quaternions=quaternions)
    return live._replace(pose=live.pose._replace(qpos=qpos), frame=frame)


class Recentering:
    """The present placement of what is published; any thread may ask for a new one.

    Attributes:
        on_change: is told the first frame of a new placement, as it was, and the placement.
        count: how often that has happened.
    """

    def __init__(self) -> None:
        self.on_change: Callable[[LivePose, RoomTransform], None] | None = None
        # A plain flag: a signal handler must not take locks.
        self._is_asked = False
        self._transform: RoomTransform | None = None
        self.count = 0

    @property
    def transform(self) -> RoomTransform | None:
        """The present transform; None before the first request."""
        return self._transform

    def request(self) -> None:
        """Re-centre with the next frame that has a new pose; from any thread or signal."""
        self._is_asked = True

    def __call__(self, live: LivePose) -> LivePose:
        """The frame as it is to be published."""
        if self._is_asked and not live.is_held:
            self._is_asked = False
            self._transform = facing_ahead(live.pose.qpos)
            self.count += 1
            if self.on_change is not None:
                self.on_change(live, self._transform)
        return live if self._transform is None else placed(live, self._transform)
