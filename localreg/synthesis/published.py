"""The published methods and inverse kinematics, made from their settings."""

import jax.numpy as jnp

from localreg import jax_numerics as jax_numerics
from localreg.body.skeleton import joint_limits
from localreg.synthesis.baselines import (
    PAST_REGRESSIONS,
    InverseKinematics,
    LocalSubspace,
    PastRegression,
)
from localreg.synthesis.easy_poses import easy_poses
from localreg.synthesis.examples import ExampleSource
from localreg.synthesis.settings import Settings
from localreg.synthesis.term_prior import FromTerms, TermPrior


def published_prior(settings: Settings, source: ExampleSource | None) -> FromTerms:
    """Any prior but the default one; `"ik"` alone needs no source of examples."""
    return FromTerms(_term_prior(settings), source)


def _term_prior(settings: Settings) -> TermPrior:
    if settings.prior == "ik":
        return _inverse_kinematics(settings)
    floor = jnp.asarray(settings.floor)
    root = jnp.asarray(settings.root_position), jnp.asarray(settings.root_orientation)
    if settings.prior == "lpca":
        return LocalSubspace(settings.rank, floor, jnp.asarray(settings.smoothness), *root)
    return PastRegression(PAST_REGRESSIONS[settings.prior], settings.rank, floor, *root)


def _inverse_kinematics(settings: Settings) -> InverseKinematics:
    limits = joint_limits()
    return InverseKinematics(
        previous_pose=jnp.asarray(settings.previous_pose),
        starts=jnp.asarray(easy_poses()),
        low=jnp.asarray(limits[:, 0]),
        high=jnp.asarray(limits[:, 1]),
        limit_softness=jnp.asarray(settings.limit_softness),
        root_position=jnp.asarray(settings.root_position),
        root_orientation=jnp.asarray(settings.root_orientation),
    )
