"""Forward kinematics and geometric Jacobian in JAX, generated from a MuJoCo model.

A pose is `qpos` as in MuJoCo: root position, root quaternion w x y z, joint angles. A
pose moves in the tangent space as MuJoCo's `qvel`: root translation in world axes, root
rotation vector in the root's own axes, joint angles.
"""

from typing import NamedTuple, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from localreg import jax_numerics as jax_numerics
from localreg.body import rotations
from localreg.body.chain import Chain, chain_of_model
from localreg.body.model import build_model, end_site, tracker_site
from localreg.body.skeleton import BODY_NAMES
from localreg.body.subject import Subject


class BodyPoses(NamedTuple):
    """World pose of every body: origin [m] and quaternion w x y z."""

    positions: Float[Array, "*b bodies 3"]
    quaternions: Float[Array, "*b bodies 4"]


class SitePoses(NamedTuple):
    """World pose of some sites: position [m] and quaternion w x y z."""

    positions: Float[Array, "*b sites 3"]
    quaternions: Float[Array, "*b sites 4"]


class Sites(eqx.Module):
    """Points fixed to bodies: which body carries each, and the pose in its frame."""

    body: tuple[int, ...] = eqx.field(static=True)
    positions: Float[Array, "sites 3"]
    quaternions: Float[Array, "sites 4"]


class Kinematics(eqx.Module):
    """The kinematic tree of one subject.

    Hinges sit at their body's origin, at most three a body, under one free root: all that
    `build_model` makes. The arrays are traced, so subjects share one compiled program;
    the tree's shape is static.
    """

    offsets: Float[Array, "bodies 3"]
    orientations: Float[Array, "bodies 4"]
    hinge_axes: Float[Array, "bodies 3 3"]
    trackers: Sites
    ends: Sites
    # The tree: hinge slots of each body (-1: none) and, for pointer doubling, the
    # ancestor 1, 2, 4 ... steps up (the world, index 0, is its own parent).
    hinge_index: tuple[tuple[int, int, int], ...] = eqx.field(static=True)
    ancestors: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    hinge_body: tuple[int, ...] = eqx.field(static=True)
    hinge_slot: tuple[int, ...] = eqx.field(static=True)

    @classmethod
    def from_model(cls, model: mujoco.MjModel, tracker_sites: list[str]) -> Self:
        """Read the tree, its dimensions and its sites from a compiled model.

        Raises:
            ValueError: as in `chain_of_model`.
        """
        ends = chain_of_model(model, [end_site(name) for name in BODY_NAMES])
        return cls.from_chain(chain_of_model(model, tracker_sites), _sites(ends))

    @classmethod
    def from_chain(cls, chain: Chain, ends: Sites | None = None) -> Self:
        """The tree of compiled code; without bone ends unless they are given."""
        counts = chain.hinge_count
        body = np.repeat(np.arange(len(counts)), counts)
        slot = np.arange(len(body)) - chain.first_hinge[body]
        index = np.full((len(counts), 3), -1)
        index[body, slot] = np.arange(len(body))
        axes = np.zeros((len(counts), 3, 3))
        axes[:, :, 0] = 1.0
        axes[body, slot] = chain.hinge_axis
        return cls(
            offsets=jnp.asarray(chain.offset),
            orientations=jnp.asarray(chain.orientation),
            hinge_axes=jnp.asarray(axes),
            trackers=_sites(chain),
            ends=ends or Sites((), jnp.zeros((0, 3)), jnp.zeros((0, 4))),
            hinge_index=tuple((a, b, c) for a, b, c in index.tolist()),
            ancestors=_doubling(chain.parent),
            hinge_body=tuple(body.tolist()),
            hinge_slot=tuple(slot.tolist()),
        )

    @classmethod
    def from_subject(cls, subject: Subject) -> Self:
        """The kinematics of a subject's body, with the trackers it wears."""
        return cls.from_model(build_model(subject), [tracker_site(t) for t in subject.trackers])

    def forward(self, qpos: Float[Array, " 63"]) -> BodyPoses:
        """World poses of all bodies (index 0 is the world itself)."""
        return self._chain(qpos)[0]

    def site_poses(self, poses: BodyPoses, sites: Sites) -> SitePoses:
        """World poses of sites, given the poses of the bodies."""
        quaternions = poses.quaternions[np.array(sites.body)]
        return SitePoses(
            poses.positions[np.array(sites.body)] + rotations.rotate(quaternions, sites.positions),
            rotations.multiply(quaternions, sites.quaternions),
        )

    def bone_ends(self, qpos: Float[Array, " 63"]) -> Float[Array, "31 3"]:
        """World positions of the root and of the far ends of the 30 bones [m]."""
        return self.site_poses(self.forward(qpos), self.ends).positions

    def tracker_poses(self, qpos: Float[Array, " 63"]) -> SitePoses:
        """World poses that the trackers should report."""
        return self.site_poses(self.forward(qpos), self.trackers)

    def jacobian(
        self, qpos: Float[Array, " 63"], sites: Sites
    ) -> tuple[SitePoses, Float[Array, "sites 6 62"]]:
        """Poses of sites and their derivative by the pose's 62 tangent coordinates.

        Rows 0 to 2 are the velocity of the site's position, rows 3 to 5 its angular
        velocity, both in world axes: `mj_jacSite` stacked.
        """
        poses, axes = self._chain(qpos)
        site = self.site_poses(poses, sites)
        body, slot = np.array(self.hinge_body), np.array(self.hinge_slot)
        hinge_axes = axes[body, slot]
        arms = site.positions[:, None, :] - poses.positions[body][None, :, :]
        moves = jnp.asarray(self._is_moved(sites))[:, :, None]
        linear = jnp.where(moves, rotations.cross(hinge_axes[None], arms), 0.0)
        angular = jnp.where(moves, hinge_axes[None], 0.0)
        root = rotations.to_matrix(poses.quaternions[1]).T  # rows: root axes in the world
        root_arms = (site.positions - poses.positions[1])[:, None, :]
        identity = jnp.broadcast_to(jnp.eye(3, dtype=qpos.dtype), (len(sites.body), 3, 3))
        linear = jnp.concatenate([identity, rotations.cross(root[None], root_arms), linear], axis=1)
        angular = jnp.concatenate(
            [jnp.zeros_like(identity), jnp.broadcast_to(root, identity.shape), angular], axis=1
        )
        return site, jnp.swapaxes(jnp.concatenate([linear, angular], axis=2), 1, 2)

    def _chain(self, qpos: Float[Array, " 63"]) -> tuple[BodyPoses, Float[Array, "bodies 3 3"]]:
        """Body poses, and every hinge slot's axis in the world.

        Pointer doubling composes the chain in log2(depth) rounds over all bodies at
        once; XLA runs it several times faster than a loop over bodies.
        """
        angles = jnp.concatenate([qpos[7:], jnp.zeros(1, qpos.dtype)])[np.array(self.hinge_index)]
        turns = rotations.hinge(self.hinge_axes, angles)
        first = rotations.multiply(self.orientations, turns[:, 0])
        second = rotations.multiply(first, turns[:, 1])
        q = rotations.multiply(second, turns[:, 2]).at[1].set(qpos[3:7])
        p = self.offsets.at[1].set(qpos[:3])
        for ancestor in self.ancestors:
            above = np.array(ancestor)
            p = p[above] + rotations.rotate(q[above], p)
            q = rotations.multiply(q[above], q)
        parent = q[np.array(self.ancestors[0])]
        before = jnp.stack([self.orientations, first, second], axis=1)
        axes = rotations.rotate(rotations.multiply(parent[:, None], before), self.hinge_axes)
        return BodyPoses(p, q), axes

    def _is_moved(self, sites: Sites) -> Bool[np.ndarray, "sites hinges"]:
        parents = self.ancestors[0]
        moved = np.zeros((len(sites.body), len(self.hinge_body)), dtype=bool)
        hinges = np.array(self.hinge_body)
        for row, carrier in enumerate(sites.body):
            body = carrier
            while body:
                moved[row] |= hinges == body
                body = parents[body]
        return moved


