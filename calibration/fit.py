"""From holds to lengths, mounts and their covariance.

The scale of the poses' errors is estimated with the rest: people differ in how well they hit
a pose, and the posterior must know. With d the deviations in units of sigma and C their
posterior covariance, gamma = n - tr C of them are known from measurements, and

    sigma^2 <- sigma^2 |d|^2 / gamma

is the fixed point of the evidence (MacKay, "Bayesian interpolation", 1992). The same for the
feet that should not have moved. In the end lengths and mounts go to the greatest density of
their own (`marginal`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from calibration.anthropometry import GROUP_COUNT
from calibration.eigen_skeleton import SkeletonPrior, average_subject
from calibration.holds import Hold, whitener
from calibration.marginal import to_marginal
from calibration.model import FEET, Beliefs, CalibrationModel, Holds, Linearized, Problem, Start
from calibration.poses import TargetPose
from calibration.solver import Posterior, linearize_at, posterior, solve
from localreg.body.skeleton import BODY_NAMES, BONE_NAMES
from localreg.body.subject import Mount, Subject
from localreg.errors import LocalregError
from localreg.evaluation.body_points import BodyPoints

_ROUNDS: Final = 5
_SETTLED: Final = 0.05
_BLOCK: Final = 8


@dataclass(frozen=True, slots=True)
class FitSettings:
    """What is believed before a fit.

    Attributes:
        mount_sigma: how far a tracker may sit from the end of its bone, on each axis [m].
        pose_sigma: error of a joint about each axis; where the estimate starts [rad].
        plant_sigma: how far the ankle of a standing foot moves, on each axis [m].
        estimate_sigmas: whether to estimate the two errors from the holds.
        least_pose_sigma: the estimate stays above [rad].
        least_plant_sigma: the estimate stays above [m].
    """

    mount_sigma: float = 0.04
    pose_sigma: float = float(np.radians(3.0))
    plant_sigma: float = 0.005
    estimate_sigmas: bool = True
    least_pose_sigma: float = float(np.radians(0.02))
    least_plant_sigma: float = 5e-4


@dataclass(frozen=True, eq=False)
class Session:
    """All that was recorded of one person.

    Attributes:
        trackers: which tracker on which bone, as mounts with default positions.
        holds: in the order of recording.
        poses: what was asked for, hold by hold.
        used: which holds count.
        seen: which trackers count in which hold; a tracker that slipped does not before.
    """

    trackers: tuple[Mount, ...]
    holds: tuple[Hold, ...]
    poses: tuple[TargetPose, ...]
    used: Bool[ndarray, " N"]
    seen: Bool[ndarray, "N J"]

    @classmethod
    def of(
        cls, trackers: tuple[Mount, ...], holds: Sequence[Hold], poses: Sequence[TargetPose]
    ) -> "Session":
        """A session in which everything counts.

        Raises:
            LocalregError: a hold is of no known pose, or there is none.
        """
        by_name = {pose.name: pose for pose in poses}
        unknown = [hold.pose for hold in holds if hold.pose not in by_name]
        if unknown or not holds:
            raise LocalregError(
                f"holds of {', '.join(unknown) or 'no pose at all'}; record some of "
                f"{', '.join(by_name)}"
            )
        chosen = tuple(by_name[hold.pose] for hold in holds)
        N, J = len(holds), len(trackers)
        return cls(trackers, tuple(holds), chosen, np.ones(N, bool), np.ones((N, J), bool))

    def without_pose(self, index: int) -> "Session":
        """The same, one hold left out."""
        used = self.used.copy()
        used[index] = False
        return replace(self, used=used)

    def without_tracker_before(self, tracker: int, index: int) -> "Session":
        """The same, a tracker left out of all holds before one."""
        seen = self.seen.copy()
        seen[:index, tracker] = False
        return replace(self, seen=seen)

    @property
    def names(self) -> tuple[str, ...]:
        """The trackers' names."""
        return tuple(mount.tracker for mount in self.trackers)


@dataclass(frozen=True, eq=False)
class Fit:
    """The end of a fit.

    Attributes:
        problem: what was solved, with the errors as estimated.
        x: the unknowns.
        linear: residuals and derivatives there.
        posterior: covariances.
        pose_sigma: error of a joint about each axis [rad].
        plant_sigma: how far ankles of standing feet moved [m].
        cost: half the sum of squares.
        is_converged: whether the solver came to rest.
    """

    problem: Problem
    x: Float[ndarray, " n"]
    linear: Linearized
    posterior: Posterior
    pose_sigma: float
    plant_sigma: float
    cost: float
    is_converged: bool


