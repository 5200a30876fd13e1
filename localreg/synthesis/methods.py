"""Estimators by name: which prior, with which settings, over which database."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from localreg import numerics as numerics
from localreg.body.chain import Chain
from localreg.body.kinematics import Kinematics, chain_of
from localreg.body.skeleton import DOF_COUNT, DOF_NAMES, joint_limits
from localreg.body.subject import Subject
from localreg.database.features import FeatureLayout
from localreg.database.neighbours import Metric
from localreg.database.store import DEFAULT_RATE, PoseDatabase
from localreg.database.view import subject_view
from localreg.errors import SynthesisError
from localreg.synthesis.baselines import (
    PAST_REGRESSIONS,
    InverseKinematics,
    LocalSubspace,
    PastRegression,
)
from localreg.synthesis.examples import ExampleSource, example_source
from localreg.synthesis.local_regression import LocalRegression
from localreg.synthesis.prior import Prior
from localreg.synthesis.settings import METHODS, Settings
from localreg.synthesis.synthesizer import Synthesizer
from localreg.synthesis.term_prior import FromTerms, TermPrior

__all__ = ["METHODS", "build_estimator", "build_synthesizer"]


def build_estimator(
    method: str,
    subject: Subject,
    database: PoseDatabase | None = None,
    allowed: Bool[ndarray, " poses"] | None = None,
) -> Synthesizer:
    """An estimator by the name of its method.

    Args:
        method: one of `METHODS`.
        subject: whose body is moved, wearing the trackers that frames will hold.
        database: the poses to learn from; not needed by `"ik"`.
        allowed: which of its poses may be used; all by default.

    Raises:
        SynthesisError: there is no such method, or it needs a database.
        DatabaseError: nothing is left to learn from.
    """
    if method not in METHODS:
        raise SynthesisError(f"there is no method {method!r}; choose one of {', '.join(METHODS)}")
    return build_synthesizer(METHODS[method], subject, database, allowed)


def build_synthesizer(
    settings: Settings,
    subject: Subject,
    database: PoseDatabase | None = None,
    allowed: Bool[ndarray, " poses"] | None = None,
) -> Synthesizer:
    """An estimator by its settings; arguments and errors as in `build_estimator`."""
    kinematics = Kinematics.from_subject(subject)
    if settings.prior == "ik":
        rate = DEFAULT_RATE if database is None else database.rate
        prior = FromTerms(_inverse_kinematics(settings), None)
        return Synthesizer(subject, rate, settings, kinematics, prior)
    if database is None:
        raise SynthesisError(f"the prior {settings.prior!r} needs a database; build one first")
    layout = FeatureLayout.of(subject)
    view = subject_view(database, layout, kinematics, _metric(settings, layout))
    chain = chain_of(kinematics)

    def build(allowed: Bool[ndarray, " poses"] | None) -> Synthesizer:
        source = example_source(view, allowed, settings.neighbours)
        prior = _database_prior(settings, layout, source, chain)
        return Synthesizer(subject, database.rate, settings, kinematics, prior, build)

    return build(allowed)


def _metric(settings: Settings, layout: FeatureLayout) -> Metric:
    weights = _columns(layout, settings.metric_position, settings.metric_rotation)
    return Metric(np.array(settings.metric_history), weights)


def _columns(layout: FeatureLayout, position: float, rotation: float) -> Float[ndarray, " f"]:
    trackers = 1 + len(layout.others)
    return layout.columns(np.full(trackers, position), np.full(trackers, rotation))


def _database_prior(
    settings: Settings, layout: FeatureLayout, source: ExampleSource, chain: Chain
) -> Prior:
    if settings.prior == "localreg":
        noise = _columns(layout, settings.feature_position_noise, settings.feature_rotation_noise)
        return LocalRegression.over(source, settings, noise, chain)
    return FromTerms(_published(settings), source)


def _published(settings: Settings) -> TermPrior:
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
