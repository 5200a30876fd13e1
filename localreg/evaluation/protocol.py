"""What is evaluated and how: methods, signals, start, and what is kept from the database."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from localreg.database import PoseDatabase
from localreg.errors import MotionError, SynthesisError
from localreg.evaluation.metrics import SETTLING_FRAMES
from localreg.evaluation.trackers import SIGNALS, TrackerQuality
from localreg.evaluation.variants import find_variant
from localreg.motion.motion import Motion

LEAVE_OUT: Final = ("clip", "subject", "activity")
"""What can be left out of the database with the clip that is the test."""

STARTS: Final = ("cold", "truth")
"""Where a method starts: from the first tracker frame alone, or from the true first pose."""

SHORTEST: Final = SETTLING_FRAMES + 4
"""Frames below which a clip is no test: too few remain for every figure."""


@dataclass(frozen=True, slots=True)
class Protocol:
    """The settings of an evaluation.

    Attributes:
        methods: names of methods or of their variants; see `variants`.
        signals: what the trackers measure, one evaluation for each; see `SIGNALS`.
        quality: how good the trackers are; its own `signals` is not looked at.
        trackers: names of the trackers worn; None for all that the subject has.
        start: one of `STARTS`.
        leave_out: one of `LEAVE_OUT`. None where the database is a training set of its
            own; copies of the test clip are kept from it even so.
        max_frames: only the first so many frames of each clip; None for all.
        seed: of the simulated noise; not negative.
        database_share: share of the database's clips that may be used, the others being
            left out at random; a smaller share is part of a larger one.
        keep_poses: whether results keep the synthesized poses.

    Raises:
        SynthesisError: a choice that does not exist.
    """

    methods: tuple[str, ...] = ("localreg", "paper", "lpcr", "lpca", "ik", "ik-truth")
    signals: tuple[str, ...] = SIGNALS
    quality: TrackerQuality = field(default_factory=TrackerQuality)
    trackers: tuple[str, ...] | None = None
    start: str = "cold"
    leave_out: Literal["clip", "subject", "activity"] | None = "clip"
    max_frames: int | None = None
    seed: int = 0
    database_share: float = 1.0
    keep_poses: bool = False

    def __post_init__(self) -> None:
        choices = (
            (self.signals, SIGNALS, "signals"),
            ((self.start,), STARTS, "start"),
            ((self.leave_out or "clip",), LEAVE_OUT, "leave-out"),
        )
        for values, known, what in choices:
            unknown = [value for value in values if value not in known]
            if unknown or not values:
                raise SynthesisError(
                    f"no {what} named {', '.join(unknown) or '(none given)'}; "
                    f"choose among {', '.join(known)}"
                )
        for values, what in ((self.methods, "method"), (self.signals, "signal")):
            if not values or len(set(values)) != len(values):
                raise SynthesisError(f"name every {what} once and at least one: {values}")
        for method in self.methods:
            find_variant(method)
        if not 0.0 < self.database_share <= 1.0:
            raise SynthesisError(
                f"{self.database_share} of a database cannot be used; give a share above 0, up to 1"
            )
        if self.seed < 0:
            raise SynthesisError(f"the seed is {self.seed}; give a number of 0 or more")
        if self.max_frames is not None and self.max_frames < SHORTEST:
            raise SynthesisError(
                f"{self.max_frames} frames are too few to evaluate, because the first "
                f"{SETTLING_FRAMES} do not count; give {SHORTEST} or more"
            )

    @property
    def needs_database(self) -> bool:
        """Whether any of the methods looks at the database."""
        return any(find_variant(method).needs_database for method in self.methods)


@dataclass(frozen=True, eq=False)
class Trial:
    """One test: a clip as it is played, and what must not be seen of the database.

    Attributes:
        motion: at the database's rate, its subject wearing the trackers that are used.
        left_out: numbers of the database's clips that are kept from the methods.
    """

    motion: Motion
    left_out: tuple[int, ...]

    def allowed(self, database: PoseDatabase) -> Bool[ndarray, " poses"]:
        """The poses that may be used."""
        return ~np.isin(database.clip_index, self.left_out)


def plan_trials(
    motions: Sequence[Motion], database: PoseDatabase, protocol: Protocol
) -> tuple[list[Trial], list[str]]:
    """The tests to run, and the names of the clips that are too short to be one.

    Args:
        motions: the test clips, whole and at any rate. Where clips are left out of the
            database by name (`protocol.leave_out` given), it was built from them.
        database: whose rate is that of the tests.
        protocol: the settings.

    Raises:
        MotionError: no clip is long enough, or one does not say what must be left out.
        SynthesisError: leaving out leaves nothing to learn from.
        SubjectError: a tracker that a subject does not wear.
    """
    trials, short = [], []
    for whole in motions:
        motion = whole.resampled(database.rate).nearest_to_rest()
        if protocol.max_frames is not None:
            motion = motion.first(protocol.max_frames)
        if len(motion) < SHORTEST:
            short.append(whole.provenance.name)
            continue
        if protocol.trackers is not None:
            subject = motion.subject.with_trackers(protocol.trackers)
            motion = replace(motion, subject=subject)
        trials.append(Trial(motion, _left_out(whole, database, protocol)))
    if not trials:
        raise MotionError(
            f"no clip has the {SHORTEST} frames that an evaluation needs; give longer ones"
        )
    return trials, short


def _left_out(motion: Motion, database: PoseDatabase, protocol: Protocol) -> tuple[int, ...]:
    made = motion.provenance
    if protocol.leave_out is None:
        allowed = database.exclude_motion(motion)
    elif protocol.leave_out == "clip":
        allowed = database.exclude(clip=made.name)
    else:
        value = getattr(made, protocol.leave_out)
        if not value:
            raise MotionError(
                f"clip {made.name} does not say its {protocol.leave_out}, so it cannot be left "
                "out by it; name it in an overrides file, or leave out by clip"
            )
        # The clip itself as well, for the copies of it that are filed elsewhere.
        allowed = database.exclude(**{protocol.leave_out: value})
        allowed &= database.exclude(clip=made.name)
    allowed = _share_of(allowed, database, protocol)
    if not allowed.any() and protocol.needs_database:
        what = protocol.leave_out or "clip"
        name = made.name if what == "clip" else getattr(made, what)
        raise SynthesisError(
            f"without {what} {name} nothing is left in the database to learn from; give more "
            "motions, or only methods without a database (ik)"
        )
    return tuple(np.unique(database.clip_index[~allowed]).tolist())


def _share_of(
    allowed: Bool[ndarray, " poses"], database: PoseDatabase, protocol: Protocol
) -> Bool[ndarray, " poses"]:
    """Of the poses that may be used, those of a share of the recordings; never none of some."""
    if protocol.database_share == 1.0:
        return allowed
    groups = np.array([clip.group for clip in database.clips])[database.clip_index]
    order = np.random.default_rng(protocol.seed).permutation(int(groups.max()) + 1)
    sizes = np.bincount(groups[allowed], minlength=len(order))[order]
    before = np.cumsum(sizes) - sizes
    return allowed & np.isin(groups, order[before < protocol.database_share * sizes.sum()])
