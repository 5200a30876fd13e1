"""What is wrong before any fit: units, exchanged trackers, poses that are others.

All of it shows in where the trackers are relative to each other, so nothing needs to be
known of mounts: the average person in the pose asked for is laid upon the trackers, and what
remains is compared with what would remain under every other explanation.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import permutations
from typing import Any, Final

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from calibration.eigen_skeleton import SkeletonPrior, average_subject
from calibration.fit import Session, align, default_mounts, robust_mean
from calibration.holds import Hold
from calibration.poses import TargetPose, mirrored, with_swapped
from localreg.body.skeleton import BODY_NAMES
from localreg.body.subject import Mount
from localreg.evaluation.body_points import BodyPoints

UNITS: Final = {
    "meters": 1.0, "centimeters": 100.0, "millimeters": 1000.0, "inches": 39.3701, "feet": 3.28084,
}  # fmt: skip
"""How many of each are a meter."""

_UNIT_TOLERANCE: Final = 1.45
_USUAL: Final = 0.10
"""What remains of positions if all is well: errors of poses, proportions, mounts [m]."""

_USUAL_TURN: Final = np.radians(15.0)
_CAP: Final = 9.0
_CLEARLY: Final = 0.6
_WRONG: Final = 0.16
_LOST: Final = 0.40
_ASTRAY: Final = 0.30
_MOST_PERMUTED: Final = 7


class Kind(Enum):
    """What a finding is about."""

    UNITS = "units"
    EXCHANGED = "exchanged trackers"
    WRONG_POSE = "wrong pose"
    MISPLACED = "misplaced tracker"
    SLIPPED = "slipped tracker"
    UNSEEN = "unseen tracker"


@dataclass(frozen=True, slots=True)
class Finding:
    """Something amiss, in a sentence that says what to do.

    Attributes:
        kind: what it is about.
        text: the sentence.
        poses: names of the poses to repeat.
        trackers: names of the trackers concerned.
        is_fatal: whether no result can be had.
    """

    kind: Kind
    text: str
    poses: tuple[str, ...] = ()
    trackers: tuple[str, ...] = ()
    is_fatal: bool = False


@dataclass(frozen=True, eq=False)
class Expectation:
    """The average person's trackers in every pose, and in every misunderstanding of it.

    Attributes:
        explanations: for every pose what it may be instead, in words; the first is the pose.
        positions: of the trackers, for every pose one set an explanation [m].
        quaternions: of the trackers' bones in the pose asked for.
        ends: of all bones in the pose asked for [m].
    """

    explanations: tuple[tuple[str, ...], ...]
    positions: tuple[Float[ndarray, "V J 3"], ...]
    quaternions: Float[ndarray, "N J 4"]
    ends: Float[ndarray, "N 31 3"]

    @classmethod
    def of(cls, session: Session, prior: SkeletonPrior) -> "Expectation":
        """What to expect of a session."""
        average = average_subject(prior)
        points = BodyPoints(replace(average, mounts=default_mounts(average, session.trackers)))
        pairs = [_misunderstood(pose, session.poses, points) for pose in session.poses]
        asked = np.array([pose.qpos() for pose in session.poses])
        return cls(
            tuple(explanations for explanations, _ in pairs),
            tuple(positions for _, positions in pairs),
            points.tracker_poses(asked).quaternions,
            points.bone_ends(asked),
        )


def _misunderstood(
    pose: TargetPose, others: Sequence[TargetPose], points: BodyPoints
) -> tuple[tuple[str, ...], Float[ndarray, "V J 3"]]:
    """What a pose may be instead, in words, and where the trackers would be then [m]."""
    choices = {
        "": pose.angles,
        "left and right exchanged": mirrored(pose.angles),
        "the arms exchanged": with_swapped(pose.angles, "arms"),
        "the legs exchanged": with_swapped(pose.angles, "legs"),
    }
    for other in others:
        if other.name != pose.name:
            choices[f"pose {other.name}"] = other.angles
    qpos = np.repeat(pose.qpos()[None], len(choices), axis=0)
    qpos[:, 7:] = np.array(list(choices.values()))
    return tuple(choices), points.tracker_poses(qpos).positions


def screen(session: Session, prior: SkeletonPrior) -> tuple[Session, list[Finding]]:
    """Find what is plainly wrong, and what is left to fit.

    Returns:
        The session without the poses that are wrong, every tracker on the bone that it
        really is on, and what was found; nothing to fit if one of them is fatal.
    """
    unseen = _unseen(session)
    expected = Expectation.of(session, prior)
    scale, unit = _scale(session, expected)
    if unit is not None:
        return session, [*unseen, unit]
    session, exchanged = _assign(session, expected, scale)
    if exchanged:
        expected = Expectation.of(session, prior)
    astray = _astray(session, expected, scale)
    for finding in astray:
        row = session.names.index(finding.trackers[0])
        seen = session.seen.copy()
        seen[:, row] = False
        session = replace(session, seen=seen)
    session, wrong = _wrong_poses(session, expected, scale)
    return session, [*unseen, *exchanged, *astray, *wrong]


def _unseen(session: Session) -> list[Finding]:
    findings = []
    for j, name in enumerate(session.names):
        without = tuple(h.pose for h in session.holds if not h.position_mask[j])
        if without:
            findings.append(
                Finding(
                    Kind.UNSEEN,
                    f"tracker {name} was not seen in {_list(without)}; see that it is on and not "
                    "hidden, and repeat",
                    without,
                    (name,),
                )
            )
    return findings


def _there(session: Session, i: int) -> Bool[ndarray, " J"]:
    return session.holds[i].position_mask & session.seen[i]


def _scale(session: Session, expected: Expectation) -> tuple[float, Finding | None]:
    """How much larger the person is than the average, or in which unit they are measured."""
    ratios = []
    for i, hold in enumerate(session.holds):
        there = _there(session, i)
        if there.sum() > 2:
            a, b = hold.positions[there], expected.positions[i][0][there]
            ratios.append(_size(a) / max(_size(b), 1e-9))
    ratio = float(np.median(ratios)) if ratios else 1.0
    if ratio < 1e-6:
        text = "all trackers report the same place; see that the device tracks"
        return ratio, Finding(Kind.UNITS, text, is_fatal=True)
    unit = min(UNITS, key=lambda name: abs(np.log(ratio / UNITS[name])))
    if max(ratio / UNITS[unit], UNITS[unit] / ratio) > _UNIT_TOLERANCE:
        text = (
            f"the trackers are {ratio:.2g} times as far apart as on a person; see that "
            "positions are in meters and that the pose is the one shown"
        )
        return ratio, Finding(Kind.UNITS, text, is_fatal=True)
    if unit != "meters":
        text = f"positions are in {unit}, not in meters; set the unit of the device's driver"
        return ratio, Finding(Kind.UNITS, text, is_fatal=True)
    return ratio, None


def _size(points: Float[ndarray, "n 3"]) -> float:
    return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))


def _assign(session: Session, expected: Expectation, scale: float) -> tuple[Session, list[Finding]]:
    """Which tracker is on which bone, by all poses together."""
    J = len(session.trackers)
    whole = [i for i in range(len(session.holds)) if session.used[i] and _there(session, i).all()]
    if not whole or J < 4:
        return session, []
    orders = _orders(J)
    costs = np.zeros(len(orders))
    for i in whole:
        left = _residuals(session.holds[i].positions, scale * expected.positions[i][0][orders])
        costs += np.minimum((left / _USUAL) ** 2, _CAP)
    costs /= len(whole)
    promising = np.unique([0, *np.argsort(costs)[:6]])
    totals = {
        int(k): costs[k] + _turn_cost(session, expected, scale, orders[k], whole) for k in promising
    }
    best = min(totals, key=lambda k: totals[k])
    if best == 0 or totals[best] > _CLEARLY * totals[0]:
        return session, []
    order = orders[best]
    # Bones stay in their places and trackers move, so that nothing has to be compiled anew.
    sits = np.argsort(order)
    trackers = tuple(
        Mount(session.trackers[k].tracker, m.bone, (0.0, 0.0, 0.0))
        for k, m in zip(sits, session.trackers, strict=True)
    )
    moved = tuple(
        m.tracker
        for m, now in zip(session.trackers, order, strict=True)
        if m.bone != session.trackers[now].bone
    )
    where = _list([f"{m.tracker} on {m.bone}" for m in trackers if m.tracker in moved])
    text = (
        f"trackers {_list(moved)} are exchanged: {where}; the subject has them where they are, "
        "or put them right and begin again"
    )
    holds = tuple(hold.with_order(sits) for hold in session.holds)
    put_right = replace(session, trackers=trackers, holds=holds, seen=session.seen[:, sits])
    return put_right, [Finding(Kind.EXCHANGED, text, (), moved)]


def _orders(count: int) -> Any:
    """Assignments of trackers to bones, the intended one first."""
    if count <= _MOST_PERMUTED:
        return np.array(list(permutations(range(count))))
    orders = [np.arange(count)]
    for a in range(count):
        for b in range(a + 1, count):
            order = np.arange(count)
            order[[a, b]] = b, a
            orders.append(order)
    return np.array(orders)


def _residuals(
    measured: Float[ndarray, "J 3"], predicted: Float[ndarray, "V J 3"]
) -> Float[ndarray, " V"]:
    """What remains of each prediction laid upon the measurement [m]."""
    a = predicted - predicted.mean(axis=1, keepdims=True)
    b = measured - measured.mean(axis=0)
    cross = np.einsum("ja,vjb->vab", b, a)
    singular = np.linalg.svd(cross, compute_uv=False)
    singular[:, 2] *= np.sign(np.linalg.det(cross))
    squares = np.sum(a**2, axis=(1, 2)) + np.sum(b**2) - 2.0 * singular.sum(axis=1)
    return np.sqrt(np.maximum(squares, 0.0) / len(measured))


def _turn_cost(
    session: Session, expected: Expectation, scale: float, order: Any, whole: Sequence[int]
) -> float:
    """How much the trackers' mounts turn from pose to pose, if they are on these bones."""
    turns: list[list[Rotation]] = [[] for _ in session.trackers]
    for i in whole:
        hold = session.holds[i]
        predicted = scale * expected.positions[i][0][order]
        R, _, _ = align(predicted, hold.positions, hold.position_mask)
        for j, there in enumerate(hold.orientation_mask):
            if there:
                bone = Rotation.from_quat(expected.quaternions[i, order[j]], scalar_first=True)
                measured = Rotation.from_quat(hold.quaternions[j], scalar_first=True)
                turns[j].append((R * bone).inv() * measured)
    costs = []
    for found in turns:
        if len(found) > 1:
            apart = (robust_mean(found).inv() * Rotation.concatenate(found)).magnitude()
            costs.append(np.minimum((apart / _USUAL_TURN) ** 2, _CAP).mean())
    return float(np.mean(costs)) if costs else 0.0


