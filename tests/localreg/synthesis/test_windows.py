"""Inputs and outputs of the regressions, worked out for the whole database at once."""

from dataclasses import replace

import numpy as np
import pytest
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body import chain
from localreg.synthesis.local_regression import LocalRegression
from localreg.synthesis.synthesizer import Synthesizer
from localreg.synthesis.windows import steps


@pytest.fixture(scope="module")
def prior(localreg: Synthesizer) -> LocalRegression:
    assert isinstance(localreg.prior, LocalRegression)
    return localreg.prior


@pytest.fixture(scope="module")
def rows(prior: LocalRegression) -> ndarray:
    return np.flatnonzero(prior.source.targets)[::17]


def raw_inputs(prior: LocalRegression, rows: ndarray) -> ndarray:
    database = prior.source.database
    past = database.histories(rows, 3).reshape(len(rows), -1)
    return np.hstack([past, prior.source.features[rows]]).astype(float)


def test_a_step_leads_from_a_pose_to_the_next(prior, rows):
    database = prior.source.database
    for row, step in zip(rows, prior.experience.steps.of(rows), strict=True):
        before, now = (
            np.concatenate([database.roots[at], database.angles[at]]).astype(float)
            for at in (row - 1, row)
        )
        turned = step.astype(float)
        turned[:3] = Rotation.from_quat(before[3:7], scalar_first=True).apply(step[:3])
        reached, away = np.empty(63), np.empty(62)
        chain.integrate(before, turned, reached)
        chain.difference(reached, now, away)
        turns = np.round(away[6:] / (2.0 * np.pi))
        np.testing.assert_allclose(away[:6], 0.0, atol=1e-6)
        np.testing.assert_allclose(away[6:], 2.0 * np.pi * turns, atol=1e-5)


def test_no_angle_steps_by_more_than_half_a_turn(prior):
    found = steps(prior.source.database, prior.source.targets)
    rows = np.flatnonzero(prior.source.targets)
    assert np.abs(found.of(rows)[:, 6:]).max() <= np.pi + 1e-6
    assert not found.root[~prior.source.targets].any()


def test_a_turn_of_the_stored_angles_is_no_step(prior):
    found = steps(prior.source.database, prior.source.targets)
    rows = np.flatnonzero(prior.source.targets)[:50]
    turned = found.angles.copy()
    turned[rows[10] :] += np.float32(2.0 * np.pi)
    np.testing.assert_allclose(replace(found, angles=turned).of(rows), found.of(rows), atol=1e-5)


@pytest.mark.parametrize("kind", ["pose", "step"])
def test_what_is_stored_is_what_a_query_is_reduced_to(prior, rows, kind):
    inputs = getattr(prior.experience, kind)
    raw = raw_inputs(prior, rows)[:, : len(inputs.noise)]
    reduced = inputs.reduce(raw, np.ones(len(inputs.noise)))
    np.testing.assert_array_equal(inputs.reduce(raw), reduced)
    np.testing.assert_allclose(inputs.of(rows), reduced, atol=0.02)
    np.testing.assert_allclose(
        replace(inputs, reduced=None).of(rows, np.ones(raw.shape[1])), reduced, atol=1e-3
    )


@pytest.mark.parametrize("kind", ["pose", "step"])
def test_what_is_not_known_has_no_part_in_it(prior, rows, kind):
    inputs = getattr(prior.experience, kind)
    raw = raw_inputs(prior, rows)[:, : len(inputs.noise)]
    trust = (np.random.default_rng(0).random(len(inputs.noise)) < 0.6).astype(float)
    garbled = np.where(trust > 0.0, raw, 1e3)
    np.testing.assert_array_equal(inputs.reduce(raw, trust), inputs.reduce(garbled, trust))
    assert np.abs(inputs.reduce(raw, trust)).max() > 0.1
    assert not inputs.reduce(raw, np.zeros(len(trust))).any()


@pytest.mark.parametrize("kind", ["pose", "step"])
def test_directions_are_orthonormal_and_the_first_says_most(prior, rows, kind):
    inputs = getattr(prior.experience, kind)
    basis = inputs.onto * inputs.noise[:, None]
    np.testing.assert_allclose(basis.T @ basis, np.eye(basis.shape[1]), atol=1e-5)
    every = np.flatnonzero(prior.source.targets)
    spread = inputs.of(every).std(axis=0)
    assert spread[0] == spread.max() > 3.0 * spread[-1]