def fit(session: Session, prior: SkeletonPrior, settings: FitSettings | None = None) -> Fit:
    """Estimate everything.

    Args:
        session: the holds.
        prior: the eigen-skeleton.
        settings: beliefs.

    Raises:
        LocalregError: a hold has fewer than three trackers.
    """
    settings = settings or FitSettings()
    average = average_subject(prior)
    worn = replace(average, mounts=default_mounts(average, session.trackers))
    model = CalibrationModel.of(worn)
    whole, count = _padded(session), len(session.holds)
    holds = stacked(whole)
    start = first_guess(whole, worn)
    x = np.zeros(model.shared_size + len(whole.holds) * model.local_size)
    pose_sigma, plant_sigma = settings.pose_sigma, settings.plant_sigma
    root = np.linalg.cholesky(prior.covariance)
    rounds = 0
    while True:
        rounds += 1
        beliefs = Beliefs(
            jnp.asarray(prior.mean),
            jnp.asarray(root),
            jnp.asarray(settings.mount_sigma),
            jnp.asarray(pose_sigma),
            jnp.asarray(plant_sigma),
        )
        problem = Problem(model, holds, beliefs, start)
        solution = solve(problem, jnp.asarray(x))
        x = np.array(solution.x)
        linear = linearize_at(problem, solution.x)
        after = posterior(linear)
        if not settings.estimate_sigmas or rounds == _ROUNDS:
            break
        new = _estimate(whole, problem, x, linear, after, settings)
        ratio = new[0] / pose_sigma
        if abs(np.log(ratio)) < _SETTLED and abs(np.log(new[1] / plant_sigma)) < 2 * _SETTLED:
            break
        # The deviations stay what they are while their unit changes.
        local = x[model.shared_size :].reshape(len(whole.holds), -1)
        local[:, 6:] /= ratio
        pose_sigma, plant_sigma = new
    x = to_marginal(problem, x)
    linear = linearize_at(problem, jnp.asarray(x))
    after = posterior(linear)
    x = x[: model.shared_size + count * model.local_size]
    start = Start(start.roots[:count], start.mounts, start.spots)
    problem = Problem(model, jax.tree.map(lambda a: a[:count], holds), beliefs, start)
    linear = linear._replace(
        residuals=linear.residuals[:count],
        by_shared=linear.by_shared[:count],
        by_local=linear.by_local[:count],
    )
    after = after._replace(
        local=after.local[:count], cross=after.cross[:count], costs=after.costs[:count]
    )
    return Fit(
        problem, x, linear, after, pose_sigma, plant_sigma,
        float(solution.cost), bool(solution.is_converged),
    )  # fmt: skip


def _padded(session: Session) -> Session:
    """So many holds that a multiple of eight is solved: others would be compiled anew."""
    missing = -len(session.holds) % _BLOCK
    return replace(
        session,
        holds=session.holds + session.holds[:1] * missing,
        poses=session.poses + session.poses[:1] * missing,
        used=np.concatenate([session.used, np.zeros(missing, bool)]),
        seen=np.concatenate([session.seen, np.zeros((missing, session.seen.shape[1]), bool)]),
    )


def default_mounts(subject: Subject, trackers: Sequence[Mount]) -> tuple[Mount, ...]:
    """Trackers at the ends of their bones, turned as the bones."""
    ends = dict(zip(BONE_NAMES, subject.offsets.tolist(), strict=True))
    return tuple(
        Mount(m.tracker, m.bone, tuple(ends.get(m.bone, (0.0, 0.0, 0.0)))) for m in trackers
    )


def stacked(session: Session) -> Holds:
    """The holds as arrays for the solver."""
    used = session.used[:, None] & session.seen
    positions = np.array([h.position_mask for h in session.holds]) & used
    orientations = np.array([h.orientation_mask for h in session.holds]) & used
    planted = np.array([pose.planted for pose in session.poses]) & session.used[:, None]
    return Holds(
        positions=jnp.asarray(np.array([h.positions for h in session.holds])),
        quaternions=jnp.asarray(np.array([h.quaternions for h in session.holds])),
        position_whiteners=jnp.asarray(
            np.array([[whitener(c) for c in h.position_covariances] for h in session.holds])
        ),
        orientation_whiteners=jnp.asarray(
            np.array([[whitener(c) for c in h.orientation_covariances] for h in session.holds])
        ),
        position_weights=jnp.asarray(positions.astype(float)),
        orientation_weights=jnp.asarray(orientations.astype(float)),
        targets=jnp.asarray(np.array([pose.angles for pose in session.poses])),
        # A foot that stands in one pose alone says nothing.
        planted=jnp.asarray(planted * (planted.sum(axis=0) > 1).astype(float)),
    )


def align(
    source: Float[ndarray, "J 3"], target: Float[ndarray, "J 3"], mask: Bool[ndarray, " J"]
) -> tuple[Rotation, Float[ndarray, "3"], float]:
    """The rigid motion that lays points upon others best, and what is left [m] (Kabsch)."""
    a, b = source[mask], target[mask]
    middle, goal = a.mean(axis=0), b.mean(axis=0)
    U, _, Vt = np.linalg.svd((b - goal).T @ (a - middle))
    R = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    t = goal - R @ middle
    left = np.sqrt(np.mean(np.sum((a @ R.T + t - b) ** 2, axis=1)))
    return Rotation.from_matrix(R), t, float(left)


