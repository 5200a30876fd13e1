"""How far a synthesized motion is from the true one: the figures of every evaluation.

All are taken over the frames after the first `SETTLING_FRAMES`, in which a method may find
its way. Figures that need more than one frame, or contacts that are not there, are None
where they cannot be had. A pose that is not finite makes its figures NaN.
"""

from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from localreg.body.skeleton import BONES, DOF_NAMES
from localreg.evaluation.body_points import BodyPoints, Places
from localreg.motion.contacts import FOOT_ENDS, foot_contacts, velocities
from localreg.motion.motion import Motion

SETTLING_FRAMES: Final = 5
"""Frames at the start of a clip that count for nothing but time."""

JOINTED_BONES: Final = tuple(bone.name for bone in BONES if bone.dofs)
"""The bones that have joints, in the order of figures by bone."""

_ZYX: Final = np.array(
    [
        [DOF_NAMES.index(name) if (name := f"{bone}r{axis}") in DOF_NAMES else -1 for axis in "zyx"]
        for bone in JOINTED_BONES
    ]
)
"""Places of each bone's angles about z, y and x; -1 where it has no such hinge."""

_LEAST_FOR_JITTER: Final = 4


@dataclass(frozen=True, slots=True)
class Figures:
    """The figures of one clip, or their means over clips.

    Attributes:
        joint_angle_error_deg: |difference, wrapped|, mean over the 56 angles [deg].
        geodesic_error_deg: angle between true and synthesized turn of a bone against its
            parent, mean over the 28 bones that have joints [deg].
        mpjpe_cm: distance of the 31 bone ends in the world [cm].
        mpjpe_root_aligned_cm: distance of the 30 bone ends other than the root once the roots'
            positions are laid upon each other [cm]. Only the position is taken away, as is
            usual: heading and tilt of the root count. The figure to look at where no tracker
            measures positions, since nothing then says where in the room the body is.
        tracker_error_cm: distance of the synthesized from the noise-free trackers [cm].
        jitter_m_s3: norm of the third derivative of the 31 bone ends [m/s^3].
        foot_skate_cm_s: horizontal speed of synthesized foot ends while the true ones
            stand on the ground [cm/s].
    """

    joint_angle_error_deg: float | None = None
    geodesic_error_deg: float | None = None
    mpjpe_cm: float | None = None
    mpjpe_root_aligned_cm: float | None = None
    tracker_error_cm: float | None = None
    jitter_m_s3: float | None = None
    foot_skate_cm_s: float | None = None


