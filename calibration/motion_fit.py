"""Lengths, mounts and many poses of ordinary motion together: bundle adjustment.

Unknown are a person's lengths and mounts, what their every pose has in common that the database
does not know (a habit: how the head is held, how far the feet turn out), and the root and the
joint angles of every frame. They minimize

    |u - u_0|^2 in the metric of what was known before   (the eight holds)
    sum over frames and trackers of the Lorentzian of the whitened tracker errors
    sum over frames of |q_i - m_i - b|^2 in the metric of C_i, divided by `alike`
    |b|^2 / sigma_b^2

where m_i, C_i are the mean and covariance of the frame's neighbors in the database. Frames
touch the shared unknowns and their own alone, so each Gauss-Newton step eliminates them one by
one (Schur complement). In the end lengths and mounts go to where their own density is greatest,
whatever the poses are (`marginal`); without that necks came out 3 % too long. sigma_b is estimated
with the rest, as the errors of held poses are (see `fit`): where motion is like the database's,
poses say much about mounts.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from calibration.anthropometry import group_of_bone
from calibration.bundle import Bundle, MotionSettings, SeenFrames
from calibration.eigen_skeleton import lengths_of
from calibration.knowledge import Knowledge
from calibration.pose_prior import PosePriors
from localreg.body.subject import Mount, Subject

_ROUNDS: Final = 4


@dataclass(frozen=True, eq=False)
class MotionFit:
    """The end of a refinement.

    Attributes:
        subject: with better lengths and mounts; its record is the old one.
        knowledge: how well they are known.
        angles: joint angles of the frames [rad].
        habit: estimated standard deviation of what all frames err by [rad].
    """

    subject: Subject
    knowledge: Knowledge
    angles: Float[ndarray, "N 56"]
    habit: float


def fit_motion(
    subject: Subject,
    known: Knowledge,
    frames: SeenFrames,
    priors: PosePriors,
    settings: MotionSettings | None = None,
) -> MotionFit:
    """Lengths and mounts that agree with what was known and with many poses.

    Args:
        subject: as it was known.
        known: how well.
        frames: what was seen, and a first guess of the poses.
        priors: what poses the database knows near those, frame by frame.
        settings: beliefs.
    """
    settings = settings or MotionSettings()
    count = len(frames.qpos)
    frames = frames.padded()
    more = len(frames.qpos) - count
    whole = PosePriors(
        np.pad(priors.means, [(0, more), (0, 0)], mode="edge"),
        np.pad(priors.covariances, [(0, more), (0, 0), (0, 0)], mode="edge"),
    )
    bundle = Bundle(subject, known, frames, whole, settings)
    habit, at, s = settings.habit, bundle.first(frames, whole), len(bundle.before)
    at, normal = bundle.descend(at, habit)
    for _ in range(_ROUNDS):
        spread = np.trace(np.linalg.inv(normal.information())[s:, s:]) / habit**2
        determined = max(len(at.habit) - float(spread), 0.0)
        # Half a habit of the first belief keeps what nothing is known of from nought.
        squares = float(np.sum(at.habit**2)) + 0.5 * settings.habit**2
        habit = float(np.sqrt(squares / (determined + 0.5)))
        at, normal = bundle.descend(at, habit)
    at = bundle.to_marginal(at, normal)
    covariance = np.linalg.inv(bundle.normal(at, habit).information())
    found = bundle.outputs(at)
    ratios = np.asarray(found.lengths) / lengths_of(subject)
    worn = tuple(
        Mount(m.tracker, m.bone, tuple(place), tuple(turn))
        for m, place, turn in zip(
            subject.mounts,
            np.asarray(found.positions).tolist(),
            _unit(np.asarray(found.quaternions)).tolist(),
            strict=True,
        )
    )
    better = replace(subject, lengths=subject.lengths * ratios[group_of_bone()], mounts=worn)
    knowledge = Knowledge.of_shared(subject.trackers, covariance[:s, :s], bundle.derivatives(at))
    return MotionFit(better, knowledge, bundle.angles(at, whole)[:count], habit)


def _unit(quaternions: Float[ndarray, "J 4"]) -> Float[ndarray, "J 4"]:
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
