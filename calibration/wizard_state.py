"""What a wizard says of itself: states, events, times, and a picture of how things are."""

from dataclasses import dataclass, field
from enum import Enum

from calibration.poses import TargetPose
from calibration.stillness import StillnessSettings


class State(Enum):
    """Where the wizard is."""

    READY = "ready"
    MOVING = "moving"
    HOLDING = "holding"
    WALKING = "walking"
    DONE = "done"


class Event(Enum):
    """What a frame or a key brought about."""

    NOTHING = "nothing"
    STILL = "still"
    MOVED = "moved"
    RECORDED = "recorded"
    COLLECTED = "collected"
    REFUSED = "refused"
    TIMED_OUT = "timed out"
    BLIND = "blind"
    FINISHED = "finished"


@dataclass(frozen=True, slots=True)
class WizardSettings:
    """Times and patience.

    Attributes:
        hold: how long a pose is recorded [s].
        get_ready: pause before a pose counts, so that the one before is not taken for it [s].
        timeout: after so long without a hold the person is reminded [s].
        retries: how often a pose that seems to be another is refused.
        min_trackers: so many must be seen in every frame of a hold; all of them if there
            are fewer.
        patience: for so long trackers may be away in the midst of a hold [s].
        travel: so far some tracker must have moved since the last hold [m].
        portion: after so much more motion it is worth saving [s].
        stillness: when a body counts as still.
    """

    hold: float = 2.0
    get_ready: float = 1.0
    timeout: float = 30.0
    retries: int = 2
    min_trackers: int = 4
    patience: float = 0.3
    travel: float = 0.10
    portion: float = 5.0
    stillness: StillnessSettings = field(default_factory=StillnessSettings)


@dataclass(frozen=True, slots=True)
class Snapshot:
    """What a view needs.

    Attributes:
        state: where the wizard is.
        pose: the pose that is asked for; None when walking or done.
        number: its place, from 1.
        total: how many there are.
        held: share of the hold, or of the motion, that is recorded, 0 to 1.
        recorded: names of the poses that are recorded.
        message: the last thing to tell the person; may be empty.
        unseen: trackers that the newest frame lacks.
        left: how much motion is still wanted [s].
        stiff: trackers that have hardly turned while walking.
    """

    state: State
    pose: TargetPose | None
    number: int
    total: int
    held: float
    recorded: tuple[str, ...]
    message: str
    unseen: tuple[str, ...]
    left: float = 0.0
    stiff: tuple[str, ...] = ()
