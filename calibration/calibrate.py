"""The whole way from holds to a subject: screen, fit, look for what does not fit, fit again.

After a fit two things are looked for, both by how much more freedom would lower the cost (a
score test, exact to first order): a pose that agrees with none of the others, and a tracker
that sat otherwise before some pose than from it on. What is found is left out and the rest
fitted again, until nothing is found.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from calibration.anthropometry import GROUP_COUNT
from calibration.eigen_skeleton import SkeletonPrior
from calibration.fit import Fit, FitSettings, Session, fit
from calibration.holds import Hold
from calibration.model import TURN_UNIT, Linearized
from calibration.poses import EIGHT_POSES, TargetPose
from calibration.result import Calibration, summarize
from calibration.screening import Finding, Kind, screen
from calibration.solver import ScoreTest
from localreg.body.subject import Mount
from localreg.errors import LocalregError

_MOST_LEFT_OUT: Final = 3
_ODD_POSE: Final = 2.5
"""A pose is odd if freeing it lowers the cost by so many times what chance would."""

_SLIP_CHI_SQUARE: Final = 35.0
"""Of six degrees of freedom: chance gives that once in 200,000 cases."""

_SLIP_DISTANCE: Final = 0.015
_SLIP_TURN: Final = float(np.radians(6.0))
_LEAST_POSES: Final = 4


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of a calibration.

    Attributes:
        calibration: the result; None if none can be had.
        findings: what was amiss, and what to do about it.
        session: what was fitted in the end.
        fit: the fit itself; None if there is none.
    """

    calibration: Calibration | None
    findings: tuple[Finding, ...]
    session: Session
    fit: Fit | None

    @property
    def result(self) -> Calibration:
        """The calibration.

        Raises:
            LocalregError: there is none, with what was amiss.
        """
        if self.calibration is None:
            raise LocalregError("; ".join(f.text for f in self.findings) or "there is no result")
        return self.calibration

    @property
    def repeat(self) -> tuple[str, ...]:
        """Names of the poses to repeat, each once."""
        return tuple(dict.fromkeys(pose for f in self.findings for pose in f.poses))


def calibrate(
    holds: Sequence[Hold],
    trackers: tuple[Mount, ...],
    prior: SkeletonPrior,
    *,
    poses: Sequence[TargetPose] = EIGHT_POSES,
    settings: FitSettings | None = None,
    name: str = "me",
    method: str = "eight poses",
) -> Outcome:
    """Calibrate a person.

    Args:
        holds: what was recorded; of repeated poses the last alone.
        trackers: which tracker on which bone; positions and turns do not matter.
        prior: the eigen-skeleton.
        poses: what was asked for.
        settings: beliefs.
        name: whose body.
        method: for the record.

    Raises:
        LocalregError: a hold is of no known pose, or has fewer than three trackers.
    """
    session, findings = screen(Session.of(trackers, holds, poses), prior)
    if any(finding.is_fatal for finding in findings) or not session.used.any():
        return Outcome(None, tuple(findings), session, None)
    found = fit(session, prior, settings)
    for _ in range(_MOST_LEFT_OUT):
        amiss = _worst(found, session)
        if amiss is None:
            break
        finding, session = amiss
        findings.append(finding)
        found = fit(session, prior, settings)
    result = summarize(
        found, session, prior, name=name, method=method, notes=[f.text for f in findings]
    )
    if not np.isfinite(result.groups).all():
        raise LocalregError("the calibration did not come to a result; record the poses again")
    return Outcome(result, tuple(findings), session, found)


def _worst(found: Fit, session: Session) -> tuple[Finding, Session] | None:
    """What would lower the cost most if it were left out, if anything stands out."""
    if session.used.sum() <= _LEAST_POSES:
        return None
    test = ScoreTest(found.linear)
    choices = [*_odd_poses(found, session, test), *_slips(found, session, test)]
    if not choices:
        return None
    _, finding, rest = max(choices, key=lambda choice: choice[0])
    return finding, rest


