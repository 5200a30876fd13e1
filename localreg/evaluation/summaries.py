"""What is worked out from the figures of all clips: by activity, by joint, against rivals."""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from localreg.body.skeleton import BODY_NAMES, DOF_NAMES
from localreg.evaluation.metrics import JOINTED_BONES, Figures, mean_figures
from localreg.evaluation.results import ClipResult, Evaluation, without_nan
from localreg.evaluation.statistics import LEVEL, Difference, paired_difference

COMPARED: Final = ("joint_angle_error_deg", "mpjpe_cm", "mpjpe_root_aligned_cm")
"""Figures of which differences between methods are examined."""

RIVALS: Final = ("ik", "ik-truth")
"""Methods that no clip should be worse than."""


@dataclass(frozen=True, slots=True)
class Extras:
    """Means over clips beyond the contract's figures, by method and signals.

    Attributes:
        standardized_error: errors in units of their predicted deviations; see `Comparison`.
        recovery_s: how long errors outlast dropouts [s].
        jitter_ratio: mean jitter over the truth's.
        foot_skate_excess_cm_s: mean foot skate beyond the truth's [cm/s].
    """

    standardized_error: float | None
    recovery_s: float | None
    jitter_ratio: float | None
    foot_skate_excess_cm_s: float | None


def extras(clips: Iterable[ClipResult]) -> Extras:
    """Figures beyond the contract's of one method with one kind of signals."""
    clips = list(clips)
    jitters = [(c.figures.jitter_m_s3, c.comparison.true_jitter_m_s3) for c in clips]
    skates = [(c.figures.foot_skate_cm_s, c.comparison.true_foot_skate_cm_s) for c in clips]
    jitter, true_jitter = _paired_means(jitters)
    skate, true_skate = _paired_means(skates)
    return Extras(
        standardized_error=_mean([c.comparison.standardized_error for c in clips]),
        recovery_s=_mean([c.recovery_s for c in clips]),
        jitter_ratio=None if not jitter or not true_jitter else jitter / true_jitter,
        foot_skate_excess_cm_s=(
            None if skate is None or true_skate is None else skate - true_skate
        ),
    )


def by_activity(evaluation: Evaluation, method: str, signals: str) -> dict[str, list[ClipResult]]:
    """A method's clips by what is done in them; `unknown` where nobody says."""
    groups: dict[str, list[ClipResult]] = {}
    for clip in evaluation.of(method, signals):
        groups.setdefault(clip.activity or "unknown", []).append(clip)
    return dict(sorted(groups.items()))


def by_kind(evaluation: Evaluation, method: str, signals: str) -> dict[str, list[ClipResult]]:
    """The same by kinds of activities: the words before a dash (`playground - climb, hang`)."""
    groups: dict[str, list[ClipResult]] = {}
    for activity, clips in by_activity(evaluation, method, signals).items():
        groups.setdefault(activity.split(" - ")[0], []).extend(clips)
    return groups


def by_joint(clips: Iterable[ClipResult]) -> dict[str, dict[str, float]]:
    """Means over clips by joint angle, by bone with joints, and by bone end."""
    clips = list(clips)
    parts = {
        "joint_angle_error_deg": (DOF_NAMES, "joint_angle_error_by_dof_deg"),
        "geodesic_error_deg": (JOINTED_BONES, "geodesic_error_by_bone_deg"),
        "position_error_cm": (BODY_NAMES, "position_error_by_end_cm"),
    }
    return {
        key: dict(
            zip(
                names,
                np.mean([getattr(c.comparison, field) for c in clips], axis=0).tolist(),
                strict=True,
            )
        )
        for key, (names, field) in parts.items()
    }


def difference(
    evaluation: Evaluation, method: str, other: str, signals: str, figure: str
) -> Difference:
    """One method's figure minus another's, paired over clips."""
    ours, theirs = (
        {clip.name: getattr(clip.figures, figure) for clip in evaluation.of(name, signals)}
        for name in (method, other)
    )
    names = [name for name in ours if name in theirs]
    return paired_difference([ours[n] for n in names], [theirs[n] for n in names])


def worse_than(
    evaluation: Evaluation, method: str, rival: str, signals: str
) -> list[tuple[str, float, float]]:
    """Clips whose joint angles the rival finds better: name, own and rival's error [deg]."""
    rivals = {clip.name: badness(clip.figures) for clip in evaluation.of(rival, signals)}
    return [
        (clip.name, badness(clip.figures), rivals[clip.name])
        for clip in evaluation.of(method, signals)
        if clip.name in rivals and badness(clip.figures) > rivals[clip.name]
    ]


def badness(figures: Figures) -> float:
    """The joint angle error; infinite for a method that broke down [deg]."""
    value = figures.joint_angle_error_deg
    return math.inf if value is None or math.isnan(value) else value


def to_json(evaluation: Evaluation) -> dict[str, Any]:
    """The contract's document with everything that is worked out here."""
    kinds = {method: tuple(means) for method, means in evaluation.means().items()}

    def table(cell: Any, methods: Iterable[str] = tuple(kinds)) -> dict[str, Any]:
        return {
            method: {signals: cell(method, signals) for signals in kinds[method]}
            for method in methods
        }

    first = evaluation.methods[0]
    rivals = [rival for rival in RIVALS if rival in kinds]
    more = {
        "more": table(lambda m, s: asdict(extras(evaluation.of(m, s)))),
        "per_activity": table(
            lambda m, s: {
                activity: {
                    "clips": len(clips),
                    **asdict(mean_figures([clip.figures for clip in clips])),
                }
                for activity, clips in by_activity(evaluation, m, s).items()
            }
        ),
        "per_joint": table(lambda m, s: by_joint(evaluation.of(m, s))),
        "differences": {
            "method": first,
            "level": LEVEL,
            "minus": table(
                lambda m, s: {
                    figure: asdict(difference(evaluation, first, m, s, figure))
                    for figure in COMPARED
                },
                [method for method in kinds if method != first],
            ),
        },
        "worse_than": {
            rival: table(
                lambda m, s, rival=rival: [n for n, _, _ in worse_than(evaluation, m, rival, s)],
                [method for method in kinds if method not in RIVALS],
            )
            for rival in rivals
        },
    }
    return {**evaluation.to_json(), **without_nan(more)}


def _paired_means(
    pairs: list[tuple[float | None, float | None]],
) -> tuple[float | None, float | None]:
    """Means over the clips that have both."""
    whole = [(a, b) for a, b in pairs if a is not None and b is not None]
    return _mean([a for a, _ in whole]), _mean([b for _, b in whole])


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
