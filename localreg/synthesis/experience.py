"""What the database teaches about its own predictions: how far to trust them, and when.

A regression's own residuals say little about motion that the database lacks: neighbours
from one clip agree with each other and not with the stranger. So poses of the database are
predicted as if their clip, with all its copies, were missing. Of these predictions are
learned, once for an estimator:

* how much of what is predicted to believe, for every output: of what the trackers fix all,
  while a foot beyond the last tracker leans on the mean of its neighbours;
* how errors, with all their correlations, grow with the distance of the neighbours, which
  is what makes a prior modest on unfamiliar motion and firm on familiar one;
* how far reconstructed joint angles are off once the trackers have been heard, which is the
  noise of the inputs that past poses are.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.chain import Chain, blank_placed, place, tracker_jacobian
from localreg.body.skeleton import DOF_COUNT, TANGENT_SIZE
from localreg.database.features import FeatureLayout
from localreg.database.neighbours import Query
from localreg.synthesis.examples import ExampleSource
from localreg.synthesis.halves import Measured
from localreg.synthesis.rehearsal import Past, Rehearsal, rehearse, rows_to_rehearse
from localreg.synthesis.settings import Settings
from localreg.synthesis.windows import Inputs, Steps, Windows, inputs, steps

_NEAREST: Final = 0.05  # squared distances below this are not told apart
_FIRST_LOOK: Final = 100  # predictions that the noise of past poses is first learned from
_STILL: Final = np.radians(0.2)  # angles expected to err less say nothing of caution
_LEAST_NOISE: Final = np.radians(0.5)


@dataclass(frozen=True, eq=False)
class Experience:
    """What has been learned, and the regressions' inputs and outputs that go with it.

    Attributes:
        pose: inputs of the pose regression.
        step: inputs of the step regression.
        steps: the step into every pose.
        pose_share: how much of each joint angle's predicted deviation is believed.
        step_share: the same of each tangent coordinate of the step.
        pose_growth: covariance of the pose's errors per squared distance [rad^2].
        step_growth: covariance of the step's errors per squared distance; root translation
            in the root's axes.
        caution: how large errors of the pose regression are in units of what is predicted.
        usual: the squared distance that nine in ten database poses keep from their
            neighbours.
        feature_share: what each feature column adds to a squared distance on average.
        history_share: the same of each lag of the past.
        trust: in each feature column where all is measured that was in rehearsal.
    """

    pose: Inputs
    step: Inputs
    steps: Steps
    pose_share: Float[ndarray, "56"]
    step_share: Float[ndarray, "62"]
    pose_growth: Float[ndarray, "56 56"]
    step_growth: Float[ndarray, "62 62"]
    caution: float
    usual: float
    feature_share: Float[ndarray, " f"]
    history_share: Float[ndarray, " m"]
    trust: Float[ndarray, " f"]

    def as_rehearsed(self, query: Query) -> Query:
        """A query whose trust in features is relative to that of rehearsal.

        What a reference tracker's predicted orientation does to them was rehearsed, too.
        """
        trust = np.zeros_like(self.trust)
        np.divide(query.feature_trust, self.trust, out=trust, where=self.trust > 0.0)
        return query._replace(feature_trust=trust)

    def whole_distance(
        self,
        squared_distance: float,
        history_valid: Bool[ndarray, " m"],
        feature_trust: Float[ndarray, " f"],
    ) -> float:
        """A squared distance as if everything had been known that was in rehearsal."""
        known = self.feature_share @ np.square(feature_trust) + self.history_share @ history_valid
        whole = self.feature_share.sum() + self.history_share.sum()
        return squared_distance * whole / known if known > 0.0 else np.inf


def learn(
    source: ExampleSource,
    settings: Settings,
    feature_noise: Float[ndarray, " f"],
    chain: Chain,
) -> Experience:
    """Rehearse on the database that a source may use."""
    database, targets = source.database, source.targets
    history = settings.history
    noise = np.full(history * DOF_COUNT, settings.step_noise)
    step = inputs(Windows.of(database, history), targets, noise, settings.components)
    everything = Measured(np.ones(len(feature_noise)), np.ones(6, dtype=bool), 0, turns=False)
    found = _learn(
        source, settings, feature_noise, chain, everything, step, steps(database, targets)
    )
    return replace(found, pose=found.pose.worked_out(targets), step=found.step.worked_out(targets))


def learn_half(
    whole: Experience, source: ExampleSource, settings: Settings, chain: Chain, measured: Measured
) -> Experience:
    """Rehearse once more with half of the signals.

    Inputs of the pose are not reduced beforehand, so that it takes no longer with a large
    database than with a small one.

    Args:
        whole: what was learned with both signals.
        source: that it was learned from.
        settings: the numbers of the method.
        chain: the body that wears the trackers.
        measured: what is measured.
    """
    feature_noise = whole.pose.noise[settings.history * DOF_COUNT :]
    return _learn(source, settings, feature_noise, chain, measured, whole.step, whole.steps)


def _learn(
    source: ExampleSource,
    settings: Settings,
    feature_noise: Float[ndarray, " f"],
    chain: Chain,
    measured: Measured,
    step: Inputs,
    transitions: Steps,
) -> Experience:
    windows = Windows.of(source.database, settings.history, source.features)
    past = Past(
        np.full(DOF_COUNT, settings.history_noise),
        measured.turns * settings.history_noise * np.eye(3),
    )
    rows = rows_to_rehearse(source, settings.rehearsals)
    share = np.ones(DOF_COUNT)
    for look in (rows[:: max(1, len(rows) // _FIRST_LOOK)], rows):
        seen = _seen_noise(feature_noise, source, look, past, measured)
        noise = np.concatenate([np.tile(past.angles, settings.history), seen])
        pose = inputs(windows, source.targets, noise, settings.components)
        found = rehearse(
            source, settings, look, feature_noise, past, measured, pose, step, transitions, share
        )
        familiar = 1.0 / np.maximum(found.squared_distance, _NEAREST)
        share = found.pose.best_share(familiar)
        pose_errors = found.pose.errors(share)
        if look is not rows:
            spread = pose_errors.T @ pose_errors / len(pose_errors)
            past = _heard(spread, chain, source, look, settings, measured)
    growth = (pose_errors * familiar[:, None]).T @ pose_errors / len(pose_errors)
    step_share = found.step.best_share(familiar)
    step_errors = found.step.errors(step_share)
    return Experience(
        pose=pose,
        step=step,
        steps=transitions,
        pose_share=share,
        step_share=step_share,
        pose_growth=growth,
        step_growth=(step_errors * familiar[:, None]).T @ step_errors / len(step_errors),
        caution=_caution(pose_errors, found, growth),
        usual=float(np.quantile(found.squared_distance, 0.9)),
        feature_share=found.feature_share.mean(axis=0),
        history_share=found.history_share.mean(axis=0),
        trust=measured.trust,
    )


def _caution(
    errors: Float[ndarray, "Q 56"],
    found: Rehearsal,
    growth: Float[ndarray, "56 56"],
) -> float:
    """How large errors are in units of what is predicted for them.

    Below 1, since what grows with distance holds all of the errors, and what a regression
    knows of them is added: caution that pays where errors of consecutive frames are alike.
    """
    variance = found.pose_known + found.squared_distance[:, None] * np.diagonal(growth)
    moves = variance > _STILL**2
    if not moves.any():
        return 1.0
    return float(np.sqrt(np.mean(np.square(errors[moves]) / variance[moves])))


def _heard(
    spread: Float[ndarray, "56 56"],
    chain: Chain,
    source: ExampleSource,
    rows: Int[ndarray, " Q"],
    settings: Settings,
    measured: Measured,
) -> Past:
    """What past poses are off by once prediction errors have met the trackers."""
    placed = blank_placed(chain)
    jacobian = np.empty((len(chain.site_body), 6, TANGENT_SIZE))
    sigma = np.repeat([settings.sigma_position, settings.sigma_orientation], 3)
    prior = np.zeros((TANGENT_SIZE, TANGENT_SIZE))
    prior[:6, :6] = np.eye(6)
    prior[6:, 6:] = np.linalg.inv(spread + np.radians(0.5) ** 2 * np.eye(DOF_COUNT))
    variances, turns = [], []
    for row in rows[:: max(1, len(rows) // 20)]:
        qpos = np.concatenate([source.database.roots[row], source.database.angles[row]])
        place(chain, qpos.astype(float), placed)
        tracker_jacobian(chain, placed, jacobian)
        whitened = (jacobian / sigma[:, None])[:, measured.coordinates].reshape(-1, TANGENT_SIZE)
        covariance = np.linalg.inv(prior + whitened.T @ whitened)
        variances.append(np.diagonal(covariance)[6:])
        # The reference's orientation, from the world's axes to its own.
        own = Rotation.from_quat(placed.site_orientation[measured.reference], scalar_first=True)
        turning = own.inv().as_matrix() @ jacobian[measured.reference, 3:]
        turns.append(turning @ covariance @ turning.T)
    angles = np.maximum(np.sqrt(np.mean(variances, axis=0)), _LEAST_NOISE)
    turn = np.linalg.cholesky(np.mean(turns, axis=0)) if measured.turns else np.zeros((3, 3))
    return Past(angles, turn)


def _seen_noise(
    feature_noise: Float[ndarray, " f"],
    source: ExampleSource,
    rows: Int[ndarray, " Q"],
    noise: Past,
    measured: Measured,
) -> Float[ndarray, " f"]:
    """What features are off by where the reference may be turned; infinite where unknown."""
    variance = np.where(measured.trust > 0.0, np.square(feature_noise), np.inf)
    if measured.turns:
        some = rows[:: max(1, len(rows) // 20)]
        for features in source.features[some].astype(float):
            for turn in noise.turn.T:
                away = FeatureLayout.seen_turned(features, turn) - features
                variance += np.square(away) / len(some)
    return np.sqrt(variance)
