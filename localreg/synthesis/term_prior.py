"""Priors in the form that papers give them: examples in, energy terms out, traced by JAX.

`FromTerms` makes a prior of them that the synthesizer can use. An example is a database
pose (the target) with its m predecessors and what the trackers would have said.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Final, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from numpy import ndarray

from localreg.database.neighbours import Query
from localreg.jax_numerics import host_arrays
from localreg.synthesis.energy import Gaussian, Term
from localreg.synthesis.examples import Examples, ExampleSource
from localreg.synthesis.observation import Observation
from localreg.synthesis.prior import Acquisition, Expectation, Prior
from localreg.synthesis.rival import Doubt
from localreg.synthesis.state import State
from localreg.synthesis.term_belief import belief_of_terms


class Question(NamedTuple):
    """What of a `localreg.database.neighbours.Query` terms may know, same names and shapes."""

    history: Float[Array, "m 56"]
    history_valid: Bool[Array, " m"]
    features: Float[Array, " f"]
    feature_trust: Float[Array, " f"]

    @classmethod
    def of(cls, query: Query) -> "Question":
        """The question of a query."""
        return cls(*host_arrays(*(getattr(query, name) for name in cls._fields)))


class Prediction(NamedTuple):
    """What a prior made of energy terms says of the present frame.

    Attributes:
        qpos: the expected pose, from which the solver starts.
        terms: the prior's share of the energy.
    """

    qpos: Float[Array, "63"]
    terms: tuple[Term, ...]


class Candidates(NamedTuple):
    """Where a prior made of energy terms looks for a pose from nothing.

    Attributes:
        starts: joint angles to start from, S of them [rad].
        gaussian: the prior over joint angles without a past.
    """

    starts: Float[Array, "S 56"]
    gaussian: Gaussian


class TermPrior(eqx.Module):
    """A prior in the form that papers give it: examples in, energy terms out."""

    @abstractmethod
    def predict(self, examples: Examples, question: Question, state: State) -> Prediction:
        """Predict the present frame from the past."""

    @abstractmethod
    def acquire(self, examples: Examples, question: Question) -> Candidates:
        """Say where to look when there is no past."""


@dataclass(frozen=True, eq=False)
class FromTerms(Prior):
    """A prior made of energy terms, over a source of examples.

    Attributes:
        prior: the terms.
        source: where examples come from; None for methods without a database.
    """

    prior: TermPrior
    source: ExampleSource | None

    def expect(self, query: Query, state: State) -> Expectation:
        """The terms' sum as one belief."""
        examples = self._examples(query)
        plain = state._replace(
            strain=None, lost=0, drift=None, near=None, signals=None, doubt=Doubt()
        )
        prediction = _predict(self.prior, examples, Question.of(query), plain)
        belief = belief_of_terms(np.asarray(prediction.qpos), prediction.terms)
        return Expectation(belief, confidence=float("nan") if self.source is None else 1.0)

    def most_alike(self, observation: Observation) -> Float[ndarray, "56"] | None:
        """The nearest database pose by positions alone."""
        if self.source is None:
            return None
        return self.source.most_alike(observation.positions, observation.position_mask)

    def acquire(self, query: Query) -> Acquisition:
        """The candidates, on the host."""
        examples = self._examples(query)
        found = _acquire(self.prior, examples, Question.of(query))
        whitening = np.asarray(found.gaussian.whitening)
        return Acquisition(
            np.asarray(found.starts), np.asarray(found.gaussian.mean), whitening.T @ whitening
        )

    def _examples(self, query: Query) -> Examples:
        return NO_EXAMPLES if self.source is None else self.source.find(query)


@jax.jit
def _predict(prior: TermPrior, examples: Examples, question: Question, state: State) -> Prediction:
    return prior.predict(_doubles(examples), question, state)


@jax.jit
def _acquire(prior: TermPrior, examples: Examples, question: Question) -> Candidates:
    return prior.acquire(_doubles(examples), question)


def _doubles(examples: Examples) -> Examples:
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype=float), examples)


NO_EXAMPLES: Final = Examples(
    *host_arrays(np.zeros((0, 1, 56)), np.zeros((0, 2, 7)), np.zeros((0, 0)), np.zeros(0))
)
"""What methods without a database are given."""