Choice = tuple[float, Finding, Session]


def _odd_poses(found: Fit, session: Session, test: ScoreTest) -> list[Choice]:
    used = np.flatnonzero(session.used)
    J = found.problem.model.tracker_count
    gains, freedoms = np.zeros(len(used)), np.zeros(len(used))
    for k, i in enumerate(used):
        rows = _weights(found, int(i))
        columns = np.zeros((*found.linear.residuals.shape, int(rows.sum())))
        columns[i, np.flatnonzero(rows), np.arange(int(rows.sum()))] = 1.0
        gains[k] = 2.0 * test.gain(columns)[0]
        freedoms[k] = max(rows[: 6 * J].sum() - 6.0, 1.0)
    ratios = gains / freedoms
    choices = []
    for k, i in enumerate(used):
        if ratios[k] > _ODD_POSE and ratios[k] > _ODD_POSE * np.median(np.delete(ratios, k)):
            pose = session.holds[i].pose
            text = f"pose {pose} does not agree with the others; it is left out: repeat it"
            finding = Finding(Kind.WRONG_POSE, text, (pose,))
            choices.append((gains[k] - 2.0 * freedoms[k], finding, session.without_pose(int(i))))
    return choices


def _weights(found: Fit, i: int) -> Float[ndarray, " r"]:
    """Which rows of a pose are measurements that count."""
    holds = found.problem.holds
    weights = np.zeros(found.linear.residuals.shape[1])
    J = found.problem.model.tracker_count
    weights[: 3 * J] = np.repeat(np.asarray(holds.position_weights[i]), 3)
    weights[3 * J : 6 * J] = np.repeat(np.asarray(holds.orientation_weights[i]), 3)
    weights[6 * J : 6 * J + 6] = np.repeat(np.asarray(holds.planted[i]), 3)
    return weights


def _slips(found: Fit, session: Session, test: ScoreTest) -> list[Choice]:
    used = np.flatnonzero(session.used)
    J = found.problem.model.tracker_count
    choices = []
    for j in range(J):
        there = [int(i) for i in used if session.seen[i, j]]
        for place in range(1, len(there)):
            columns = slip_columns(found.linear, J, j, np.array(there[place:]))
            gain, step = test.gain(columns)
            distance = float(np.linalg.norm(step[:3])) * float(found.problem.beliefs.mount_sigma)
            turn = float(np.linalg.norm(step[3:])) * TURN_UNIT
            moved = distance > _SLIP_DISTANCE or turn > _SLIP_TURN
            if 2.0 * gain < _SLIP_CHI_SQUARE or not moved:
                continue
            i, name = there[place], session.names[j]
            before, after = session.holds[there[place - 1]].pose, session.holds[i].pose
            again = tuple(session.holds[k].pose for k in there[:place])
            text = (
                f"tracker {name} moved on its bone between poses {before} and {after} "
                f"(by about {1e3 * distance:.0f} mm and {np.degrees(turn):.0f} deg); where it "
                f"sits now is what counts: fasten it and repeat {', '.join(again)}"
            )
            finding = Finding(Kind.SLIPPED, text, again, (name,))
            choices.append((2.0 * gain - 12.0, finding, session.without_tracker_before(j, i)))
    return choices


def slip_columns(
    linear: Linearized, trackers: int, tracker: int, rows: Float[ndarray, " k"] | ndarray
) -> Float[ndarray, "N r 6"]:
    """Derivative of all rows by a mount that changes from some poses on."""
    first = GROUP_COUNT + 3 * tracker
    which = [*range(first, first + 3), *range(first + 3 * trackers, first + 3 * trackers + 3)]
    columns = np.zeros((*linear.residuals.shape, 6))
    columns[rows] = np.asarray(linear.by_shared)[rows][:, :, which]
    return columns
