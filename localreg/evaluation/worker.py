"""One process's share of an evaluation: trials one after another."""

from dataclasses import replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from localreg.body.subject import Subject
from localreg.database import PoseDatabase
from localreg.errors import SynthesisError
from localreg.evaluation.body_points import BodyPoints
from localreg.evaluation.metrics import compare
from localreg.evaluation.playback import Playback, play, warm_up
from localreg.evaluation.protocol import Protocol, Trial
from localreg.evaluation.recovery import recovery_s
from localreg.evaluation.results import ClipResult
from localreg.evaluation.trackers import SimulatedTrackers, simulate_trackers
from localreg.evaluation.variants import Variant, find_variant
from localreg.synthesis.estimator import AnyEstimator
from localreg.synthesis.methods import build_estimator, build_synthesizer

_MOST_KEPT: Final = 7
_POSES_KEPT: Final = 300_000  # about 150 MB a method


class Worker:
    """Runs trials one after another and keeps what the next one can use.

    Args:
        database: what the methods learn from.
    """

    def __init__(self, database: PoseDatabase) -> None:
        self._database = database
        self._subject: Subject | None = None
        self._body: BodyPoints | None = None
        # By variant and by what is left out, the last used at the end.
        self._estimators: dict[tuple[str, tuple[int, ...]], AnyEstimator] = {}

    def run(self, trial: Trial, protocol: Protocol) -> list[ClipResult]:
        """All methods with all signals on one clip.

        Raises:
            SynthesisError: a method cannot work with these trackers; names the clip.
        """
        motion = trial.motion
        body = self._body_of(motion.subject)
        truth = body.places(motion.qpos)
        results = []
        for signals in protocol.signals:
            quality = replace(protocol.quality, signals=signals)
            trackers = simulate_trackers(motion, quality, seed=protocol.seed, truth=truth.trackers)
            there = np.all(trackers.position_mask | trackers.orientation_mask, axis=1)
            for method in protocol.methods:
                variant = find_variant(method)
                is_given_truth = variant.is_given_truth or protocol.start == "truth"
                try:
                    estimator = self._estimator(variant, trial, trackers)
                    start = motion.qpos[0] if is_given_truth else None
                    playback = play(estimator, trackers, true_start=start)
                except SynthesisError as error:
                    raise SynthesisError(
                        f"{method} on clip {motion.provenance.name}: {error}"
                    ) from error
                sigma = _predicted_sigma(playback)
                comparison = compare(
                    motion, playback.qpos, body=body, true_places=truth, predicted_sigma=sigma
                )
                results.append(
                    ClipResult(
                        name=motion.provenance.name,
                        frames=len(motion),
                        method=method,
                        signals=signals,
                        comparison=comparison,
                        step_ms=playback.step_ms,
                        subject=motion.provenance.subject,
                        activity=motion.provenance.activity,
                        recovery_s=recovery_s(comparison.mpjpe_cm, there, motion.rate),
                        qpos=playback.qpos.astype(np.float32) if protocol.keep_poses else None,
                    )
                )
        return results

    def _body_of(self, subject: Subject) -> BodyPoints:
        """The subject's body; with another one, estimators have to be built anew."""
        if self._body is None or self._subject is None or not is_same(self._subject, subject):
            self._subject, self._body = subject, BodyPoints(subject)
            self._estimators = {}
        return self._body

    def _estimator(
        self, variant: Variant, trial: Trial, trackers: SimulatedTrackers
    ) -> AnyEstimator:
        """The method with the trial's clips masked from its database."""
        key = variant.estimator, trial.left_out if variant.needs_database else ()
        known = self._estimators.pop(key, None)
        if known is None:
            alike = [one for (name, _), one in self._estimators.items() if name == key[0]]
            allowed = trial.allowed(self._database) if variant.needs_database else None
            if alike and allowed is not None:
                known = alike[-1].leave_out(allowed)
            else:
                known = self._build(variant, trial.motion.subject, allowed)
                warm_up(known, trackers)
            # Each keeps a copy of the poses to search; a series comes back to its few clips.
            others = [other for other in self._estimators if other[0] == key[0]]
            for old in others[: -_kept(self._database)]:
                del self._estimators[old]
        self._estimators[key] = known
        return known

    def _build(
        self, variant: Variant, subject: Subject, allowed: Bool[ndarray, " poses"] | None
    ) -> AnyEstimator:
        if not variant.is_plain:
            return build_synthesizer(variant.settings, subject, self._database, allowed)
        return build_estimator(variant.method, subject, self._database, allowed)


def _kept(database: PoseDatabase) -> int:
    """How many estimators of a method are kept for other clips: fewer of large databases."""
    return max(1, min(_MOST_KEPT, _POSES_KEPT // len(database)))


def is_same(one: Subject, other: Subject) -> bool:
    """Whether an estimator for one person serves the other."""
    return one is other or (one.mounts == other.mounts and one.same_proportions(other))


def _predicted_sigma(playback: Playback) -> Float[ndarray, "frames 56"]:
    """What the method expected of its errors; nothing of a first pose that it was given."""
    sigma = np.full((len(playback.qpos), 56), np.nan)
    sigma[len(sigma) - len(playback.poses) :] = [pose.predicted_sigma for pose in playback.poses]
    return sigma
