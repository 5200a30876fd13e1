"""The compiled solver against the optimistix reference, on frames of real walks and worse."""

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body import chain
from localreg.evaluation.trackers import TrackerQuality, simulate_trackers
from localreg.synthesis.belief import NO_LIMITS, Belief, Limits
from localreg.synthesis.energy import energy
from localreg.synthesis.solver import SOLVERS, Problem, Solution, Solver
from tests.localreg.synthesis.exact_solvers import CAP, COMPILED, REFERENCE
from tests.localreg.synthesis.planted import observe, planted, standing_pose, terms_of
from tests.localreg.synthesis.sessions import follow

SAME = 1e-6
energy_of = eqx.filter_jit(energy)


class Case(NamedTuple):
    problem: Problem
    start: ndarray


@dataclass(frozen=True)
class Recording(Solver):
    """Solves, and keeps what it was asked."""

    cases: list[Case] = field(default_factory=list)

    def solve(self, problem: Problem, start: ndarray, max_steps: int) -> Solution:
        self.cases.append(Case(problem, start.copy()))
        return SOLVERS["compiled"]().solve(problem, start, max_steps)


def moved(qpos: ndarray, seed: int, far: float) -> ndarray:
    out = np.empty(63)
    chain.integrate(qpos, far * np.random.default_rng(seed).normal(size=62), out)
    return out


def made_case(seed: int) -> Case:
    """Anything: masks, outliers, correlated beliefs, broken limits, starts that are off."""
    rng = np.random.default_rng(seed)
    truth = standing_pose(seed)
    observation = observe(truth, rng.random(6) < 0.8, rng.random(6) < 0.8)
    positions = observation.positions + 0.005 * rng.normal(size=(6, 3))
    positions += (rng.random((6, 1)) < 0.1) * rng.normal(size=(6, 3))
    turns = Rotation.from_rotvec(
        (0.02 + (rng.random((6, 1)) < 0.1)) * rng.normal(size=(6, 3))
    ) * Rotation.from_quat(observation.quaternions, scalar_first=True)
    observation = observation._replace(
        positions=positions, quaternions=turns.as_quat(scalar_first=True)
    )
    root = rng.normal(size=(62, 62)) / 8.0 + np.eye(62)
    whitening = root / rng.uniform(0.01, 0.5, 62)
    ends = np.sort(truth[7:] + 0.3 * rng.normal(size=(2, 56)), axis=0)
    limits = Limits(
        np.where(rng.random(56) < 0.3, ends[0], -np.inf),
        np.where(rng.random(56) < 0.3, ends[1], np.inf),
        0.05,
    )
    belief = Belief(
        moved(truth, seed + 1, 0.1),
        0.05 * rng.normal(size=62),
        whitening.T @ whitening,
        limits if rng.random() < 0.3 else NO_LIMITS,
    )
    start = moved(truth, seed + 2, rng.choice([0.01, 0.1]))
    return Case(planted(observation, belief, rng.choice([1.0, 9.0, 100.0])), start)


@pytest.fixture(scope="module")
def walked(localreg, walk, walks) -> list[Case]:
    """Frames of two walks, with dropouts and outliers; among them those of cold starts."""
    recording = Recording()
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(SOLVERS, "recording", lambda: recording)
        estimator = replace(localreg, settings=replace(localreg.settings, solver="recording"))
        for motion in (walk, walks["69_04"]):
            quality = TrackerQuality(dropout=0.1, outliers=0.03)
            follow(estimator, list(simulate_trackers(motion, quality))[:70])
    return recording.cases


@pytest.fixture(scope="module")
def made() -> list[Case]:
    return [made_case(seed) for seed in range(120)]


@pytest.fixture(params=["walked", "made"])
def cases(request: pytest.FixtureRequest) -> list[Case]:
    return request.getfixturevalue(request.param)


def terms_energy(problem: Problem, qpos: ndarray) -> float:
    return float(energy_of(terms_of(problem), jnp.asarray(qpos)))


def near(one: float, other: float) -> bool:
    return abs(one - other) <= SAME * (1.0 + abs(other))


def test_both_find_the_same_minima(cases):
    """From one start they may part for two valleys; then neither can leave the other's."""
    parted = 0
    for problem, start in cases:
        ours, theirs = (solver.solve(problem, start, CAP) for solver in (COMPILED, REFERENCE))
        before = terms_energy(problem, start)
        assert ours.ok
        assert max(ours.energy, theirs.energy) <= before * (1.0 + 1e-12)
        assert ours.energy == pytest.approx(terms_energy(problem, ours.qpos), rel=1e-9)
        np.testing.assert_allclose(ours.hessian, ours.hessian.T)
        assert np.linalg.eigvalsh(ours.hessian)[0] > 0.0
        if not near(ours.energy, theirs.energy):
            parted += 1
            for solver, found in ((REFERENCE, ours), (COMPILED, theirs)):
                if found.steps < CAP:
                    stayed = solver.solve(problem, found.qpos, CAP)
                    assert near(stayed.energy, found.energy)
    assert parted <= 0.1 * len(cases)


def test_both_say_the_same_of_what_they_found():
    """Where trackers fit, also of how sharp the minimum is; with outliers Hessians differ."""
    truth = standing_pose(1)
    belief = made_case(1).problem.belief._replace(qpos=truth, mean=np.zeros(62))
    problem = planted(observe(truth), belief._replace(limits=NO_LIMITS))
    start = moved(truth, 2, 0.05)
    ours, theirs = (solver.solve(problem, start, CAP) for solver in (COMPILED, REFERENCE))
    np.testing.assert_allclose(ours.qpos, theirs.qpos, atol=1e-6)
    np.testing.assert_allclose(ours.position_errors, theirs.position_errors, atol=1e-6)
    np.testing.assert_allclose(ours.orientation_errors, theirs.orientation_errors, atol=1e-6)
    np.testing.assert_allclose(ours.orientations, theirs.orientations, atol=1e-6)
    scale = np.abs(theirs.hessian).max()
    np.testing.assert_allclose(ours.hessian, theirs.hessian, atol=1e-6 * scale)
