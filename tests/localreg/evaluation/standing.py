"""An estimator that knows nothing: it stands where the trackers are on average."""

from dataclasses import dataclass, field, replace

import numpy as np

from localreg.body.subject import Subject
from localreg.database import PoseDatabase
from localreg.synthesis.estimator import Estimator, Pose, Result
from sensors.pose import TrackerFrame


@dataclass(frozen=True)
class Standing(Estimator[int]):
    """Its state counts the frames; `asked` notes what it was asked, by name of method."""

    subject: Subject
    rate: float
    method: str
    allowed: np.ndarray | None
    asked: list[tuple[str, str, np.ndarray | None]] = field(default_factory=list)

    def leave_out(self, allowed: np.ndarray) -> "Standing":
        return replace(self, allowed=allowed)

    def init(self, frame: TrackerFrame) -> int:
        self.asked.append((self.method, "init", self.allowed))
        return 0

    def init_at(self, qpos: np.ndarray) -> int:
        self.asked.append((self.method, "init_at", self.allowed))
        return 0

    def step(self, state: int, frame: TrackerFrame) -> tuple[int, Pose]:
        qpos = np.zeros(63)
        qpos[:3] = frame.positions.mean(axis=0)
        qpos[3:5] = 0.5**0.5
        none = np.full(len(frame.positions), np.nan)
        self.asked.append((self.method, f"step {state}", self.allowed))
        pose = Pose(
            frame.time, qpos, none, none, np.nan, np.full(56, np.nan), 1, Result.SOLVED
        )  # fmt: skip
        return state + 1, pose


class Builder:
    """Stands in for `build_estimator` and keeps what every estimator was asked."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, str, np.ndarray | None]] = []
        self.built: list[str] = []

    def __call__(
        self,
        method: str,
        subject: Subject,
        database: PoseDatabase | None = None,
        allowed: np.ndarray | None = None,
    ) -> Standing:
        assert database is not None
        self.built.append(method)
        return Standing(subject, database.rate, method, allowed, self.asked)
