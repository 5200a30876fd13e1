"""The calibration as one nonlinear least-squares problem, in JAX.

Unknown are a person's lengths, the trackers' mounts, where each foot stands, and for every
held pose the root and how far each joint is from the pose that was asked for. All in units
of what is believed of them beforehand, so that the problem is well scaled and its penalties
are plain squares:

    lengths   log s = e_0 + L a,  L L^T the eigen-skeleton's covariance,   |a|^2
    mounts    p_j = end of the bone + sigma_m m_j,                         |m_j|^2
              o_j = o_j0 exp(r_j)                                          none
    feet      spot_f = spot_f0 + u_f                                       none
    root      (p, q)_i = (p, q)_i0 + v_i                                   none
    joints    q_i = target_i + sigma_q d_i                                 |d_i|^2

To these come the tracker's errors in every pose, whitened by the covariance of the hold's
mean, and for every foot that was asked to stay where it is, how far its ankle is from its
spot. Shared unknowns come first; those of a pose touch that pose's rows alone, so the
Jacobian is made of one block a pose.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from calibration.anthropometry import GROUP_COUNT, group_of_bone
from localreg import jax_numerics as jax_numerics
from localreg.body import rotations
from localreg.body.kinematics import Kinematics, Sites
from localreg.body.model import build_model, tracker_site
from localreg.body.skeleton import BODY_NAMES, BONES, DOF_BONES, DOF_COUNT
from localreg.body.subject import Subject

FEET = ("ltibia", "rtibia")
"""Bones whose far ends stay where they are while a foot stands."""

_ROOT_UNITS = np.array([0.01] * 3 + [0.02] * 3)
TURN_UNIT = 0.02
_SPOT_UNIT = 0.01
# Keeps what nothing is known of (the mount of a tracker that never reported) defined.
FAINT = 1e-4

_GROUPS = group_of_bone()


class Holds(eqx.Module):
    """The statistics of N holds of J trackers; entries of weight 0 are not there.

    Attributes:
        positions: mean positions [m].
        quaternions: mean orientations, w x y z.
        position_whiteners: inverse roots of the covariance of the mean [1/m].
        orientation_whiteners: the same of a rotation vector in tracker axes [1/rad].
        position_weights: 1 where measured.
        orientation_weights: 1 where measured.
        targets: joint angles that were asked for [rad].
        planted: 1 where a foot was to stay on its spot.
    """

    positions: Float[Array, "N J 3"]
    quaternions: Float[Array, "N J 4"]
    position_whiteners: Float[Array, "N J 3 3"]
    orientation_whiteners: Float[Array, "N J 3 3"]
    position_weights: Float[Array, "N J"]
    orientation_weights: Float[Array, "N J"]
    targets: Float[Array, "N 56"]
    planted: Float[Array, "N 2"]


class Beliefs(eqx.Module):
    """What is believed before any measurement.

    Attributes:
        mean: mean logarithms of the lengths.
        root: L, the Cholesky factor of their covariance.
        mount_sigma: how far a tracker may sit from where it should [m].
        pose_sigma: how far a joint may be from what was asked for [rad].
        plant_sigma: how far an ankle may move while its foot stands [m].
    """

    mean: Float[Array, "18"]
    root: Float[Array, "18 18"]
    mount_sigma: Float[Array, ""]
    pose_sigma: Float[Array, ""]
    plant_sigma: Float[Array, ""]


class Start(eqx.Module):
    """Where the unknowns count from.

    Attributes:
        roots: root position and quaternion of every pose.
        mounts: mount quaternion of every tracker, w x y z.
        spots: where the feet's ankles are [m].
    """

    roots: Float[Array, "N 7"]
    mounts: Float[Array, "J 4"]
    spots: Float[Array, "2 3"]


class Outputs(NamedTuple):
    """What a calibration is asked for.

    Attributes:
        lengths: of the groups [m].
        positions: of the trackers in their bones' frames [m].
        quaternions: of the trackers in their bones' frames.
    """

    lengths: Float[Array, "18"]
    positions: Float[Array, "J 3"]
    quaternions: Float[Array, "J 4"]


class CalibrationModel(eqx.Module):
    """The body whose unknowns are sought, for one choice of tracker bones.

    Attributes:
        kinematics: of the default body with these trackers; its lengths are replaced.
        directions: rest directions of the bones.
        active: joint angles that move a tracker or an ankle, by index.
        tracker_bones: index of each tracker's bone in `BODY_NAMES`.
    """

    kinematics: Kinematics
    directions: Float[Array, "30 3"]
    parents: tuple[int, ...] = eqx.field(static=True)
    active: tuple[int, ...] = eqx.field(static=True)
    tracker_bones: tuple[int, ...] = eqx.field(static=True)

    @classmethod
    def of(cls, subject: Subject) -> "CalibrationModel":
        """The model of a subject's trackers; its lengths and mounts do not matter."""
        model = build_model(subject)
        kinematics = Kinematics.from_model(model, [tracker_site(t) for t in subject.trackers])
        bones = tuple(BODY_NAMES.index(mount.bone) for mount in subject.mounts)
        return cls(
            kinematics=kinematics,
            directions=jnp.asarray(subject.directions),
            parents=(0, *(BODY_NAMES.index(bone.parent) for bone in BONES)),
            active=_active({BODY_NAMES[b] for b in bones} | set(FEET)),
            tracker_bones=bones,
        )

    @property
    def tracker_count(self) -> int:
        """J."""
        return len(self.tracker_bones)

    @property
    def shared_size(self) -> int:
        """Unknowns of all poses together."""
        return GROUP_COUNT + 6 * self.tracker_count + 6

    @property
    def local_size(self) -> int:
        """Unknowns of each pose."""
        return 6 + len(self.active)

    def outputs(self, shared: Float[Array, " s"], beliefs: Beliefs, start: Start) -> Outputs:
        """Lengths and mounts."""
        J = self.tracker_count
        lengths = jnp.exp(beliefs.mean + beliefs.root @ shared[:GROUP_COUNT])
        moved = shared[GROUP_COUNT : GROUP_COUNT + 3 * J].reshape(J, 3)
        turned = shared[GROUP_COUNT + 3 * J : GROUP_COUNT + 6 * J].reshape(J, 3)
        ends = jnp.concatenate([jnp.zeros((1, 3)), self._bone_vectors(lengths)])
        positions = ends[np.array(self.tracker_bones)] + beliefs.mount_sigma * moved
        return Outputs(
            lengths,
            positions,
            rotations.multiply(start.mounts, rotations.exp(TURN_UNIT * turned)),
        )

    def spots(self, shared: Float[Array, " s"], start: Start) -> Float[Array, "2 3"]:
        """Where the ankles of standing feet are [m]."""
        return start.spots + _SPOT_UNIT * shared[-6:].reshape(2, 3)

    def pose(
        self,
        local: Float[Array, " l"],
        target: Float[Array, "56"],
        root: Float[Array, "7"],
        pose_sigma: Float[Array, ""],
    ) -> Float[Array, "63"]:
        """The pose that a pose's unknowns stand for."""
        step = jnp.asarray(_ROOT_UNITS) * local[:6]
        quaternion = rotations.multiply(root[3:], rotations.exp(step[3:]))
        angles = target.at[np.array(self.active)].add(pose_sigma * local[6:])
        return jnp.concatenate([root[:3] + step[:3], quaternion, angles])

    def body(self, outputs: Outputs) -> Kinematics:
        """The kinematics of a person of these lengths and mounts."""
        vectors = self._bone_vectors(outputs.lengths)
        starts = jnp.concatenate([jnp.zeros((1, 3)), vectors])[np.array(self.parents)]
        offsets = jnp.concatenate([jnp.zeros((2, 3)), starts[1:]])
        ends = jnp.concatenate([jnp.zeros((1, 3)), vectors])
        k = self.kinematics
        return eqx.tree_at(
            lambda k: (k.offsets, k.trackers.positions, k.trackers.quaternions, k.ends.positions),
            k,
            (offsets, outputs.positions, outputs.quaternions, ends),
        )

    def pose_residual(
        self,
        shared: Float[Array, " s"],
        local: Float[Array, " l"],
        hold: Holds,
        root: Float[Array, "7"],
        beliefs: Beliefs,
        start: Start,
    ) -> Float[Array, " r"]:
        """Rows of one pose: trackers, standing feet, joints, and a faint hold on the root."""
        outputs = self.outputs(shared, beliefs, start)
        body = self.body(outputs)
        qpos = self.pose(local, hold.targets, root, beliefs.pose_sigma)
        bodies = body.forward(qpos)
        trackers = body.site_poses(bodies, body.trackers)
        away = trackers.positions - hold.positions
        turn = rotations.log(
            rotations.multiply(rotations.conjugate(hold.quaternions), trackers.quaternions)
        )
        position = jnp.einsum("jab,jb->ja", hold.position_whiteners, away)
        orientation = jnp.einsum("jab,jb->ja", hold.orientation_whiteners, turn)
        ankles = body.site_poses(bodies, feet_of(body.ends)).positions
        plant = (ankles - self.spots(shared, start)) / beliefs.plant_sigma
        return jnp.concatenate(
            [
                (hold.position_weights[:, None] * position).ravel(),
                (hold.orientation_weights[:, None] * orientation).ravel(),
                (hold.planted[:, None] * plant).ravel(),
                local[6:],
                FAINT * local[:6],
            ]
        )

    def pose_jacobian(
        self,
        shared: Float[Array, " s"],
        local: Float[Array, " l"],
        hold: Holds,
        root: Float[Array, "7"],
        beliefs: Beliefs,
        start: Start,
    ) -> tuple[Float[Array, "r s"], Float[Array, "r l"]]:
        """Derivative of `pose_residual`, by the kinematics' own Jacobian.

        Five times as fast as differentiating through the chain, which is what a fit waits for.
        """
        J, L = self.tracker_count, self.local_size
        outputs = self.outputs(shared, beliefs, start)
        body = self.body(outputs)
        qpos = self.pose(local, hold.targets, root, beliefs.pose_sigma)
        feet = feet_of(body.ends)
        sites = Sites(
            body=(*body.trackers.body, *feet.body),
            positions=jnp.concatenate([body.trackers.positions, feet.positions]),
            quaternions=jnp.concatenate([body.trackers.quaternions, feet.quaternions]),
        )
        bodies = body.forward(qpos)
        poses, by_tangent = body.jacobian(qpos, sites)
        # By the pose's own: the root moves by exp on the right of where its step has brought it.
        units = jnp.asarray(_ROOT_UNITS)
        turned = by_tangent[:, :, 3:6] @ rotations.right_jacobian(units[3:] * local[3:6])
        columns = 6 + np.array(self.active)
        by_local = jnp.concatenate(
            [
                by_tangent[:, :, :3] * units[:3],
                turned * units[3:],
                by_tangent[:, :, columns] * beliefs.pose_sigma,
            ],
            axis=2,
        )
        # By the lengths: every bone up to the site's own carries what comes after it along.
        frames = rotations.to_matrix(bodies.quaternions)
        along = jnp.einsum("bac,bc->ba", frames[2:], self.directions)
        by_bone = jnp.asarray(self._carries(sites))[:, None, :] * along.T[None]
        growth = outputs.lengths[_GROUPS][:, None] * beliefs.root[_GROUPS]
        by_length = by_bone @ growth
        # By the mounts.
        trackers = rotations.to_matrix(poses.quaternions[:J])
        first = GROUP_COUNT
        turns = TURN_UNIT * shared[first + 3 * J : first + 6 * J].reshape(J, 3)
        by_turn = TURN_UNIT * trackers @ rotations.right_jacobian(turns)
        by_place = beliefs.mount_sigma * frames[np.array(body.trackers.body)]
        # From movements in the world to whitened residuals.
        W = hold.position_weights[:, None, None] * hold.position_whiteners
        measured = rotations.to_matrix(hold.quaternions)
        error = rotations.log(
            rotations.multiply(rotations.conjugate(hold.quaternions), poses.quaternions[:J])
        )
        V = hold.orientation_weights[:, None, None] * (
            hold.orientation_whiteners
            @ rotations.inverse_left_jacobian(error)
            @ jnp.swapaxes(measured, 1, 2)
        )
        P = (hold.planted / beliefs.plant_sigma)[:, None, None]
        own = jnp.eye(J)
        position = jnp.concatenate(
            [
                W @ by_length[:J],
                jnp.einsum("jab,ji->jaib", W @ by_place, own).reshape(J, 3, 3 * J),
                jnp.zeros((J, 3, 3 * J + 6)),
            ],
            axis=2,
        )
        orientation = jnp.concatenate(
            [
                jnp.zeros((J, 3, first + 3 * J)),
                jnp.einsum("jab,ji->jaib", V @ by_turn, own).reshape(J, 3, 3 * J),
                jnp.zeros((J, 3, 6)),
            ],
            axis=2,
        )
        spots = -_SPOT_UNIT * jnp.eye(6).reshape(2, 3, 6)
        plant = P * jnp.concatenate([by_length[J:], jnp.zeros((2, 3, 6 * J)), spots], axis=2)
        size = self.shared_size
        own_rows = jnp.zeros((L, size))
        by_shared_rows = jnp.concatenate(
            [
                position.reshape(3 * J, size),
                orientation.reshape(3 * J, size),
                plant.reshape(6, size),
                own_rows,
            ]
        )
        penalties = jnp.concatenate([jnp.eye(L)[6:], FAINT * jnp.eye(L)[:6]])
        by_local_rows = jnp.concatenate(
            [
                (W @ by_local[:J, :3]).reshape(3 * J, L),
                (V @ by_local[:J, 3:]).reshape(3 * J, L),
                (P * by_local[J:, :3]).reshape(6, L),
                penalties,
            ]
        )
        return by_shared_rows, by_local_rows

    def _carries(self, sites: Sites) -> Float[np.ndarray, "sites 30"]:
        """1 where a bone's length moves a site."""
        carries = np.zeros((len(sites.body), len(BONES)))
        for row, carrier in enumerate(sites.body):
            body = carrier - 1  # the model counts the world as body 0
            while body > 0:
                carries[row, body - 1] = 1.0
                body = self.parents[body]
        return carries

    def shared_residual(self, shared: Float[Array, " s"]) -> Float[Array, " s"]:
        """Rows of the penalties on lengths and mounts."""
        J = self.tracker_count
        strength = np.concatenate([np.ones(GROUP_COUNT + 3 * J), np.full(3 * J + 6, FAINT)])
        return jnp.asarray(strength) * shared

    def _bone_vectors(self, lengths: Float[Array, "18"]) -> Float[Array, "30 3"]:
        return self.directions * lengths[_GROUPS][:, None]


