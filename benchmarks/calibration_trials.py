"""Simulated people who calibrate themselves, well or badly."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from calibration.calibrate import Outcome, calibrate
from calibration.eigen_skeleton import (
    SkeletonPrior,
    find_skeletons,
    learn,
    published_prior,
    stature,
)
from calibration.holds import Hold
from calibration.motion_mounts import apart
from calibration.poses import EIGHT_POSES, NAIVE_POSES, TargetPose, with_swapped
from calibration.result import nine_deviations, nine_lengths
from calibration.simulated import Habits, held, perform, random_person
from localreg.body.subject import Subject, canonical_subject

TRACKERS: Final = canonical_subject().mounts
USUAL: Final = "5 deg a joint"
"""How people hold poses who do what they can."""

_PER_JOINT: Final = float(np.radians(5.0 / np.sqrt(3.0)))
_PER_AXIS: Final = float(np.radians(5.0))


@dataclass(frozen=True, eq=False)
class Person:
    """Someone to calibrate.

    Attributes:
        name: the file that the lengths are from.
        lengths: true lengths [m].
        prior: the eigen-skeleton without that file.
        seed: of mounts, errors and noise.
    """

    name: str
    lengths: Float[ndarray, "18"]
    prior: SkeletonPrior
    seed: int


@dataclass(frozen=True, eq=False)
class Condition:
    """A way of calibrating.

    Attributes:
        name: for the table.
        habits: how well the person holds poses.
        poses: that are asked for.
        performed: that are done; the same but where one goes wrong.
        knows_height: whether the person's height is known to 1.5 cm.
    """

    name: str
    habits: Habits
    poses: Sequence[TargetPose] = EIGHT_POSES
    performed: Sequence[TargetPose] | None = None
    knows_height: bool = False


EXACT: Final = Condition("perfect poses", Habits(pose_error=1e-4, plant_error=3e-5))
"""Nobody holds poses so; what is wrong then is the solver's doing."""


def conditions() -> list[Condition]:
    """All that are compared."""
    wrong = list(EIGHT_POSES)
    wrong[1] = replace(wrong[1], other_angles=with_swapped(wrong[1].angles, "arms"))
    usual = Habits(pose_error=_PER_JOINT)
    return [
        EXACT,
        Condition(USUAL, usual),
        Condition("5 deg a joint, height known", usual, knows_height=True),
        Condition("arms swapped in one pose", usual, performed=wrong),
        Condition("5 deg about each axis", Habits(pose_error=_PER_AXIS)),
        Condition("naive poses", usual, poses=NAIVE_POSES),
        Condition("T-pose alone", usual, poses=EIGHT_POSES[:1]),
    ]


def draw_people(count: int, skeletons: Path | None) -> list[Person]:
    """People whose files the eigen-skeleton has not seen; files that are odd are no people."""
    if skeletons is None:
        prior = published_prior()
        rng = np.random.default_rng(0)
        drawn = rng.multivariate_normal(prior.mean, prior.covariance, count)
        return [Person("drawn", np.exp(row), prior, seed) for seed, row in enumerate(drawn)]
    found = find_skeletons(skeletons)
    names = [name for name in found if name not in learn(found).odd]
    priors = {
        name: learn({other: row for other, row in found.items() if other != name})
        for name in names[:count]
    }
    return [
        Person(name, found[name], priors[name], seed)
        for seed in range(count)
        for name in [names[seed % len(names)]]
    ]


@dataclass(frozen=True, eq=False)
class Trial:
    """One person under one condition.

    Attributes:
        error: relative error of each of the nine lengths.
        deviation: as reported.
        mount_error: distance of each mount from the truth [m].
        turn_error: the same of its turn [rad].
        outcome: all of it.
        person: with the true mounts.
        holds: what was recorded.
        seconds: that the fit took.
    """

    error: Float[ndarray, "9"]
    deviation: Float[ndarray, "9"]
    mount_error: Float[ndarray, " J"]
    turn_error: Float[ndarray, " J"]
    outcome: Outcome
    person: Subject
    holds: tuple[Hold, ...]
    seconds: float


def run_trial(person: Person, condition: Condition) -> Trial:
    """Strap on trackers, hold the poses, calibrate, compare."""
    rng = np.random.default_rng((person.seed, 1))
    habits = condition.habits
    body = random_person(person.lengths, TRACKERS, habits.mount_spread, rng)
    qpos = perform(body, condition.performed or condition.poses, habits, rng)
    holds = held(body, condition.poses, qpos, habits, rng)
    prior = person.prior
    if condition.knows_height:
        prior = prior.at_stature(stature(person.lengths) + rng.normal(0.0, 0.015))
    begin = time.perf_counter()
    outcome = calibrate(holds, TRACKERS, prior, poses=condition.poses)
    seconds = time.perf_counter() - begin
    result = outcome.result
    error = nine_lengths(result.groups) / nine_lengths(person.lengths) - 1.0
    pairs = zip(body.mounts, result.subject.mounts, strict=True)
    mounts, turns = np.array([apart(true, found) for true, found in pairs]).T
    return Trial(
        error,
        nine_deviations(result.groups, result.log_covariance),
        mounts,
        turns,
        outcome,
        body,
        tuple(holds),
        seconds,
    )
