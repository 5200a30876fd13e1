"""What a calibration hands over: a subject, and how well each of its numbers is known."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.stats import norm

from calibration.anthropometry import (
    GROUP_COUNT,
    GROUPS,
    NINE_BONES,
    group_of_bone,
    length_of,
    rows_of,
)
from calibration.eigen_skeleton import SkeletonPrior, bone_lengths, subject_of
from calibration.fit import Fit, Session, log_length_covariance
from calibration.knowledge import Knowledge, derivatives
from calibration.model import TURN_UNIT
from calibration.solver import information_of, pose_information
from localreg.body.skeleton import BONE_NAMES
from localreg.body.subject import CalibrationRecord, Mount, Subject

REPORTED: Final[dict[str, tuple[str, ...]]] = {
    "thigh": ("femur",), "shank": ("tibia",), "back": NINE_BONES["back"],
    "neck": NINE_BONES["neck"], "head": ("head",), "clavicle": ("clavicle",),
    "upper arm": ("humerus",), "forearm": ("radius", "wrist"), "hand": ("hand",),
}  # fmt: skip
"""Lengths that people have names for, and the groups that make each."""

# Beliefs that stand in for none at all when asking what the trackers say by themselves.
_NO_LENGTH: Final = 0.5
_NO_MOUNT: Final = 10.0

QUANTILE_90: Final = float(norm.ppf(0.95))
"""Half width of the 90 % interval in standard deviations."""


@dataclass(frozen=True, slots=True)
class Length:
    """One reported length.

    Attributes:
        name: of `REPORTED`.
        value: [m].
        deviation: standard deviation [m].
        before: standard deviation among people, before anything was measured [m].
        told_by_trackers: share of what is known that the trackers tell by themselves, the
            rest being usual proportions; 0 to 1.
    """

    name: str
    value: float
    deviation: float
    before: float
    told_by_trackers: float

    @property
    def is_observable(self) -> bool:
        """Whether the trackers told more than half."""
        return self.told_by_trackers > 0.5


@dataclass(frozen=True, slots=True)
class MountEstimate:
    """One tracker's mount.

    Attributes:
        tracker: its name.
        bone: that it sits on.
        position_sd: standard deviations in the bone's frame [m].
        orientation_sd: standard deviations about the tracker's axes [rad].
        told_by_trackers: as for a length, for each axis of the position.
    """

    tracker: str
    bone: str
    position_sd: tuple[float, float, float]
    orientation_sd: tuple[float, float, float]
    told_by_trackers: tuple[float, float, float]

    @property
    def is_observable(self) -> tuple[bool, bool, bool]:
        """Along which axes of the bone the trackers told more than half."""
        x, y, z = (share > 0.5 for share in self.told_by_trackers)
        return x, y, z


@dataclass(frozen=True, eq=False)
class Calibration:
    """The end of a calibration.

    Attributes:
        subject: lengths and mounts, with a record of how well they are known.
        lengths: the lengths that people have names for.
        mounts: the trackers.
        log_covariance: of the logarithms of all lengths.
        groups: all lengths [m].
        pose_sigma: estimated error of a joint about each axis [rad].
        chi_square: of the fit, per degree of freedom.
        next_pose: the pose whose repetition would help most.
        knowledge: of lengths and mounts together.
    """

    subject: Subject
    lengths: tuple[Length, ...]
    mounts: tuple[MountEstimate, ...]
    log_covariance: Float[ndarray, "18 18"]
    groups: Float[ndarray, "18"]
    pose_sigma: float
    chi_square: float
    next_pose: str
    knowledge: Knowledge


def summarize(
    found: Fit,
    session: Session,
    prior: SkeletonPrior,
    *,
    name: str = "me",
    method: str = "eight poses",
    notes: Sequence[str] = (),
) -> Calibration:
    """Read a fit out.

    Args:
        found: the fit.
        session: what it was made from.
        prior: the eigen-skeleton it was made with.
        name: whose body.
        method: for the record.
        notes: what was amiss, for the record.
    """
    model, beliefs, start = found.problem.model, found.problem.beliefs, found.problem.start
    shared = jnp.asarray(found.x[: model.shared_size])
    outputs = model.outputs(shared, beliefs, start)
    groups = np.asarray(outputs.lengths)
    covariance = log_length_covariance(found)
    alone = _without_beliefs(found)
    D = np.asarray(jax.jacfwd(lambda s: model.outputs(s, beliefs, start).positions.ravel())(shared))
    J = model.tracker_count
    by_axis = np.einsum("as,st,at->a", D, found.posterior.shared, D)
    by_axis_alone = np.einsum("as,st,at->a", D, alone, D)
    position_sd = np.sqrt(by_axis).reshape(J, 3)
    shares = np.clip(by_axis / by_axis_alone, 0.0, 1.0).reshape(J, 3)
    turns = slice(GROUP_COUNT + 3 * J, GROUP_COUNT + 6 * J)
    orientation_sd = TURN_UNIT * np.sqrt(np.diag(found.posterior.shared)[turns]).reshape(J, 3)
    L = np.asarray(beliefs.root)
    log_alone = L @ alone[:GROUP_COUNT, :GROUP_COUNT] @ L.T
    lengths = tuple(
        _length(label, parts, groups, covariance, prior.covariance, log_alone)
        for label, parts in REPORTED.items()
    )
    chi_square = 2.0 * found.cost / degrees_of_freedom(found, session)
    mounts = tuple(
        MountEstimate(
            mount.tracker, mount.bone, three(position_sd[j]), three(orientation_sd[j]),
            three(shares[j]),
        )
        for j, mount in enumerate(session.trackers)
    )  # fmt: skip
    record = CalibrationRecord(
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        method=method,
        poses=tuple(h.pose for h, used in zip(session.holds, session.used, strict=True) if used),
        pose_error=found.pose_sigma,
        chi_square=chi_square,
        lengths_from=prior.sources,
        length_sd=bone_lengths(groups * np.sqrt(np.diag(covariance))),
        position_sd={m.tracker: m.position_sd for m in mounts},
        orientation_sd={m.tracker: m.orientation_sd for m in mounts},
        observable=observable_bones(lengths),
        notes=tuple(notes),
    )
    positions, quaternions = np.asarray(outputs.positions), np.asarray(outputs.quaternions)
    worn = tuple(
        Mount(m.tracker, m.bone, three(positions[j]), _four(quaternions[j]))
        for j, m in enumerate(session.trackers)
    )
    subject = replace(subject_of(name, groups), mounts=worn, calibration=record)
    return Calibration(
        subject, lengths, mounts, covariance, groups, found.pose_sigma, chi_square,
        next_pose(found, session), knowledge_of(found, session),
    )  # fmt: skip


def knowledge_of(found: Fit, session: Session) -> Knowledge:
    """What a fit knows of lengths and mounts together."""
    model, beliefs, start = found.problem.model, found.problem.beliefs, found.problem.start
    shared = found.x[: model.shared_size]
    own = model.shared_size - 6
    by_unknowns = derivatives(model, shared, beliefs, start)
    return Knowledge.of_shared(session.names, found.posterior.shared[:own, :own], by_unknowns)


def nine_lengths(groups: Float[ndarray, "18"]) -> Float[ndarray, "9"]:
    """The nine lengths that calibrations are compared by [m]."""
    return np.array([length_of(parts, groups) for parts in NINE_BONES.values()])


def nine_deviations(
    groups: Float[ndarray, "18"], log_covariance: Float[ndarray, "18 18"]
) -> Float[ndarray, "9"]:
    """Relative standard deviations of the nine lengths."""
    return np.array(
        [relative_deviation(parts, groups, log_covariance) for parts in NINE_BONES.values()]
    )


def relative_deviation(
    parts: Sequence[str], groups: Float[ndarray, "18"], log_covariance: Float[ndarray, "18 18"]
) -> float:
    """Standard deviation of a sum of lengths as a share of it."""
    rows = rows_of(parts)
    shares = groups[rows] / groups[rows].sum()
    return float(np.sqrt(shares @ log_covariance[np.ix_(rows, rows)] @ shares))


def degrees_of_freedom(found: Fit, session: Session) -> float:
    """Measurements less what is fitted freely: mounts' turns, roots and feet's spots."""
    holds = found.problem.holds
    measured = 3.0 * float(holds.position_weights.sum() + holds.orientation_weights.sum())
    planted = 3.0 * float(holds.planted.sum())
    free = 3.0 * len(session.trackers) + 6.0 * float(session.used.sum())
    free += 6.0 if planted else 0.0
    return max(measured + planted - free, 1.0)


def next_pose(found: Fit, session: Session) -> str:
    """The pose whose repetition would sharpen the nine lengths most."""
    information = information_of(found.linear)
    added = pose_information(np.asarray(found.linear.by_shared), np.asarray(found.linear.by_local))
    L = np.asarray(found.problem.beliefs.root)
    groups = np.exp(np.asarray(found.problem.beliefs.mean))
    worth = []
    for more in added:
        covariance = np.linalg.inv(information + more)[:GROUP_COUNT, :GROUP_COUNT]
        worth.append(np.sum(nine_deviations(groups, L @ covariance @ L.T) ** 2))
    return session.holds[int(np.argmin(worth))].pose


def _without_beliefs(found: Fit) -> Float[ndarray, "s s"]:
    """Covariance of the shared unknowns if lengths and mounts were as good as unknown."""
    information = information_of(found.linear)
    L = np.asarray(found.problem.beliefs.root)
    J = found.problem.model.tracker_count
    lengths, moved = slice(0, GROUP_COUNT), np.arange(GROUP_COUNT, GROUP_COUNT + 3 * J)
    information[lengths, lengths] += L.T @ L / _NO_LENGTH**2 - np.eye(GROUP_COUNT)
    information[moved, moved] += 1.0 / _NO_MOUNT**2 - 1.0
    return np.linalg.inv(information)


def _length(
    name: str,
    parts: tuple[str, ...],
    groups: Float[ndarray, "18"],
    after: Float[ndarray, "18 18"],
    before: Float[ndarray, "18 18"],
    alone: Float[ndarray, "18 18"],
) -> Length:
    value = length_of(parts, groups)
    deviation = relative_deviation(parts, groups, after)
    share = (deviation / relative_deviation(parts, groups, alone)) ** 2
    return Length(
        name,
        value,
        value * deviation,
        value * relative_deviation(parts, groups, before),
        float(np.clip(share, 0.0, 1.0)),
    )


def observable_bones(lengths: Sequence[Length]) -> tuple[str, ...]:
    """The bones of lengths that trackers tell."""
    told = {part for length in lengths if length.is_observable for part in REPORTED[length.name]}
    groups = group_of_bone()
    return tuple(
        name for name, group in zip(BONE_NAMES, groups, strict=True) if GROUPS[group] in told
    )


def three(values: Float[ndarray, "3"]) -> tuple[float, float, float]:
    """As a subject's file has it."""
    x, y, z = (float(value) for value in values)
    return x, y, z


def _four(values: Float[ndarray, "4"]) -> tuple[float, float, float, float]:
    w, x, y, z = (float(value) for value in values / np.linalg.norm(values))
    return w, x, y, z