class Linearized(NamedTuple):
    """Residuals and their derivatives, block by block.

    Attributes:
        shared_residual: of the penalties on shared unknowns.
        shared_jacobian: its derivative.
        residuals: of the poses.
        by_shared: their derivative by the shared unknowns.
        by_local: their derivative by the unknowns of their own pose.
    """

    shared_residual: Float[Array, " s"]
    shared_jacobian: Float[Array, "s s"]
    residuals: Float[Array, "N r"]
    by_shared: Float[Array, "N r s"]
    by_local: Float[Array, "N r l"]


class Problem(NamedTuple):
    """All that the residuals depend on besides the unknowns."""

    model: CalibrationModel
    holds: Holds
    beliefs: Beliefs
    start: Start


def split(problem: Problem, x: Float[Array, " n"]) -> tuple[Array, Array]:
    """The shared unknowns, and those of every pose."""
    s = problem.model.shared_size
    return x[:s], x[s:].reshape(-1, problem.model.local_size)


def residual(problem: Problem, x: Float[Array, " n"]) -> Float[Array, " m"]:
    """All rows in one vector."""
    shared, local = split(problem, x)
    rows = jax.vmap(_pose_residual, in_axes=(None, None, 0, 0, 0))(
        problem, shared, local, problem.holds, problem.start.roots
    )
    return jnp.concatenate([problem.model.shared_residual(shared), rows.ravel()])


