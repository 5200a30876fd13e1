"""Where frames come from: a configuration's devices, a recording, or a simulated person."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calibration.anthropometry import length_of
from calibration.eigen_skeleton import lengths_of
from calibration.performer import Performer, emulated
from calibration.poses import TargetPose
from calibration.result import REPORTED
from calibration.simulated import Habits, with_random_mounts
from calibration.walk import Walk
from localreg.body.subject import Mount, Subject, canonical_subject
from localreg.errors import LocalregError
from localreg.live.config import read_run_config
from localreg.live.config_files import find_config
from localreg.motion.motion import Motion
from localreg.motion.sources import read_sources
from sensors.config import SensorsConfig
from sensors.devices.is900 import Is900Config
from sensors.devices.replay import ReplayConfig
from sensors.tracker_input import TrackerInput


@dataclass(frozen=True, eq=False)
class Source:
    """A running stream of frames.

    Attributes:
        trackers: the devices, running.
        mounts: which tracker on which bone, in the order of the frames.
        performer: the person, if simulated.
        walked: recorded motions that a simulated person moves about by.
    """

    trackers: TrackerInput
    mounts: tuple[Mount, ...]
    performer: Performer | None = None
    walked: tuple[Motion, ...] = ()

    @property
    def truth(self) -> dict[str, float] | None:
        """True lengths by name [m], if the person is simulated."""
        return None if self.performer is None else true_lengths(self.performer.person)


def true_lengths(person: Subject) -> dict[str, float]:
    """The lengths of `REPORTED` of a person [m]."""
    groups = lengths_of(person)
    return {name: length_of(parts, groups) for name, parts in REPORTED.items()}


def tracker_mounts(names: Sequence[str], template: Subject | None = None) -> tuple[Mount, ...]:
    """Which bone each tracker is on.

    Args:
        names: the trackers, in the order of the frames.
        template: a subject whose trackers are worn; the default six otherwise.

    Raises:
        LocalregError: a tracker that nobody knows the bone of.
    """
    known = {m.tracker: m for m in (template or canonical_subject()).mounts}
    if unknown := [name for name in names if name not in known]:
        raise LocalregError(
            f"it is not known on which bone tracker {', '.join(unknown)} is; name the stations of "
            f"the devices among {', '.join(known)}, or give a subject that wears them as --template"
        )
    return tuple(known[name] for name in names)


@contextmanager
def configured(name: str, template: Subject | None = None) -> Iterator[Source]:
    """The devices of a configuration.

    Raises:
        LocalregError: the configuration cannot be used.
    """
    config = read_run_config(find_config(name))
    if config.emulator is not None:
        raise LocalregError(
            f"the configuration {name} plays motion on an emulator, which cannot hold poses; "
            "calibrate with --simulate sample instead"
        )
    mounts = tracker_mounts(config.trackers, template)
    with TrackerInput(config) as trackers:
        yield Source(trackers, mounts)


@contextmanager
def recorded(path: Path, template: Subject | None = None, speed: float = 4.0) -> Iterator[Source]:
    """A recording, played."""
    if not path.is_file():
        raise LocalregError(f"there is no recording {path}")
    trackers = TrackerInput(SensorsConfig(devices=(ReplayConfig(file=path, speed=speed),)))
    mounts = tracker_mounts(trackers.trackers, template)
    with trackers:
        yield Source(trackers, mounts)


@contextmanager
def simulated(
    motion: str,
    poses: Sequence[TargetPose],
    *,
    seed: int = 0,
    habits: Habits | None = None,
    mistakes: dict[str, TargetPose] | None = None,
    worn: Subject | None = None,
    walk_seconds: float = 0.0,
) -> Iterator[Source]:
    """A simulated person behind an emulated IS-900.

    Args:
        motion: a source of motions (`sample`, a file, a folder); its first subject's body.
        poses: that can be asked for.
        seed: of mounts, errors and noise.
        habits: how well poses are held.
        mistakes: for a pose's name the pose that is taken instead, the first time.
        worn: the person itself, mounts and all, instead of the motion's.
        walk_seconds: how much of the motions the person can do when asked to move about [s].

    Raises:
        LocalregError: there is no motion.
    """
    habits = habits or Habits()
    person = worn
    motions = read_sources([motion])[0] if worn is None or walk_seconds > 0.0 else []
    if person is None:
        body = motions[0].subject
        rng = np.random.default_rng(seed)
        defaults = canonical_subject().mounts
        person = with_random_mounts(replace(body, mounts=()), defaults, habits.mount_spread, rng)
    walked = _enough(motions, walk_seconds)
    walk = Walk.of(walked) if walked else None
    performer = Performer(person, poses, habits, seed, mistakes, walk)
    with emulated(performer, habits, seed) as emulator:
        stations = {name: number for number, name in enumerate(person.trackers, start=1)}
        config = SensorsConfig(devices=(Is900Config(port=emulator.address, stations=stations),))
        with TrackerInput(config) as trackers:
            yield Source(trackers, tracker_mounts(person.trackers, person), performer, walked)


def _enough(motions: Sequence[Motion], seconds: float) -> tuple[Motion, ...]:
    """The first motions that last so long together."""
    chosen: list[Motion] = []
    for motion in motions:
        if sum(m.seconds for m in chosen) >= seconds:
            break
        if len(motion) > 1:
            chosen.append(motion)
    return tuple(chosen)