def integrate(qpos: Float[Array, " 63"], step: Float[Array, " 62"]) -> Float[Array, " 63"]:
    """The pose moved by a tangent step, as `mj_integratePos` with dt = 1."""
    root = rotations.multiply(qpos[3:7], rotations.exp(step[3:6]))
    return jnp.concatenate([qpos[:3] + step[:3], root, qpos[7:] + step[6:]])


def difference(start: Float[Array, " 63"], end: Float[Array, " 63"]) -> Float[Array, " 62"]:
    """The tangent step from one pose to another: `integrate(start, step) == end`."""
    root = rotations.log(rotations.multiply(rotations.conjugate(start[3:7]), end[3:7]))
    return jnp.concatenate([end[:3] - start[:3], root, end[7:] - start[7:]])


@eqx.filter_jit
def bone_ends_batch(
    kinematics: Kinematics, qpos: Float[Array, "frames 63"]
) -> Float[Array, "frames 31 3"]:
    """`Kinematics.bone_ends` for many poses at once."""
    return jax.vmap(kinematics.bone_ends)(qpos)


@eqx.filter_jit
def tracker_poses_batch(kinematics: Kinematics, qpos: Float[Array, "frames 63"]) -> SitePoses:
    """`Kinematics.tracker_poses` for many poses at once."""
    return jax.vmap(kinematics.tracker_poses)(qpos)


def _sites(chain: Chain) -> Sites:
    return Sites(
        body=tuple(chain.site_body.tolist()),
        positions=jnp.asarray(chain.site_position),
        quaternions=jnp.asarray(chain.site_orientation),
    )


def _doubling(parents: Int[np.ndarray, " bodies"]) -> tuple[tuple[int, ...], ...]:
    rounds, above = [], np.asarray(parents)
    while np.any(above > 0):
        rounds.append(tuple(int(a) for a in above))
        above = above[above]
    return tuple(rounds)