def linearize(problem: Problem, x: Float[Array, " n"]) -> Linearized:
    """Residuals and Jacobian."""
    shared, local = split(problem, x)
    model, _, beliefs, start = problem

    def rows(s: Any, own: Any, hold: Any, root: Any) -> Any:
        residual = model.pose_residual(s, own, hold, root, beliefs, start)
        return residual, *model.pose_jacobian(s, own, hold, root, beliefs, start)

    residuals, by_shared, by_local = jax.vmap(rows, in_axes=(None, 0, 0, 0))(
        shared, local, problem.holds, problem.start.roots
    )
    penalty = problem.model.shared_residual
    return Linearized(penalty(shared), jax.jacfwd(penalty)(shared), residuals, by_shared, by_local)


def _pose_residual(problem: Problem, shared: Any, local: Any, hold: Any, root: Any) -> Any:
    model, _, beliefs, start = problem
    return model.pose_residual(shared, local, hold, root, beliefs, start)


def dense(linear: Linearized) -> Float[Array, "m n"]:
    """The whole Jacobian as one matrix."""
    N, r, s = linear.by_shared.shape
    l = linear.by_local.shape[2]  # noqa: E741
    local = jnp.zeros((N, r, N, l)).at[np.arange(N), :, np.arange(N), :].set(linear.by_local)
    below = jnp.concatenate([linear.by_shared.reshape(N * r, s), local.reshape(N * r, N * l)], 1)
    above = jnp.concatenate([linear.shared_jacobian, jnp.zeros((s, N * l))], axis=1)
    return jnp.concatenate([above, below])


def feet_of(ends: Sites) -> Sites:
    """The ankles of `FEET` among the ends of all bones."""
    rows = np.array([BODY_NAMES.index(foot) for foot in FEET])
    return Sites(
        body=tuple(ends.body[row] for row in rows),
        positions=ends.positions[rows],
        quaternions=ends.quaternions[rows],
    )


def _active(carriers: set[str]) -> tuple[int, ...]:
    moved: set[str] = set()
    parent = {bone.name: bone.parent for bone in BONES}
    for carrier in carriers:
        body = carrier
        while body != BODY_NAMES[0]:
            moved.add(body)
            body = parent[body]
    return tuple(i for i in range(DOF_COUNT) if DOF_BONES[i] in moved)
