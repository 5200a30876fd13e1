"""The least-squares problem of `motion_fit`: its unknowns, normal equations and steps."""

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from calibration.anthropometry import GROUP_COUNT, group_of_bone
from calibration.eigen_skeleton import lengths_of
from calibration.knowledge import Knowledge, derivatives
from calibration.marginal import log_volume, newton_step
from calibration.model import (
    FAINT,
    Beliefs,
    CalibrationModel,
    Holds,
    Linearized,
    Outputs,
    Problem,
    Start,
)
from calibration.pose_prior import PosePriors
from calibration.solver import linearize_at
from localreg.body.skeleton import BODY_NAMES
from localreg.body.subject import Subject

_BLOCK: Final = 64
_FEET: Final = 6
_STEPS: Final = 8
_MOST_DAMPING: Final = 1e6


@dataclass(frozen=True, slots=True)
class MotionSettings:
    """Beliefs of a refinement.

    Chosen on the first five people of `benchmarks/calibration.py` and walks that it does not play.

    Attributes:
        sigma_position: what a tracker's position is off by on each axis [m].
        sigma_orientation: the same of its orientation [rad].
        lorentzian: c of the Lorentzian of tracker errors.
        neighbors: database poses that a pose is believed to be like.
        floor: least standard deviation of a joint angle around them [rad].
        alike: so many frames err together and count as one.
        habit: where the estimate of what all frames err by starts [rad].
        spacing: between frames [s].
        most_frames: that are used.
        rounds: how often neighbors are looked up.
    """

    sigma_position: float = 0.005
    sigma_orientation: float = float(np.radians(0.65))
    lorentzian: float = 9.0
    neighbors: int = 128
    floor: float = float(np.radians(1.5))
    alike: float = 8.0
    habit: float = float(np.radians(2.0))
    spacing: float = 0.2
    most_frames: int = 320
    rounds: int = 2


@dataclass(frozen=True, eq=False)
class SeenFrames:
    """N frames: what trackers said, and the poses that a synthesizer made of it.

    Attributes:
        positions: of the J trackers [m].
        quaternions: w x y z.
        position_mask: where measured.
        orientation_mask: where measured.
        qpos: the poses.
    """

    positions: Float[ndarray, "N J 3"]
    quaternions: Float[ndarray, "N J 4"]
    position_mask: Bool[ndarray, "N J"]
    orientation_mask: Bool[ndarray, "N J"]
    qpos: Float[ndarray, "N 63"]

    def padded(self) -> "SeenFrames":
        """So many that a multiple of a block is solved; others would be compiled anew."""
        more = [(0, -len(self.qpos) % _BLOCK)]
        return SeenFrames(
            np.pad(self.positions, [*more, (0, 0), (0, 0)], mode="edge"),
            np.pad(self.quaternions, [*more, (0, 0), (0, 0)], mode="edge"),
            np.pad(self.position_mask, [*more, (0, 0)]),
            np.pad(self.orientation_mask, [*more, (0, 0)]),
            np.pad(self.qpos, [*more, (0, 0)], mode="edge"),
        )


class Unknowns(NamedTuple):
    """Where a solution is.

    Attributes:
        shared: lengths and mounts, in the units of `model`.
        habit: what all frames err by [rad].
        local: of each frame, in the units of `model`.
    """

    shared: Float[ndarray, " s"]
    habit: Float[ndarray, " a"]
    local: Float[ndarray, "N l"]


class Normal(NamedTuple):
    """Cost and normal equations; `h` counts shared unknowns and habits together."""

    cost: float
    shared: Float[ndarray, "h h"]
    cross: Float[ndarray, "N h l"]
    local: Float[ndarray, "N l l"]
    by_shared: Float[ndarray, " h"]
    by_local: Float[ndarray, "N l"]

    def information(self) -> Float[ndarray, "h h"]:
        """Of the shared unknowns and habits, the frames' own eliminated."""
        solved = np.linalg.solve(self.local, np.swapaxes(self.cross, 1, 2))
        return self.shared - np.einsum("nhl,nlk->hk", self.cross, solved, optimize=True)

    def step(self, damping: float) -> tuple[Float[ndarray, " h"], Float[ndarray, "N l"]]:
        """The damped Gauss-Newton step."""
        own = np.einsum("nll->nl", self.local)
        local = self.local + damping * own[:, :, None] * np.eye(own.shape[1])
        right = np.concatenate([np.swapaxes(self.cross, 1, 2), self.by_local[:, :, None]], axis=2)
        solved = np.linalg.solve(local, right)
        reduced = np.einsum("nhl,nlk->hk", self.cross, solved, optimize=True)
        shared = self.shared + damping * np.diag(np.diag(self.shared))
        step = -np.linalg.solve(shared - reduced[:, :-1], self.by_shared - reduced[:, -1])
        return step, -solved[:, :, -1] - solved[:, :, :-1] @ step


