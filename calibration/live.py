"""Runs the wizard on a stream of frames: looks at holds, saves progress, obeys keys."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from calibration.eigen_skeleton import SkeletonPrior
from calibration.holds import Hold
from calibration.motion_step import NAME
from calibration.poses import TargetPose
from calibration.progress import write_motion, write_progress
from calibration.screening import PoseJudge
from calibration.wizard import Wizard
from calibration.wizard_state import Event, Snapshot, State
from localreg.body.subject import Mount
from localreg.errors import LocalregError
from sensors.pose import TrackerFrame
from sensors.stream import FrameStream

_POLL = 0.05
_NO_DATA = 20.0
_WORTH_SAVING = (Event.RECORDED, Event.COLLECTED, Event.FINISHED)


@runtime_checkable
class View(Protocol):
    """What shows the wizard and takes keys."""

    def show(self, snapshot: Snapshot, event: Event, frame: TrackerFrame | None) -> None:
        """Draw how things are; called after every frame and every key."""

    def key(self) -> str:
        """The newest key since the last call; empty if there is none."""
        ...


@dataclass(frozen=True, slots=True)
class Hooks:
    """What else is told of the wizard's way.

    Attributes:
        asked: told the name of the pose (or `motion_step.NAME`) that is asked for, and
            whether anew.
    """

    asked: Callable[[str, bool], None] = lambda name, again: None


class LeftEarlyError(LocalregError):
    """The person left; what is recorded is kept."""


def make_judge(
    poses: tuple[TargetPose, ...], trackers: tuple[Mount, ...], prior: SkeletonPrior
) -> Callable[[Hold], str]:
    """What the wizard asks about every hold."""
    return PoseJudge(poses, trackers, prior).judge


def lead(
    wizard: Wizard,
    stream: FrameStream,
    view: View,
    *,
    progress: Path | None = None,
    hooks: Hooks | None = None,
) -> tuple[Hold, ...]:
    """Run the wizard until all that it asks for is recorded.

    Keys: space or Enter begins and pauses, `b` goes back, `s` skips, `q` leaves.

    Args:
        wizard: in any state.
        stream: of running devices.
        view: draws and takes keys.
        progress: file that is replaced after every recorded pose; motion goes beside it.
        hooks: who else is told.

    Raises:
        LeftEarlyError: the person left.
        LocalregError: no frame came for a long time, or progress cannot be saved.
    """
    hooks = hooks or Hooks()
    heard = time.monotonic()
    while wizard.state is not State.DONE:
        _obey(wizard, view.key(), progress)
        if wizard.state is State.DONE:
            break
        if wizard.state is not State.READY:
            hooks.asked(NAME if wizard.pose is None else wizard.pose.name, False)
        assembled = stream.next(_POLL)
        if assembled is None:
            if time.monotonic() - heard > _NO_DATA:
                raise LocalregError(
                    f"no tracker data for {_NO_DATA:g} s; see that the device is on and that its "
                    "port is right (localreg sensors monitor shows it)"
                )
            continue
        heard = time.monotonic()
        asked = wizard.pose
        event = wizard.push(assembled.frame)
        if event in _WORTH_SAVING:
            _save(wizard, progress)
        if event is Event.REFUSED and asked is not None:
            hooks.asked(asked.name, True)
        view.show(wizard.snapshot(), event, assembled.frame)
    return wizard.holds


def _save(wizard: Wizard, progress: Path | None) -> None:
    if progress is None:
        return
    write_progress(progress, wizard.holds, wizard.trackers)
    if wizard.motion is not None and wizard.motion.stretches:
        write_motion(progress, wizard.motion.stretches, wizard.trackers)


def _obey(wizard: Wizard, key: str, progress: Path | None) -> None:
    if key in (" ", "\r", "\n"):
        if wizard.state is State.READY:
            wizard.go()
        else:
            wizard.pause()
    elif key == "b":
        wizard.back()
        _save(wizard, progress)
    elif key == "s":
        wizard.skip()
    elif key in ("q", "\x03"):
        _save(wizard, progress)
        kept = f"; what is recorded is kept in {progress}" if progress is not None else ""
        raise LeftEarlyError(f"left before the end{kept}")