def _astray(session: Session, expected: Expectation, scale: float) -> list[Finding]:
    """A tracker that is nowhere near its bone while all others are near theirs."""
    J = len(session.trackers)
    if J < 5:
        return []
    whole = [i for i in range(len(session.holds)) if _there(session, i).all()]
    if len(whole) < 2:
        return []
    off, rest = np.zeros((J, len(whole))), np.zeros((J, len(whole)))
    for column, i in enumerate(whole):
        measured, predicted = session.holds[i].positions, scale * expected.positions[i][0]
        for j in range(J):
            others = np.arange(J) != j
            R, t, rest[j, column] = align(predicted, measured, others)
            off[j, column] = np.linalg.norm(R.apply(predicted[j]) + t - measured[j])
    middle = np.median(off, axis=1)
    j = int(np.argmax(middle))
    others_fit = np.median(rest, axis=1)
    if middle[j] < _ASTRAY or others_fit[j] > _CLEARLY * np.median(np.delete(others_fit, j)):
        return []
    bone = _nearest_bone(session, expected, scale, j, whole)
    name = session.names[j]
    text = (
        f"tracker {name} is not on {session.trackers[j].bone} but most likely near {bone}; the "
        "result leaves it out: put it right and begin again"
    )
    return [Finding(Kind.MISPLACED, text, (), (name,))]