class Bundle:
    """The problem for one subject, its frames and their priors."""

    def __init__(
        self,
        subject: Subject,
        known: Knowledge,
        frames: SeenFrames,
        priors: PosePriors,
        settings: MotionSettings,
    ) -> None:
        self._settings = settings
        groups = lengths_of(subject)
        # What a bone differs by from its group's length is a part of its direction here, so that
        # left and right may differ as they do in the file.
        share = subject.lengths / groups[group_of_bone()]
        directed = CalibrationModel.of(subject)
        self.model = replace(directed, directions=directed.directions * share[:, None])
        ends = np.vstack([np.zeros(3), subject.offsets])
        places = np.array([m.position for m in subject.mounts])
        bones = [BODY_NAMES.index(m.bone) for m in subject.mounts]
        self._active = np.array(self.model.active)
        self.beliefs = Beliefs(
            jnp.log(jnp.asarray(groups)), jnp.eye(GROUP_COUNT), *(jnp.asarray(1.0),) * 3
        )
        self.start = Start(
            jnp.asarray(frames.qpos[:, :7]),
            jnp.asarray(np.array([m.quaternion for m in subject.mounts])),
            jnp.zeros((2, 3)),
        )
        self.before = np.zeros(self.model.shared_size - _FEET)
        J = self.model.tracker_count
        self.before[GROUP_COUNT : GROUP_COUNT + 3 * J] = (places - ends[bones]).ravel()
        whole = np.concatenate([self.before, np.zeros(_FEET)])
        self.by_unknowns = derivatives(self.model, whole, self.beliefs, self.start)
        self._known = self.by_unknowns.T @ np.linalg.inv(known.covariance) @ self.by_unknowns
        self._problem = Problem(
            self.model, _as_holds(frames, priors, settings), self.beliefs, self.start
        )
        covariances = settings.alike * priors.covariances[:, self._active][:, :, self._active]
        self._whiteners = np.linalg.inv(np.linalg.cholesky(covariances))

    def first(self, frames: SeenFrames, priors: PosePriors) -> Unknowns:
        """What was known, and the poses as they seem to be."""
        local = np.zeros((len(frames.qpos), self.model.local_size))
        local[:, 6:] = (frames.qpos[:, 7:] - priors.means)[:, self._active]
        return Unknowns(self.before.copy(), np.zeros(len(self._active)), local)

    def normal(self, at: Unknowns, habit: float) -> Normal:
        """Normal equations, tracker errors weighed as the Lorentzian does at this point."""
        J, s = self.model.tracker_count, len(self.before)
        linear = self._linearized(at)
        r, A, B = (np.array(part) for part in (linear.residuals, linear.by_shared, linear.by_local))
        joints = slice(6 * J + _FEET, 6 * J + _FEET + len(at.habit))
        r[:, joints] = np.einsum("nab,nb->na", self._whiteners, r[:, joints] - at.habit)
        B[:, joints] = self._whiteners @ B[:, joints]
        H = np.zeros((*r.shape, len(at.habit)))
        H[:, joints] = -self._whiteners
        c = self._settings.lorentzian
        t, weights = _lorentzian(r[:, : 6 * J], c)
        away = at.shared - self.before
        cost = c * np.log1p(t).sum() + 0.5 * np.sum(r[:, 6 * J :] ** 2)
        cost += 0.5 * (away @ self._known @ away + np.sum(at.habit**2) / habit**2)
        A = np.concatenate([A[:, :, :s], H], axis=2)
        for rows in (A, B):
            rows[:, : 6 * J] *= weights[:, :, None]
        r[:, : 6 * J] *= weights
        At, Bt = np.swapaxes(A, 1, 2), np.swapaxes(B, 1, 2)
        shared = np.einsum("nhr,nrk->hk", At, A, optimize=True)
        by_shared = np.einsum("nhr,nr->h", At, r)
        shared[:s, :s] += self._known
        by_shared[:s] += self._known @ away
        shared[s:, s:] += np.eye(len(at.habit)) / habit**2
        by_shared[s:] += at.habit / habit**2
        return Normal(float(cost), shared, At @ B, Bt @ B, by_shared,
                       np.einsum("nlr,nr->nl", Bt, r))  # fmt: skip

    def descend(self, at: Unknowns, habit: float) -> tuple[Unknowns, Normal]:
        """Levenberg-Marquardt with this deviation of habits."""
        normal, damping = self.normal(at, habit), 1e-4
        s = len(self.before)
        for _ in range(_STEPS):
            while True:
                step, local = normal.step(damping)
                there = Unknowns(at.shared + step[:s], at.habit + step[s:], at.local + local)
                new = self.normal(there, habit)
                if new.cost < normal.cost or damping > _MOST_DAMPING:
                    break
                damping = 10.0 * damping
            if not new.cost < normal.cost:
                break
            gained = normal.cost - new.cost
            at, normal, damping = there, new, max(0.1 * damping, 1e-9)
            if gained < 1e-4 * normal.cost:
                break
        return at, normal

    def _linearized(self, at: Unknowns) -> Linearized:
        x = np.concatenate([at.shared, np.zeros(_FEET), at.local.ravel()])
        return linearize_at(self._problem, jnp.asarray(x))

    def _poses_information(self, at: Unknowns) -> Float[ndarray, "N l l"]:
        """As `local` of the normal equations, in half the time."""
        rows = slice(0, 6 * self.model.tracker_count)
        linear = self._linearized(at)
        _, weights = _lorentzian(np.asarray(linear.residuals)[:, rows], self._settings.lorentzian)
        B = np.asarray(linear.by_local)[:, rows] * weights[:, :, None]
        information = np.swapaxes(B, 1, 2) @ B
        information[:, 6:, 6:] += np.swapaxes(self._whiteners, 1, 2) @ self._whiteners
        information[:, np.arange(6), np.arange(6)] += FAINT**2
        return information

    def to_marginal(self, at: Unknowns, normal: Normal) -> Unknowns:
        """From the best of everything to the best lengths and mounts; frames alike count as one."""
        J, s = self.model.tracker_count, len(self.before)
        follow = -np.linalg.solve(normal.local, np.swapaxes(normal.cross, 1, 2))

        def moved(step: Float[ndarray, " h"]) -> Unknowns:
            return Unknowns(at.shared + step[:s], at.habit + step[s:], at.local + follow @ step)

        def volume(step: Float[ndarray, " h"]) -> float:
            return log_volume(self._poses_information(moved(step))) / self._settings.alike

        # Turns of mounts, and lengths that no tracker is carried by, change no lever.
        carried = np.abs(normal.cross).max(axis=(0, 2)) > 0.0
        which = np.flatnonzero(carried[: GROUP_COUNT + 3 * J])
        step = newton_step(np.linalg.inv(normal.information()), volume, which.tolist())
        return moved(step)

    def outputs(self, at: Unknowns) -> Outputs:
        """Lengths and mounts."""
        whole = jnp.asarray(np.concatenate([at.shared, np.zeros(_FEET)]))
        return self.model.outputs(whole, self.beliefs, self.start)

    def derivatives(self, at: Unknowns) -> Float[ndarray, "k k"]:
        """Of what `knowledge` is about by the shared unknowns."""
        whole = np.concatenate([at.shared, np.zeros(_FEET)])
        return derivatives(self.model, whole, self.beliefs, self.start)

    def angles(self, at: Unknowns, priors: PosePriors) -> Float[ndarray, "N 56"]:
        """Joint angles of the frames [rad]."""
        angles = priors.means.copy()
        angles[:, self._active] += at.local[:, 6:]
        return angles


def _lorentzian(
    r: Float[ndarray, "N k"], c: float
) -> tuple[Float[ndarray, "N t"], Float[ndarray, "N k"]]:
    """Of every three rows the argument of its logarithm, and of every row its weight."""
    t = np.sum(r.reshape(len(r), -1, 3) ** 2, axis=2) / (2.0 * c)
    return t, np.repeat(1.0 / np.sqrt(1.0 + t), 3, axis=1)


def _as_holds(frames: SeenFrames, priors: PosePriors, settings: MotionSettings) -> Holds:
    N, J = frames.position_mask.shape
    return Holds(
        positions=jnp.asarray(frames.positions),
        quaternions=jnp.asarray(frames.quaternions),
        position_whiteners=jnp.broadcast_to(jnp.eye(3) / settings.sigma_position, (N, J, 3, 3)),
        orientation_whiteners=jnp.broadcast_to(
            jnp.eye(3) / settings.sigma_orientation, (N, J, 3, 3)
        ),
        position_weights=jnp.asarray(frames.position_mask.astype(float)),
        orientation_weights=jnp.asarray(frames.orientation_mask.astype(float)),
        targets=jnp.asarray(priors.means),
        planted=jnp.zeros((N, 2)),
    )
