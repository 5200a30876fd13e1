"""A belief is worth what its terms are, and its terms what it is, up to a constant."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from numpy import ndarray

from localreg.body import chain
from localreg.errors import SynthesisError
from localreg.synthesis.belief import NO_LIMITS, Belief, Limits
from localreg.synthesis.compiled import Control, energy_at
from localreg.synthesis.energy import (
    Gaussian,
    LimitTerm,
    PriorTerm,
    RootTerm,
    StepTerm,
    Term,
    energy,
)
from localreg.synthesis.term_belief import belief_of_terms, terms_of_belief
from tests.localreg.synthesis.planted import CHAIN, NONE, observe, standing_pose

energy_of = eqx.filter_jit(energy)
EXPECTED = standing_pose(1)


def random_gaussian(seed: int, size: int = 56) -> Gaussian:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(size, size)) + 5.0 * np.eye(size)
    return Gaussian.from_covariance(
        jnp.asarray(0.1 * rng.normal(size=size)), jnp.asarray(0.01 * root @ root.T)
    )


def limit_term(infinite: bool) -> LimitTerm:
    low, high = np.full(56, -0.2), np.linspace(0.0, 0.4, 56)
    if infinite:
        low[::3], high[::4] = -np.inf, np.inf
    return LimitTerm(jnp.asarray(low), jnp.asarray(high), jnp.asarray(0.05))


def root_term() -> RootTerm:
    return RootTerm(jnp.asarray(EXPECTED), jnp.asarray(0.1), jnp.asarray(0.3))


def poses() -> list[ndarray]:
    """About the expected one, the root turned as well."""
    found = []
    for seed in range(8):
        qpos = np.empty(63)
        step = 0.4 * np.random.default_rng(seed).normal(size=62)
        chain.integrate(EXPECTED, step, qpos)
        found.append(qpos)
    return found


def belief_energy(belief: Belief, qpos: ndarray) -> float:
    """As the compiled solver has it, with no tracker measured."""
    placed = chain.blank_placed(CHAIN)
    errors = np.zeros((6, 3)), np.zeros((6, 3))
    room = np.empty(62), np.empty(62)
    control = Control(0.005, 0.02, np.full((6, 2), 9.0))
    trackers = observe(EXPECTED, NONE, NONE)
    return energy_at(CHAIN, trackers, control, belief, qpos, placed, errors, *room)


def assert_constant(differences: list[float], size: float) -> None:
    np.testing.assert_allclose(differences, differences[0], atol=1e-9 * max(1.0, size))


TERMS: dict[str, tuple[Term, ...]] = {
    "one Gaussian": (PriorTerm(random_gaussian(1)),),
    "two Gaussians": (PriorTerm(random_gaussian(1)), PriorTerm(random_gaussian(2))),
    "with a root": (PriorTerm(random_gaussian(1)), root_term()),
    "root alone": (root_term(),),
    "with limits": (PriorTerm(random_gaussian(1)), limit_term(False), root_term()),
    "with limits on some": (PriorTerm(random_gaussian(1)), limit_term(True), root_term()),
    "limits alone": (limit_term(True),),
}


@pytest.mark.parametrize("terms", TERMS.values(), ids=TERMS.keys())
def test_the_belief_of_terms_is_worth_what_they_are(terms):
    belief = belief_of_terms(EXPECTED, terms)
    theirs = [float(energy_of(terms, jnp.asarray(qpos))) for qpos in poses()]
    ours = [belief_energy(belief, qpos) for qpos in poses()]
    assert np.ptp(theirs) > 1.0
    assert_constant([a - b for a, b in zip(ours, theirs, strict=True)], max(theirs))


@pytest.mark.parametrize("terms", TERMS.values(), ids=TERMS.keys())
def test_the_belief_expects_the_most_likely_pose(terms):
    """Where no limit is in the way nothing has less energy."""
    belief = belief_of_terms(EXPECTED, terms)._replace(limits=NO_LIMITS)
    assert np.all(np.isfinite(belief.mean))
    best = np.empty(63)
    chain.integrate(EXPECTED, belief.mean, best)
    assert belief_energy(belief, best) == pytest.approx(0.0, abs=1e-9)


def test_a_term_that_is_no_gaussian_over_the_deviation_is_refused():
    step = StepTerm(jnp.asarray(EXPECTED), random_gaussian(3, 62))
    with pytest.raises(SynthesisError, match="StepTerm is no part of a prior's belief"):
        belief_of_terms(EXPECTED, (step,))


@pytest.mark.parametrize("rank", [0, 10, 62])
@pytest.mark.parametrize("limited", [False, True])
def test_the_terms_of_a_belief_are_worth_what_it_is(rank, limited):
    """Also of one that knows nothing in some directions, or at all."""
    rng = np.random.default_rng(rank)
    root = 10.0 * rng.normal(size=(rank, 62))
    limits = Limits(*(np.array(end) for end in (limit_term(True).low, limit_term(True).high)), 0.05)
    belief = Belief(
        EXPECTED, 0.1 * rng.normal(size=62), root.T @ root, limits if limited else NO_LIMITS
    )
    terms = terms_of_belief(belief)
    for qpos in poses():
        theirs = float(energy_of(terms, jnp.asarray(qpos)))
        assert belief_energy(belief, qpos) == pytest.approx(theirs, rel=1e-9, abs=1e-9)
        assert theirs > 0.0 or (rank == 0 and not limited)
