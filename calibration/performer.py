"""A simulated person who follows the wizard's instructions, seen through a real emulator.

The person goes from pose to pose as people do: a moment to read, a smooth move, a hold with
a little sway. What they hold is wrong by their usual errors. Asked to move about, they play
recorded motion. An IS-900 is emulated on a
pseudo terminal, and whoever reads it cannot tell.
"""

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from calibration.motion_step import NAME
from calibration.poses import TargetPose
from calibration.simulated import Habits, perform
from calibration.walk import Walk, between
from localreg.body.subject import Subject
from localreg.evaluation.body_points import BodyPoints
from sensors.emulators.faults import Noise
from sensors.emulators.is900 import Is900Emulator
from sensors.emulators.source import StationPose

_REACTION: Final = 0.4
_MOVE: Final = 1.2
_SWAY: Final = 0.003
_SWAY_PERIOD: Final = 3.1


@dataclass(frozen=True, slots=True)
class _Move:
    """From one pose to another.

    Attributes:
        before: pose at the beginning.
        after: pose at the end.
        begin: when it begins [s].
        walk: what is played from then on, instead of standing still.
    """

    before: Float[ndarray, "63"]
    after: Float[ndarray, "63"]
    begin: float
    walk: Walk | None = None


class Performer:
    """The person; `pose_at` is the emulator's source, `ask` the wizard's instruction.

    Args:
        person: whose body, with the mounts that are to be found.
        poses: that can be asked for.
        habits: errors; another error for every repetition of a pose.
        seed: of everything random.
        mistakes: for a pose's name the pose that is taken instead, the first time.
        walk: what is done when asked to move about; nothing without.
    """

    def __init__(
        self,
        person: Subject,
        poses: Sequence[TargetPose],
        habits: Habits,
        seed: int = 0,
        mistakes: dict[str, TargetPose] | None = None,
        walk: Walk | None = None,
    ) -> None:
        self._walk = walk
        self.person = person
        self._names = [pose.name for pose in poses]
        self._poses = list(poses)
        self._habits = habits
        self._seed = seed
        self._mistakes = dict(mistakes or {})
        self._attempts: dict[str, int] = {}
        self._performed: dict[int, Float[ndarray, "N 63"]] = {}
        self._points = BodyPoints(person)
        self._lock = threading.Lock()
        start = self._held(0, 0)
        start[7:] *= 0.3  # whoever waits does not stand in the first pose
        self._move = _Move(start, start, 0.0)
        self._now = 0.0
        self._asked = ""

    def ask(self, name: str, again: bool = False) -> None:
        """Take a pose, from where the body is; asking for the present one changes nothing."""
        if name == self._asked and not again:
            return
        walk = self._walk if name == NAME else None
        if name not in self._names and walk is None:
            return
        if walk is not None:
            with self._lock:
                self._asked = name
                at = self._qpos(self._now)
                walk = walk.from_pose(at)
                self._move = _Move(at, walk.at(0.0), self._now + _REACTION, walk)
            return
        attempt = self._attempts.get(name, 0)
        self._attempts[name] = attempt + 1
        goal = self._held(self._names.index(name), attempt)
        with self._lock:
            self._asked = name
            at = self._qpos(self._now)
            self._move = _Move(at, goal, self._now + _REACTION)

    def pose_at(self, t: float) -> list[StationPose | None]:
        """Where the trackers are at motion time t [s]."""
        with self._lock:
            self._now = t
            qpos = self._qpos(t)
            seen = self._points.tracker_poses(qpos[None])
        return [
            (seen.positions[0, j], seen.quaternions[0, j]) for j in range(seen.positions.shape[1])
        ]

    def _held(self, index: int, attempt: int) -> Float[ndarray, "63"]:
        """How this person holds a pose; standing feet are those of the first pose."""
        if attempt not in self._performed:
            mistakes = self._mistakes if attempt == 0 else {}
            poses = [mistakes.get(pose.name, pose) for pose in self._poses]
            rng = np.random.default_rng((self._seed, attempt))
            self._performed[attempt] = perform(self.person, poses, self._habits, rng, self._seed)
        return self._performed[attempt][index].copy()

    def _qpos(self, t: float) -> Float[ndarray, "63"]:
        move = self._move
        gone = t - move.begin
        if move.walk is not None and gone > _MOVE:
            return move.walk.at(gone - _MOVE)
        qpos = between(move.before, move.after, gone / _MOVE)
        phase = 2.0 * np.pi * t / _SWAY_PERIOD
        qpos[:2] += _SWAY * np.array([np.sin(phase), np.cos(0.7 * phase)])
        return qpos


def emulated(performer: Performer, habits: Habits, seed: int) -> Is900Emulator:
    """The person's trackers on an IS-900; enter it as a context to switch it on."""
    return Is900Emulator(
        performer.pose_at,
        stations=len(performer.person.trackers),
        start="now",
        noise=Noise(habits.noise_position, float(np.degrees(habits.noise_orientation))),
        seed=seed,
    )