def _nearest_bone(
    session: Session, expected: Expectation, scale: float, j: int, whole: Sequence[int]
) -> str:
    others = np.arange(len(session.trackers)) != j
    off = np.zeros(len(BODY_NAMES))
    for i in whole:
        measured = session.holds[i].positions
        R, t, _ = align(scale * expected.positions[i][0], measured, others)
        ends = R.apply(scale * expected.ends[i]) + t
        off += np.minimum(np.linalg.norm(ends - measured[j], axis=1), 0.5)
    return BODY_NAMES[int(np.argmin(off))]


def _wrong_poses(
    session: Session, expected: Expectation, scale: float
) -> tuple[Session, list[Finding]]:
    findings = []
    for i, hold in enumerate(session.holds):
        there = _there(session, i)
        if not session.used[i] or there.sum() < 4:
            continue
        left = _residuals(hold.positions[there], scale * expected.positions[i][:, there])
        text = _explained(hold.pose, expected.explanations[i], left)
        if not text:
            continue
        text += "; it is left out: repeat it"
        findings.append(Finding(Kind.WRONG_POSE, text, (hold.pose,)))
        session = session.without_pose(i)
    return session, findings


def _list(names: Sequence[str]) -> str:
    return ", ".join(names[:-1]) + (" and " if len(names) > 1 else "") + names[-1]


class PoseJudge:
    """Looks at single holds while the person is still there to repeat them.

    Args:
        poses: all that are asked for.
        trackers: which tracker on which bone.
        prior: the eigen-skeleton.
    """

    def __init__(
        self, poses: Sequence[TargetPose], trackers: tuple[Mount, ...], prior: SkeletonPrior
    ) -> None:
        average = average_subject(prior)
        points = BodyPoints(replace(average, mounts=default_mounts(average, trackers)))
        self._expected = {pose.name: _misunderstood(pose, poses, points) for pose in poses}

    def judge(self, hold: Hold) -> str:
        """What is plainly wrong with a hold; empty if nothing is."""
        there = hold.position_mask
        if there.sum() < 4:
            return ""
        explanations, positions = self._expected[hold.pose]
        predicted = positions[:, there]
        ratio = _size(hold.positions[there]) / max(_size(predicted[0]), 1e-9)
        # A person may be larger or smaller; another unit is for the whole session to find.
        scale = float(np.clip(ratio, 0.8, 1.25)) if 0.5 < ratio < 2.0 else ratio
        left = _residuals(hold.positions[there], scale * predicted) / scale
        return _explained(hold.pose, explanations, left)


def _explained(pose: str, explanations: Sequence[str], left: Float[ndarray, " V"]) -> str:
    best = int(np.argmin(left))
    if left[0] > _WRONG and left[best] < _CLEARLY * left[0]:
        how = "as" if explanations[best].startswith("pose") else "with"
        return f"pose {pose} was done {how} {explanations[best]}"
    return f"pose {pose} is not the one shown" if left[0] > _LOST else ""