FIGURES: Final = tuple(field.name for field in fields(Figures))
"""Names of the figures, in the order of every table."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """A synthesized clip against the truth.

    Attributes:
        figures: of the synthesized motion.
        true_jitter_m_s3: jitter of the truth, for comparison [m/s^3].
        true_foot_skate_cm_s: foot skate of the truth, which is not nought because feet
            roll off [cm/s].
        joint_angle_error_deg: mean over the angles, for every frame from the first [deg].
        mpjpe_cm: mean over the bone ends, for every frame from the first [cm].
        joint_angle_error_by_dof_deg: mean over the frames, for every angle [deg].
        geodesic_error_by_bone_deg: mean over the frames, for the 28 bones of
            `JOINTED_BONES` [deg].
        position_error_by_end_cm: mean over the frames, for the 31 bone ends [cm].
        standardized_error: root mean square of angle errors, each divided by the standard
            deviation that the method gave it: 1 for a method that knows its errors, more
            for one too sure of itself. None where it gave none.
    """

    figures: Figures
    true_jitter_m_s3: float | None
    true_foot_skate_cm_s: float | None
    joint_angle_error_deg: Float[ndarray, " frames"]
    mpjpe_cm: Float[ndarray, " frames"]
    joint_angle_error_by_dof_deg: Float[ndarray, "56"]
    geodesic_error_by_bone_deg: Float[ndarray, "28"]
    position_error_by_end_cm: Float[ndarray, "31"]
    standardized_error: float | None = None


def compare(
    truth: Motion,
    qpos: Float[ndarray, "frames 63"],
    *,
    body: BodyPoints | None = None,
    true_places: Places | None = None,
    predicted_sigma: Float[ndarray, "frames 56"] | None = None,
) -> Comparison:
    """Compare synthesized poses with the true ones of the same subject and frames.

    Args:
        truth: the true motion; its subject wears the trackers that count.
        qpos: one synthesized pose for every frame of it.
        body: the subject's body if it is at hand, else it is built.
        true_places: where the truth puts it if that is known, else it is worked out.
        predicted_sigma: standard deviation that the method gave each angle; not finite
            where it gave none [rad].

    Raises:
        ValueError: the numbers of frames differ.
    """
    if len(qpos) != len(truth):
        raise ValueError(f"{len(qpos)} poses cannot be compared with {len(truth)} frames")
    body = body or BodyPoints(truth.subject)
    finite = np.all(np.isfinite(qpos), axis=1)
    whole = np.where(finite[:, None], qpos, truth.qpos)
    blot = np.where(finite, 0.0, np.nan)
    places, true_places = body.places(whole), true_places or body.places(truth.qpos)
    true_ends = true_places.bone_ends
    ends = places.bone_ends + blot[:, None, None]
    by_dof = joint_angle_errors_deg(whole[:, 7:], truth.angles) + blot[:, None]
    angle_error = by_dof.mean(axis=1)
    by_end = 100.0 * np.linalg.norm(ends - true_ends, axis=-1)
    distance = by_end.mean(axis=1)
    counted = slice(SETTLING_FRAMES, None)
    contacts = foot_contacts(true_ends, truth.rate)[counted]
    apart = places.trackers.positions - true_places.trackers.positions
    tracker_error = np.linalg.norm(apart, axis=-1) + blot[:, None]
    geodesic = geodesic_errors_deg(whole[:, 7:], truth.angles) + blot[:, None]
    aligned = (ends - ends[:, :1]) - (true_ends - true_ends[:, :1])
    figures = Figures(
        joint_angle_error_deg=_mean(angle_error[counted]),
        geodesic_error_deg=_mean(geodesic[counted]),
        mpjpe_cm=_mean(distance[counted]),
        mpjpe_root_aligned_cm=_mean(100.0 * np.linalg.norm(aligned[counted, 1:], axis=-1)),
        tracker_error_cm=_mean(100.0 * tracker_error[counted]),
        jitter_m_s3=jitter_m_s3(ends[counted], truth.rate),
        foot_skate_cm_s=foot_skate_cm_s(ends[counted], contacts, truth.rate),
    )
    return Comparison(
        figures=figures,
        true_jitter_m_s3=jitter_m_s3(true_ends[counted], truth.rate),
        true_foot_skate_cm_s=foot_skate_cm_s(true_ends[counted], contacts, truth.rate),
        joint_angle_error_deg=angle_error,
        mpjpe_cm=distance,
        joint_angle_error_by_dof_deg=_column_means(by_dof[counted]),
        geodesic_error_by_bone_deg=_column_means(geodesic[counted]),
        position_error_by_end_cm=_column_means(by_end[counted]),
        standardized_error=(
            None
            if predicted_sigma is None
            else standardized_error(by_dof[counted], predicted_sigma[counted])
        ),
    )


def joint_angle_errors_deg(
    angles: Float[ndarray, "frames 56"], true_angles: Float[ndarray, "frames 56"]
) -> Float[ndarray, "frames 56"]:
    """|difference, wrapped to half a turn| of every joint angle [deg].

    Args:
        angles: synthesized joint angles [rad].
        true_angles: true joint angles [rad].
    """
    difference = (angles - true_angles + np.pi) % (2.0 * np.pi) - np.pi
    return np.degrees(np.abs(difference))


def geodesic_errors_deg(
    angles: Float[ndarray, "frames 56"], true_angles: Float[ndarray, "frames 56"]
) -> Float[ndarray, "frames 28"]:
    """Angle between the turns of a bone against its parent, for `JOINTED_BONES` [deg].

    The turn is R = C Rz Ry Rx C^T, whatever the axis frame C: it does not change the angle
    between two turns. Unlike differences of angles, the figure does not grow where two of the
    three axes nearly coincide.

    Args:
        angles: synthesized joint angles [rad].
        true_angles: true joint angles [rad].
    """
    turns, true_turns = _turns(angles), _turns(true_angles)
    # |p - q| = 2 sin(angle / 4) of unit quaternions, or |p + q|: exact near nought.
    chord = np.minimum(
        np.linalg.norm(turns - true_turns, axis=0), np.linalg.norm(turns + true_turns, axis=0)
    )
    return np.degrees(4.0 * np.arcsin(0.5 * chord))


def _turns(angles: Float[ndarray, "frames 56"]) -> Float[ndarray, "4 frames 28"]:
    """Rz Ry Rx of every bone that has joints, as quaternions w x y z."""
    # A last column of noughts stands for the hinges that a bone does not have.
    half = 0.5 * np.hstack([angles, np.zeros((len(angles), 1))])[:, _ZYX]
    (sz, sy, sx), (cz, cy, cx) = np.moveaxis(np.sin(half), 2, 0), np.moveaxis(np.cos(half), 2, 0)
    return np.stack(
        [
            cz * cy * cx + sz * sy * sx,
            cz * cy * sx - sz * sy * cx,
            cz * sy * cx + sz * cy * sx,
            sz * cy * cx - cz * sy * sx,
        ]
    )


def jitter_m_s3(points: Float[ndarray, "frames points 3"], rate: float) -> float | None:
    """Mean norm of the third derivative of points, by third differences [m/s^3].

    Args:
        points: positions [m].
        rate: frames a second [Hz].

    Returns:
        None for fewer than four frames.
    """
    if len(points) < _LEAST_FOR_JITTER:
        return None
    return _mean(np.linalg.norm(np.diff(points, n=3, axis=0), axis=-1) * rate**3)


def foot_skate_cm_s(
    bone_ends: Float[ndarray, "frames 31 3"],
    contacts: Bool[ndarray, "frames 4"],
    rate: float,
) -> float | None:
    """Mean horizontal speed of foot ends while they should stand [cm/s].

    Args:
        bone_ends: world positions of the 31 bone ends [m].
        contacts: which foot ends stand, as `foot_contacts` tells of the truth.
        rate: frames a second [Hz].

    Returns:
        None where nothing stands.
    """
    if len(bone_ends) < 2:
        return None
    speed = np.linalg.norm(velocities(bone_ends[:, FOOT_ENDS], rate)[..., :2], axis=-1)
    return _mean(100.0 * speed[contacts])


def standardized_error(
    errors_deg: Float[ndarray, "frames 56"], predicted_sigma: Float[ndarray, "frames 56"]
) -> float | None:
    """Root mean square of errors in units of their predicted standard deviations.

    Args:
        errors_deg: of the joint angles [deg].
        predicted_sigma: what the method expected of them; not finite where nothing [rad].

    Returns:
        None where nothing was expected.
    """
    expected = np.isfinite(predicted_sigma) & (predicted_sigma > 0.0)
    if not expected.any():
        return None
    ratios = np.radians(errors_deg[expected]) / predicted_sigma[expected]
    return float(np.sqrt(np.mean(ratios**2)))


def mean_figures(figures: list[Figures]) -> Figures:
    """Unweighted means over clips.

    A clip without a figure (no foot on the ground) does not count for it; one whose
    figure is not finite makes the mean so, lest a method gain by breaking down.
    """
    means: dict[str, float | None] = {}
    for name in FIGURES:
        values = [value for f in figures if (value := getattr(f, name)) is not None]
        means[name] = _mean(np.array(values))
    return Figures(**means)


def _column_means(values: Float[ndarray, "frames n"]) -> Float[ndarray, " n"]:
    return values.mean(axis=0) if len(values) else np.full(values.shape[1], np.nan)


def _mean(values: Float[ndarray, "..."]) -> float | None:
    return float(values.mean()) if values.size else None
