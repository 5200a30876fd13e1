"""Estimators by name: which prior, with which settings, over which database."""

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from localreg.body.chain import Chain, chain_of
from localreg.body.subject import Subject
from localreg.database.features import FeatureLayout
from localreg.database.neighbours import Metric
from localreg.database.store import DEFAULT_RATE, PoseDatabase
from localreg.database.view import subject_view
from localreg.errors import SynthesisError
from localreg.synthesis.examples import ExampleSource, example_source
from localreg.synthesis.local_regression import LocalRegression
from localreg.synthesis.prior import Prior
from localreg.synthesis.settings import METHODS, Settings
from localreg.synthesis.synthesizer import Synthesizer

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
    chain = chain_of(subject)
    if settings.prior == "ik":
        rate = DEFAULT_RATE if database is None else database.rate
        return Synthesizer(subject, rate, settings, chain, _published(settings, None))
    if database is None:
        raise SynthesisError(f"the prior {settings.prior!r} needs a database; build one first")
    layout = FeatureLayout.of(subject)
    view = subject_view(database, layout, chain, _metric(settings, layout))

    def build(allowed: Bool[ndarray, " poses"] | None) -> Synthesizer:
        source = example_source(view, allowed, settings.neighbours)
        prior = _database_prior(settings, layout, source, chain)
        return Synthesizer(subject, database.rate, settings, chain, prior, build)

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
        return LocalRegression.over(source, settings, noise, chain, layout)
    return _published(settings, source)


def _published(settings: Settings, source: ExampleSource | None) -> Prior:
    # They are traced by JAX, which the default method does without.
    from localreg.synthesis.published import published_prior

    return published_prior(settings, source)
