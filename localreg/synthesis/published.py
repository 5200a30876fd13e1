"""The published methods and inverse kinematics, made from their settings."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg import jax_numerics as jax_numerics
from localreg.body.skeleton import DOF_COUNT, DOF_NAMES, joint_limits
from localreg.synthesis.baselines import (
    PAST_REGRESSIONS,
    InverseKinematics,
    LocalSubspace,
    PastRegression,
)
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
        starts=jnp.asarray(_ik_starts()),
        low=jnp.asarray(limits[:, 0]),
        high=jnp.asarray(limits[:, 1]),
        limit_softness=jnp.asarray(settings.limit_softness),
        root_position=jnp.asarray(settings.root_position),
        root_orientation=jnp.asarray(settings.root_orientation),
    )


# Poses that inverse kinematics begins from: angles [deg] that differ from the rest pose,
# in which the arms point sideways.
_STANDING = {"lhumerusrz": 70.0, "rhumerusrz": -70.0, "lradiusrx": 20.0, "rradiusrx": 20.0}
_IK_STARTS = (
    _STANDING,
    {},
    {**_STANDING, "lradiusrx": 90.0, "rradiusrx": 90.0},
    {"lhumerusrz": -60.0, "rhumerusrz": 60.0},
    {**_STANDING, "lfemurrx": -80.0, "rfemurrx": -80.0, "ltibiarx": 90.0, "rtibiarx": 90.0},
    {**_STANDING, "lfemurrx": -50.0, "ltibiarx": 60.0},
    {**_STANDING, "rfemurrx": -50.0, "rtibiarx": 60.0},
    {**_STANDING, "lowerbackrx": 30.0, "upperbackrx": 20.0, "thoraxrx": 20.0},
)


def _ik_starts() -> Float[ndarray, "S 56"]:
    starts = np.zeros((len(_IK_STARTS), DOF_COUNT))
    for row, pose in zip(starts, _IK_STARTS, strict=True):
        for name, degrees in pose.items():
            row[DOF_NAMES.index(name)] = np.radians(degrees)
    return starts
