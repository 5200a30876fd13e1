"""What every method of turning tracker frames into poses has in common."""

from abc import ABC, abstractmethod
from enum import IntEnum
from typing import Any, Generic, NamedTuple, TypeVar

from jaxtyping import Bool, Float
from numpy import ndarray

from localreg.body.subject import Subject
from sensors.pose import TrackerFrame

StateT = TypeVar("StateT")


class Result(IntEnum):
    """How a frame went."""

    SOLVED = 0
    """The solver lowered the energy; the pose is its answer."""
    FAILED = 1
    """The energy was not finite or did not fall; the pose is the prediction."""
    REACQUIRED = 2
    """The pose was found anew: the trackers had left it behind, or explain another better."""


class Pose(NamedTuple):
    """One synthesized frame.

    Attributes:
        time: instant of the tracker frame [s].
        qpos: root position [m], root quaternion w x y z, joint angles [rad].
        position_residuals: distance between each of the J trackers' measured and
            synthesized positions [m]; NaN where not measured.
        orientation_residuals: angle between them [rad]; NaN where not measured.
        confidence: 0 to 1, how well the database explains what is being seen; NaN for
            methods without a database.
        predicted_sigma: standard deviation that the method gives each joint angle [rad].
        steps: solver steps taken.
        result: how it went.
    """

    time: float
    qpos: Float[ndarray, "63"]
    position_residuals: Float[ndarray, " J"]
    orientation_residuals: Float[ndarray, " J"]
    confidence: float
    predicted_sigma: Float[ndarray, "56"]
    steps: int
    result: Result


class Estimator(ABC, Generic[StateT]):
    """Trackers in, poses out, one frame at a time; live and offline alike.

    Both methods are pure: the state is a value, and an estimator may serve several
    motions in turn.

    Attributes:
        subject: whose body is moved, and which trackers it wears.
        rate: frames a second that `step` expects [Hz].
    """

    subject: Subject
    rate: float

    def leave_out(self, allowed: Bool[ndarray, " poses"]) -> "Estimator[StateT]":
        """The same estimator seeing only the allowed poses of its database, if it has one."""
        return self

    @abstractmethod
    def init(self, frame: TrackerFrame) -> StateT:
        """Find the pose from one frame alone, however far it is from any other."""

    def init_at(self, qpos: Float[ndarray, "63"]) -> StateT:
        """Begin from a pose that is known, as the easier evaluation protocol does."""
        raise NotImplementedError

    @abstractmethod
    def step(self, state: StateT, frame: TrackerFrame) -> tuple[StateT, Pose]:
        """The next pose; never fails for data, reports in the pose instead."""


AnyEstimator = Estimator[Any]
"""An estimator whose state is nobody else's business."""
