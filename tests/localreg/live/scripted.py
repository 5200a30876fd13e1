"""A clock, a stream and an estimator that do exactly what a test tells them."""

from collections.abc import Callable, Iterable
from concurrent.futures import Executor, Future
from typing import Any

import numpy as np

from localreg.body.skeleton import QPOS_SIZE
from localreg.body.subject import canonical_subject
from localreg.live.sinks import LivePose, Sink
from localreg.synthesis.estimator import Estimator, Pose, Result
from sensors.assembler import AssembledFrame, AssemblerConfig, FrameAssembler
from sensors.pose import TrackerFrame
from sensors.stream import FrameStream, SampleQueue

SUBJECT = canonical_subject()
RATE = 40.0
PERIOD = 1.0 / RATE
DELAY = 0.0125
START = 100.0


class Clock:
    """Time passes only when somebody says so."""

    def __init__(self) -> None:
        self.now = START

    def __call__(self) -> float:
        return self.now

    def pass_until(self, time: float) -> None:
        self.now = max(self.now, time)


def instant(n: int) -> float:
    return START + n * PERIOD


def frame(n: int, seen: int = 6) -> TrackerFrame:
    mask = np.arange(6) < seen
    quaternions = np.tile([1.0, 0.0, 0.0, 0.0], (6, 1))
    return TrackerFrame(instant(n), np.zeros((6, 3)), quaternions, mask, mask.copy())


def arrived(n: int, seen: int = 6, lag: float = 0.002) -> AssembledFrame:
    """Frame n, whose newest sample came `lag` after its instant; NaN if nothing was seen."""
    arrival = instant(n) + lag
    return AssembledFrame(frame(n, seen), arrival if seen else float("nan"), arrival, n)


class Inline(Executor):
    """Finds bodies at once, or when told.

    Args:
        patient: tasks wait for `finish`.
    """

    def __init__(self, patient: bool = False) -> None:
        self._patient = patient
        self._tasks: list[tuple[Future[Any], Callable[[], Any]]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self._tasks.append((future, lambda: fn(*args, **kwargs)))
        if not self._patient:
            self.finish()
        return future

    def finish(self) -> None:
        for future, work in self._tasks:
            future.set_result(work())
        self._tasks = []


class ScriptedStream(FrameStream):
    """Hands out given frames when the clock allows."""

    def __init__(self, clock: Clock, frames: Iterable[AssembledFrame]) -> None:
        config = AssemblerConfig(rate=RATE, delay=DELAY)
        super().__init__(SampleQueue(), FrameAssembler(SUBJECT.trackers, config))
        self._clock = clock
        self._frames = list(frames)

    def next(self, timeout: float) -> AssembledFrame | None:
        if not self._frames:
            self._clock.now += timeout
            return None
        if timeout <= 0.0 and self._frames[0].closed_at > self._clock.now:
            return None
        assembled = self._frames.pop(0)
        self._clock.pass_until(assembled.closed_at)
        return assembled


class ScriptedEstimator(Estimator[int]):
    """Its state counts the frames; its pose has root x = the number of the frame.

    Args:
        clock: moved on by `cost`.
        results: how each frame's step goes, by number of the frame; default solved.
        costs: how long each frame's step takes [s].
    """

    def __init__(
        self,
        clock: Clock | None = None,
        results: dict[int, Result] | None = None,
        costs: dict[int, float] | None = None,
        bad: frozenset[int] = frozenset(),
    ) -> None:
        self.subject = SUBJECT
        self.rate = RATE
        self.inits: list[int] = []
        self.steps: list[int] = []
        self._clock = clock or Clock()
        self._results = results or {}
        self._costs = costs or {}
        self._bad = bad

    def init(self, frame: TrackerFrame) -> int:
        self.inits.append(number(frame.time))
        return 0

    def step(self, state: int, frame: TrackerFrame) -> tuple[int, Pose]:
        n = number(frame.time)
        self.steps.append(n)
        self._clock.now += self._costs.get(n, 0.0)
        qpos = np.zeros(QPOS_SIZE)
        qpos[0], qpos[3] = (np.nan if n in self._bad else n), 1.0
        residuals = np.where(frame.position_mask, 0.001, np.nan)
        result = self._results.get(n, Result.SOLVED)
        pose = Pose(frame.time, qpos, residuals, residuals, 1.0, np.zeros(56), 1, result)
        return state + 1, pose


def number(time: float) -> int:
    return round((time - START) / PERIOD)


class Listener(Sink):
    """Remembers what it was handed."""

    def __init__(self, then: Callable[[LivePose], None] | None = None) -> None:
        self.heard: list[LivePose] = []
        self.closed = 0
        self._then = then

    def publish(self, live: LivePose) -> None:
        self.heard.append(live)
        if self._then is not None:
            self._then(live)

    def close(self) -> None:
        self.closed += 1

    @property
    def shown(self) -> list[int]:
        """Of which frame each pose was."""
        return [round(live.pose.qpos[0]) for live in self.heard]

    @property
    def held(self) -> list[bool]:
        return [live.is_held for live in self.heard]
