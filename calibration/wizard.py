"""The wizard as a state machine: poses, stillness, retries, timeouts, the way back, a walk.

It knows no view and reads no clock: it is told frames and keys, and says in which state it
is. A view draws `snapshot()`; whoever runs it saves `holds` after every `Event.RECORDED`, and
`motion` after every `Event.COLLECTED`.

    ready --go--> moving --still--> holding --enough--> moving (the next pose) ... walking ... done
                    ^                  |
                    +------moved-------+

A pose that plainly is another than the one asked for is refused, up to `retries` times;
then it is taken, and the fit has the last word. Nobody gets a pose wrong for ever.
"""

from collections.abc import Callable, Iterable, Sequence

from calibration.holds import Hold
from calibration.motion_step import MotionStep
from calibration.poses import TargetPose
from calibration.stillness import StillnessDetector
from calibration.wizard_state import Event, Snapshot, State, WizardSettings
from localreg.errors import LocalregError
from sensors.pose import TrackerFrame

Judge = Callable[[Hold], str]
"""Says what is plainly wrong with a hold; empty if nothing is."""


def check_names(names: Iterable[str], poses: Sequence[TargetPose]) -> None:
    """Refuse names that no pose has.

    Raises:
        LocalregError: with the names that there are.
    """
    known = [pose.name for pose in poses]
    if unknown := [name for name in names if name not in known]:
        raise LocalregError(
            f"there is no pose named {', '.join(unknown)}; there are {', '.join(known)}"
        )


