"""A pose is recognized by its trackers' positions, whichever way it faces."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from localreg.database.features import FeatureLayout
from localreg.database.resemblance import Lineup

LAYOUT = FeatureLayout(1, (0, 2, 3))
EVERYBODY = np.ones(4, dtype=bool)


@pytest.fixture(scope="module")
def poses():
    """Tracker positions of 200 poses in the world [m], and their features."""
    rng = np.random.default_rng(0)
    positions = rng.normal(scale=0.5, size=(200, 4, 3))
    turns = Rotation.random(200 * 4, rng=rng).as_quat(scalar_first=True).reshape(200, 4, 4)
    return positions, LAYOUT.extract(positions, turns)


def lineup(features):
    return Lineup.of(LAYOUT, features, np.ones(len(features), dtype=bool))


@pytest.mark.parametrize("heading", [0.0, 1.0, np.pi])
@pytest.mark.parametrize("missing", [None, 0, LAYOUT.reference])
def test_the_pose_itself_is_found_anywhere_in_the_room(poses, heading, missing):
    positions, features = poses
    turn = Rotation.from_euler("z", heading)
    noise = np.random.default_rng(1).normal(scale=0.01, size=(4, 3))
    seen = EVERYBODY.copy()
    here = turn.apply(positions[17]) + np.array([3.0, -2.0, 0.4]) + noise
    if missing is not None:
        seen[missing], here[missing] = False, 99.0
    assert lineup(features).most_alike(here, seen) == 17


def test_up_is_up(poses):
    """The same positions upside down are another pose."""
    positions, features = poses
    over = Rotation.from_euler("x", np.pi).apply(positions[17])
    assert lineup(features).most_alike(over, EVERYBODY) != 17


def test_only_allowed_rows_are_found(poses):
    positions, features = poses
    allowed = np.arange(200) != 17
    found = Lineup.of(LAYOUT, features, allowed).most_alike(positions[17], EVERYBODY)
    assert found is not None
    assert allowed[found]


def test_it_is_the_nearest_after_the_best_turn(poses):
    """By brute force over many turns."""
    positions, features = poses
    here = np.random.default_rng(2).normal(scale=0.5, size=(4, 3))
    centered = positions - positions.mean(axis=1, keepdims=True)
    turns = Rotation.from_euler("z", np.linspace(0.0, 2.0 * np.pi, 721)[:, None]).as_matrix()
    turned = np.einsum("tij,nkj->tnki", turns, centered)
    apart = np.sum(np.square(turned - (here - here.mean(axis=0))), axis=(2, 3)).min(axis=0)
    assert lineup(features).most_alike(here, EVERYBODY) == np.argmin(apart)


def test_two_positions_are_too_few(poses):
    positions, features = poses
    seen = np.array([True, True, False, False])
    assert lineup(features).most_alike(positions[0], seen) is None
    nobody = Lineup.of(LAYOUT, features, np.zeros(200, dtype=bool))
    assert nobody.most_alike(positions[0], EVERYBODY) is None


def test_of_a_large_database_some_poses_are_looked_at(poses, monkeypatch):
    positions, features = poses
    monkeypatch.setattr("localreg.database.resemblance._LOOKED_AT", 50)
    found = lineup(features).most_alike(positions[16], EVERYBODY)
    assert found == 16
    assert lineup(features).most_alike(positions[17], EVERYBODY) % 4 == 0