def first_guess(session: Session, worn: Subject) -> Start:
    """The average person in exactly the poses asked for, laid upon the trackers."""
    points = BodyPoints(worn)
    targets = np.array([pose.qpos() for pose in session.poses])
    seen = points.tracker_poses(targets)
    ends = points.bone_ends(targets)
    N, J = session.seen.shape
    roots, spots, counts = np.zeros((N, 7)), np.zeros((2, 3)), np.zeros(2)
    turns: list[list[Rotation]] = [[] for _ in range(J)]
    feet = [BODY_NAMES.index(name) for name in FEET]
    for i, hold in enumerate(session.holds):
        there = hold.position_mask & session.seen[i]
        if session.used[i] and there.sum() < 3:
            raise LocalregError(
                f"pose {hold.pose} was seen by {int(there.sum())} trackers; three at least are "
                "needed: see that all are on, and repeat it"
            )
        if not session.used[i]:
            roots[i] = targets[i, :7]
            continue
        R, t, _ = align(seen.positions[i], hold.positions, there)
        roots[i, :3] = R.apply(targets[i, :3]) + t
        roots[i, 3:] = (R * Rotation.from_quat(targets[i, 3:7], scalar_first=True)).as_quat(
            scalar_first=True
        )
        for j in np.flatnonzero(hold.orientation_mask & session.seen[i]):
            bone = R * Rotation.from_quat(seen.quaternions[i, j], scalar_first=True)
            turns[j].append(bone.inv() * Rotation.from_quat(hold.quaternions[j], scalar_first=True))
        for foot, row in enumerate(feet):
            if session.poses[i].planted[foot]:
                spots[foot] += R.apply(ends[i, row]) + t
                counts[foot] += 1
    mounts = np.tile([1.0, 0.0, 0.0, 0.0], (J, 1))
    for j, found in enumerate(turns):
        if found:
            mounts[j] = robust_mean(found).as_quat(scalar_first=True)
    return Start(
        jnp.asarray(roots),
        jnp.asarray(mounts),
        jnp.asarray(spots / np.maximum(counts, 1)[:, None]),
    )


def robust_mean(turns: Sequence[Rotation]) -> Rotation:
    """The mean of rotations about the one that is nearest to all others."""
    whole = Rotation.concatenate(list(turns))
    apart = np.array([(turn.inv() * whole).magnitude().clip(max=1.0).sum() for turn in turns])
    middle = turns[int(np.argmin(apart))]
    near = (middle.inv() * whole).magnitude() < np.radians(60.0)
    return whole[near].mean()


def _estimate(
    session: Session,
    problem: Problem,
    x: Float[ndarray, " n"],
    linear: Linearized,
    after: Posterior,
    settings: FitSettings,
) -> tuple[float, float]:
    """Better errors of poses [rad] and of standing feet [m]."""
    s, N = problem.model.shared_size, len(session.holds)
    deviations = x[s:].reshape(N, -1)[session.used, 6:]
    spread = np.einsum("nll->nl", after.local)[session.used, 6:]
    known = float(np.sum(1.0 - spread))
    # A tenth of a degree of freedom of the first belief keeps a single pose from nought.
    squares = float(np.sum(deviations**2)) + 0.1
    pose_sigma = float(problem.beliefs.pose_sigma) * np.sqrt(squares / (max(known, 0.0) + 0.1))
    J = problem.model.tracker_count
    rows = slice(6 * J, 6 * J + 6)
    r = np.asarray(linear.residuals)[:, rows]
    by_shared = np.asarray(linear.by_shared)[:, rows]
    by_local = np.asarray(linear.by_local)[:, rows]
    planted = np.repeat(np.asarray(problem.holds.planted), 3, axis=1) > 0
    variance = np.einsum("nrs,nrs->nr", by_shared @ after.shared, by_shared)
    variance += np.einsum("nrl,nrl->nr", by_local @ after.local, by_local)
    variance += 2.0 * np.einsum("nrs,nrs->nr", by_local @ after.cross, by_shared)
    known = float(np.sum(np.maximum(1.0 - variance, 0.05)[planted]))
    squares = float(np.sum(r[planted] ** 2)) + 1.0
    plant_sigma = float(problem.beliefs.plant_sigma) * np.sqrt(squares / (known + 1.0))
    return (
        float(np.clip(pose_sigma, settings.least_pose_sigma, np.radians(15.0))),
        float(np.clip(plant_sigma, settings.least_plant_sigma, 0.05)),
    )


def log_length_covariance(found: Fit) -> Float[ndarray, "18 18"]:
    """Posterior covariance of the logarithms of the lengths."""
    L = np.asarray(found.problem.beliefs.root)
    return L @ found.posterior.shared[:GROUP_COUNT, :GROUP_COUNT] @ L.T