class Wizard:
    """Leads through the poses, and has the person walk about.

    Args:
        poses: in their order.
        trackers: names, in the order of the frames.
        judge: looks at every hold before it is taken.
        settings: times and patience.
        holds: of an earlier run that is resumed, by pose.
        only: names of the poses to be held; the others are not asked for.
        motion: what collects motion after the poses; none is asked for without.

    Raises:
        LocalregError: a name that no pose has.
    """

    def __init__(
        self,
        poses: Sequence[TargetPose],
        trackers: Sequence[str],
        *,
        judge: Judge | None = None,
        settings: WizardSettings | None = None,
        holds: dict[str, Hold] | None = None,
        only: Sequence[str] | None = None,
        motion: MotionStep | None = None,
    ) -> None:
        check_names([*(holds or {}), *(only or ())], poses)
        self.poses = tuple(poses)
        self.trackers = tuple(trackers)
        self.settings = settings or WizardSettings()
        self.motion = motion
        self.state = State.READY
        self._judge = judge or (lambda hold: "")
        self._holds: dict[str, Hold] = dict(holds or {})
        self._asked = set([pose.name for pose in poses] if only is None else only)
        self._detector = StillnessDetector(self.settings.stillness)
        self._frames: list[TrackerFrame] = []
        self._since: float | None = None
        self._reminded: float | None = None
        self._refusals = 0
        self._message = ""
        self._unseen: tuple[str, ...] = ()
        self._blind_since: float | None = None
        self._last: TrackerFrame | None = None
        self._has_traveled = True
        self._kept = 0.0 if motion is None else motion.collected
        self._index = self._next(0)
        if self._index is None and not self._wants_motion:
            self.state = State.DONE

    @property
    def pose(self) -> TargetPose | None:
        """The pose that is asked for."""
        return None if self._index is None else self.poses[self._index]

    @property
    def holds(self) -> tuple[Hold, ...]:
        """What is recorded, in the order of the poses."""
        return tuple(self._holds[p.name] for p in self.poses if p.name in self._holds)

    def snapshot(self) -> Snapshot:
        """How things are now."""
        asked = [pose for pose in self.poses if pose.name in self._asked]
        pose = self.pose
        number = len(asked) if pose is None else asked.index(pose) + 1
        span, left, stiff = 0.0, 0.0, ()
        if len(self._frames) > 1:
            span = (self._frames[-1].time - self._frames[0].time) / self.settings.hold
        if self.motion is not None:
            left = max(self.motion.seconds - self.motion.collected, 0.0)
            if self._wants_motion and pose is None:
                span, stiff = 1.0 - left / self.motion.seconds, self.motion.stiff
        return Snapshot(
            self.state, pose, number, len(asked), min(span, 1.0),
            tuple(hold.pose for hold in self.holds), self._message, self._unseen, left, stiff,
        )  # fmt: skip

    def go(self) -> None:
        """Begin, or go on after a pause."""
        if self.state is State.READY:
            self._enter()

    def pause(self) -> None:
        """Stop recording until `go`."""
        if self.state in (State.MOVING, State.HOLDING, State.WALKING):
            self.state = State.READY
            self._frames = []

    def back(self) -> None:
        """Throw the last recorded pose away and ask for it again."""
        end = len(self.poses) if self._index is None else self._index
        for index in range(end - 1, -1, -1):
            pose = self.poses[index]
            if pose.name in self._asked and pose.name in self._holds:
                del self._holds[pose.name]
                self._index = index
                self._restart(f"Again: {pose.name}.")
                return

    def skip(self) -> None:
        """Go on without the present pose, or without more motion."""
        if self._index is not None:
            self._asked.discard(self.poses[self._index].name)
            self._advance()
        elif self.motion is not None:
            self.motion.finish()
            self._enter()

    def repeat(self, names: Sequence[str]) -> None:
        """Ask for poses again, whatever was recorded of them.

        Raises:
            LocalregError: a name that no pose has.
        """
        check_names(names, self.poses)
        for name in names:
            self._asked.add(name)
            self._holds.pop(name, None)
        self._index = self._next(0)
        if self._index is not None:
            self._restart("")

    def push(self, frame: TrackerFrame) -> Event:
        """Take a frame."""
        missing = ~(frame.position_mask & frame.orientation_mask)
        self._unseen = tuple(n for n, gone in zip(self.trackers, missing, strict=True) if gone)
        if self.state in (State.READY, State.DONE):
            return Event.NOTHING
        if self._since is None:
            self._since = self._reminded = frame.time
        seen = len(self.trackers) - len(self._unseen)
        if seen < min(self.settings.min_trackers, len(self.trackers)):
            return self._blind(frame)
        self._blind_since = None
        if self.state is State.WALKING:
            return self._collect(frame)
        is_still = self._detector.push(frame)
        if self.state is State.MOVING:
            return self._wait(frame, is_still)
        return self._record(frame, is_still)

    def _wait(self, frame: TrackerFrame, is_still: bool) -> Event:
        self._has_traveled |= self._is_elsewhere(frame)
        since = frame.time - (frame.time if self._since is None else self._since)
        if is_still and self._has_traveled and since >= self.settings.get_ready:
            self.state, self._frames = State.HOLDING, [frame]
            self._message = "Hold it."
            return Event.STILL
        reminded = frame.time if self._reminded is None else self._reminded
        if frame.time - reminded >= self.settings.timeout:
            self._reminded = frame.time
            self._message = (
                "Still waiting: take the pose and hold still for a moment."
                if self._has_traveled
                else "Still waiting: this is the pose before; take the next one."
            )
            return Event.TIMED_OUT
        return Event.NOTHING

    def _record(self, frame: TrackerFrame, is_still: bool) -> Event:
        if not is_still:
            self.state, self._frames = State.MOVING, []
            self._message = "That was too short: hold still until it is recorded."
            return Event.MOVED
        self._frames.append(frame)
        if frame.time - self._frames[0].time < self.settings.hold:
            return Event.NOTHING
        pose = self.pose
        assert pose is not None  # noqa: S101  (only holding when there is one)
        hold = Hold.of_frames(pose.name, self._frames)
        self._last = frame
        wrong = self._judge(hold)
        if wrong and self._refusals < self.settings.retries:
            self._refusals += 1
            self._enter(f"{wrong[0].upper()}{wrong[1:]}; look at the picture and try again.")
            return Event.REFUSED
        self._holds[pose.name] = hold
        self._advance()
        return Event.FINISHED if self.state is State.DONE else Event.RECORDED

    def _collect(self, frame: TrackerFrame) -> Event:
        motion = self.motion
        assert motion is not None  # noqa: S101  (only walking when there is one)
        motion.push(frame)
        self._message = ""
        if motion.is_over:
            self._enter()
            return Event.FINISHED
        if motion.collected < self._kept + self.settings.portion:
            return Event.NOTHING
        self._kept = motion.collected
        return Event.COLLECTED

    def _blind(self, frame: TrackerFrame) -> Event:
        if self._blind_since is None:
            self._blind_since = frame.time
        if frame.time - self._blind_since < self.settings.patience:
            return Event.NOTHING
        was_holding = self.state is State.HOLDING
        if was_holding:
            self.state, self._frames = State.MOVING, []
        self._message = f"Not seen: {', '.join(self._unseen)}."
        return Event.BLIND if was_holding else Event.NOTHING

    def _is_elsewhere(self, frame: TrackerFrame) -> bool:
        """Whether the body has left the pose before."""
        if self._last is None:
            return True
        both = frame.position_mask & self._last.position_mask
        away = ((frame.positions - self._last.positions) ** 2).sum(axis=1)[both]
        return bool(away.size) and bool(away.max() > self.settings.travel**2)

    def _advance(self) -> None:
        self._refusals = 0
        self._index = self._next(0 if self._index is None else self._index)
        if self._index is None:
            self._index = self._next(0)
        self._enter("Recorded.")

    def _next(self, start: int) -> int | None:
        for index in range(start, len(self.poses)):
            name = self.poses[index].name
            if name in self._asked and name not in self._holds:
                return index
        return None

    @property
    def _wants_motion(self) -> bool:
        return self.motion is not None and not self.motion.is_over

    def _restart(self, message: str) -> None:
        self._refusals = 0
        self._last = None
        self._enter(message)

    def _enter(self, message: str = "") -> None:
        """Go to whatever is still wanted: a pose, motion, or nothing."""
        self._frames, self._message = [], message
        if self._index is not None:
            self.state = State.MOVING
        elif self._wants_motion:
            self.state = State.WALKING
        else:
            self.state, self._message = State.DONE, "All is recorded."
        if self.motion is not None:
            self.motion.part()
        self._since = self._reminded = None
        self._has_traveled = self._last is None
        self._detector.reset()
