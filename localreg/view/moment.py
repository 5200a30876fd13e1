"""Everything that is to be seen of one instant, as plain values.

A `Moment` is made wherever poses come from (the live loop, a file) and read wherever they
are shown (windows, pages, pictures, panels). It holds no graphics, can be pickled, and is
never changed after it was made.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.model import build_model, tracker_site
from localreg.body.subject import Subject
from sensors.pose import TrackerFrame

TRAIL_SECONDS: Final = 0.7
"""How far back trails reach by default [s]."""

_FASTEST: Final = 15.0  # nobody's trackers all move faster: they are elsewhere [m/s]
_SLACK: Final = 0.3  # ... farther than this at once [m]
_TRAIL_POINTS: Final = 16  # of each trail; more cost drawing and show nothing
_NOTHING: Final = float("nan")


@dataclass(frozen=True, eq=False, slots=True)
class TrackerMoment:
    """One tracker at one instant: where it was measured, where the body has it.

    Attributes:
        name: of the tracker.
        position: measured, in the world [m]; means nothing without `has_position`.
        quaternion: measured, w x y z; means nothing without `has_orientation`.
        has_position: whether the position was measured.
        has_orientation: whether the orientation was measured.
        predicted_position: where the shown body carries it [m].
        predicted_quaternion: how the shown body turns it, w x y z.
        distance: between the positions [m]; NaN where not measured.
        angle: between the orientations [rad]; NaN where not measured.
        rate: reports a second [Hz]; NaN if unknown.
        age: of its newest report [s]; NaN if unknown.
    """

    name: str
    position: Float[ndarray, "3"]
    quaternion: Float[ndarray, "4"]
    has_position: bool
    has_orientation: bool
    predicted_position: Float[ndarray, "3"]
    predicted_quaternion: Float[ndarray, "4"]
    distance: float = _NOTHING
    angle: float = _NOTHING
    rate: float = _NOTHING
    age: float = _NOTHING

    @property
    def is_masked(self) -> bool:
        """Whether nothing of it was measured."""
        return not (self.has_position or self.has_orientation)

    @property
    def status(self) -> str:
        """In a word or two, for tables."""
        if self.has_position and self.has_orientation:
            return "measured"
        if self.has_position:
            return "position only"
        return "orientation only" if self.has_orientation else "masked"


@dataclass(frozen=True, slots=True)
class NeighborClip:
    """A clip that database neighbors of the moment come from.

    Attributes:
        name: of the clip.
        activity: what is done in it; empty if unknown.
        share: of the neighbors, 0 to 1.
    """

    name: str
    activity: str = ""
    share: float = _NOTHING


@dataclass(frozen=True, slots=True)
class Timing:
    """How the live loop keeps up.

    Attributes:
        p50: median time from the newest byte to the pose [s].
        p99: its 99th percentile [s].
        frames: taken so far.
        late_frames: of them, too late.
        compute_p50: median time spent on a pose [s].
        compute_p99: its 99th percentile [s].
    """

    p50: float = _NOTHING
    p99: float = _NOTHING
    frames: int = 0
    late_frames: int = 0
    compute_p50: float = _NOTHING
    compute_p99: float = _NOTHING


@dataclass(frozen=True, eq=False, slots=True)
class Moment:
    """Everything that scene and panels show of one instant.

    Attributes:
        time: of the frame, on whatever clock the source has [s].
        qpos: the body: root position [m], quaternion w x y z, joint angles [rad].
        index: number of the frame in its source.
        trackers: one entry a tracker, in the subject's order; empty for bare motions.
        ghost: another body to compare with, in the same layout, or None.
        ghost_name: what the ghost is, for example `"truth"` or `"best example"`.
        trails: paths of points over the last second or so, oldest first [m].
        confidence: 0 to 1, how well the database explains what is seen; NaN if unknown.
        neighbors: clips that the neighbors come from, most frequent first.
        timing: how the live loop keeps up; None for files.
        is_held: whether an earlier pose is shown again.
        is_start: whether the body was just found anew.
        title: what is being shown, for example a clip's name.
    """

    time: float
    qpos: Float[ndarray, "63"]
    index: int = 0
    trackers: tuple[TrackerMoment, ...] = ()
    ghost: Float[ndarray, "63"] | None = None
    ghost_name: str = ""
    trails: tuple[Float[ndarray, "points 3"], ...] = ()
    confidence: float = _NOTHING
    neighbors: tuple[NeighborClip, ...] = ()
    timing: Timing | None = None
    is_held: bool = False
    is_start: bool = False
    title: str = ""


@dataclass(frozen=True, slots=True)
class Heard:
    """How a tracker's reports come in.

    Attributes:
        rate: reports a second [Hz].
        age: of the newest [s].
    """

    rate: float = _NOTHING
    age: float = _NOTHING


class Observer:
    """Makes moments: asks the body where its trackers are, and remembers their trails.

    One call costs some ten microseconds, but do it in the view's thread all the same.

    Args:
        subject: whose body is shown, wearing the trackers of the frames.
        trail_seconds: how far back trails reach [s]; 0 for none.
        trail_of: trackers that leave trails; by default all the subject wears.
    """

    def __init__(
        self,
        subject: Subject,
        *,
        trail_seconds: float = TRAIL_SECONDS,
        trail_of: Sequence[str] | None = None,
    ) -> None:
        self.subject = subject
        self._model = build_model(subject)
        self._data = mujoco.MjData(self._model)
        self._sites = [self._model.site(tracker_site(name)).id for name in subject.trackers]
        wanted = subject.trackers if trail_of is None else trail_of
        self._trailing = [i for i, name in enumerate(subject.trackers) if name in wanted]
        self._trail_seconds = trail_seconds
        self._past: deque[tuple[float, Float[ndarray, "J 3"]]] = deque()

    def observe(
        self,
        time: float,
        qpos: Float[ndarray, "63"],
        frame: TrackerFrame | None = None,
        *,
        heard: Mapping[str, Heard] | None = None,
        is_start: bool = False,
    ) -> Moment:
        """The moment of a pose; whoever knows more of it adds that by `dataclasses.replace`.

        Args:
            time: of the frame; a step back, or a jump of the body, ends the trails [s].
            qpos: the body.
            frame: what the trackers said, in the subject's order; None if there are none.
            heard: how the reports of trackers come in, by name.
            is_start: whether the body was just found anew, which ends the trails.
        """
        self.pass_by(time, qpos, is_start=is_start)
        places = self._data.site_xpos[self._sites]
        trackers = () if frame is None else self._trackers(frame, places, heard or {})
        return Moment(
            time=time,
            qpos=np.array(qpos, dtype=float),
            trackers=trackers,
            trails=self._trails(),
            is_start=is_start,
        )

    def pass_by(self, time: float, qpos: Float[ndarray, "63"], *, is_start: bool = False) -> None:
        """Remember a pose for the trails that nobody looks at otherwise; see `observe`."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        self._remember(time, self._data.site_xpos[self._sites], jumped=is_start)

    def worn(self, time: float, qpos: Float[ndarray, "63"]) -> TrackerFrame:
        """What perfect trackers would say of a pose."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        quaternions = np.array([self._turned(site) for site in self._sites])
        seen = np.ones(len(self._sites), dtype=bool)
        return TrackerFrame(time, self._data.site_xpos[self._sites], quaternions, seen, seen)

    def forget(self) -> None:
        """Let trails begin anew."""
        self._past.clear()

    def _trackers(
        self, frame: TrackerFrame, places: Float[ndarray, "J 3"], heard: Mapping[str, Heard]
    ) -> tuple[TrackerMoment, ...]:
        moments = []
        for i, name in enumerate(self.subject.trackers):
            turned = self._turned(self._sites[i])
            has_position = bool(frame.position_mask[i])
            has_orientation = bool(frame.orientation_mask[i])
            distance = angle = _NOTHING
            if has_position:
                distance = float(np.linalg.norm(frame.positions[i] - places[i]))
            if has_orientation:
                cosine = min(1.0, abs(float(frame.quaternions[i] @ turned)))
                angle = 2.0 * math.acos(cosine)
            known = heard.get(name, Heard())
            moments.append(
                TrackerMoment(
                    name,
                    np.array(frame.positions[i], dtype=float),
                    np.array(frame.quaternions[i], dtype=float),
                    has_position,
                    has_orientation,
                    places[i].copy(),
                    turned,
                    distance,
                    angle,
                    known.rate,
                    known.age,
                )
            )
        return tuple(moments)

    def _turned(self, site: int) -> Float[ndarray, "4"]:
        quaternion = np.empty(4)
        mujoco.mju_mat2Quat(quaternion, self._data.site_xmat[site])
        return quaternion

    def _remember(self, time: float, places: Float[ndarray, "J 3"], *, jumped: bool) -> None:
        past = self._past
        if past and (jumped or time < past[-1][0]):
            past.clear()
        # A scrub forwards is a jump too, and so is the next clip: nobody went that way.
        if past and (time - past[-1][0] > self._trail_seconds or self._are_elsewhere(time, places)):
            past.clear()
        if self._trail_seconds > 0.0:
            past.append((time, places))
        while past and time - past[0][0] > self._trail_seconds:
            past.popleft()

    def _are_elsewhere(self, time: float, places: Float[ndarray, "J 3"]) -> bool:
        before, last = self._past[-1]
        moved = np.linalg.norm(places - last, axis=1).min(initial=np.inf)
        return bool(np.isfinite(moved) and moved > _FASTEST * (time - before) + _SLACK)

    def _trails(self) -> tuple[Float[ndarray, "points 3"], ...]:
        if len(self._past) < 2:
            return ()
        paths = np.array([places for _, places in self._past])
        # Counted from the newest, so that the points do not swim along the path.
        every = max(1, math.ceil(len(paths) / _TRAIL_POINTS))
        paths = paths[::-1][::every][::-1]
        return tuple(paths[:, i] for i in self._trailing)
