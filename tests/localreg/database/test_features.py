"""Features of trackers: free of place and heading, masked where nothing is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.chain import chain_of
from localreg.body.subject import canonical_subject
from localreg.database.features import FeatureLayout, database_features
from localreg.evaluation.body_points import BodyPoints
from tests.localreg.body.random_body import random_poses, random_subject

SIX = FeatureLayout.of(canonical_subject())
TORSO = 1
TRACKER_SETS = [("head",), ("lhand", "head"), ("rankle", "torso", "lhand"), ("lhand", "rhand")]
# As near the root as the torso's is an ankle's bone, but it carries nothing.


def poses(seed: int, trackers: int = 6) -> tuple[ndarray, ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(trackers, 3)), Rotation.random(trackers, rng).as_matrix()


def extract(layout: FeatureLayout, positions: ndarray, rotations: ndarray) -> ndarray:
    quaternions = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_quat(scalar_first=True)
    return layout.extract(positions, quaternions.reshape(*rotations.shape[:-2], 4))


def meaning(layout: FeatureLayout) -> list[tuple[str, int]]:
    """What every column is made of: a kind, and a tracker."""
    columns = []
    for other in layout.others:
        columns += [("position", other)] * 3 + [("rotation", other)] * 9
    return columns + [("gravity", layout.reference)] * 3 + [("height", layout.reference)]


def test_the_torso_is_what_others_are_seen_from():
    assert SIX.reference == TORSO
    assert SIX.others == (0, 2, 3, 4, 5)
    assert SIX.size == 5 * 12 + 4


@pytest.mark.parametrize("names", TRACKER_SETS, ids=" ".join)
def test_any_set_of_trackers_has_a_layout(names):
    subject = canonical_subject().with_trackers(names)
    layout = FeatureLayout.of(subject)
    count = len(names)
    assert sorted((layout.reference, *layout.others)) == list(range(count))
    features = extract(layout, *poses(1, count))
    assert features.shape == (layout.size,) == (len(meaning(layout)),)
    if "torso" in names:
        assert names[layout.reference] == "torso"


@given(
    seed=st.integers(0, 2**32),
    heading=st.floats(-10.0, 10.0),
    away=st.tuples(*[st.floats(-100.0, 100.0)] * 2),
)
@settings(max_examples=60, deadline=None)
def test_place_and_heading_do_not_enter(seed, heading, away):
    positions, rotations = poses(seed)
    turn = Rotation.from_rotvec([0.0, 0.0, heading]).as_matrix()
    moved = positions @ turn.T + np.array([*away, 0.0])
    expected = extract(SIX, positions, rotations)
    np.testing.assert_allclose(extract(SIX, moved, turn @ rotations), expected, atol=1e-9)


def test_height_and_tilt_do_enter():
    positions, rotations = poses(2)
    before = extract(SIX, positions, rotations)
    raised = extract(SIX, positions + np.array([0.0, 0.0, 0.25]), rotations)
    change = raised - before
    assert change[-1] == pytest.approx(0.25)
    np.testing.assert_allclose(change[:-1], 0.0, atol=1e-12)
    tilt = Rotation.from_rotvec([0.3, 0.0, 0.0]).as_matrix()
    tilted = extract(SIX, positions @ tilt.T, tilt @ rotations)
    np.testing.assert_allclose(tilted[:-4], before[:-4], atol=1e-12)
    assert np.linalg.norm(tilted[-4:-1] - before[-4:-1]) > 0.1


def test_the_columns_are_what_the_layout_says():
    positions, rotations = poses(3)
    features = extract(SIX, positions, rotations)
    R = rotations[TORSO]
    for place, other in enumerate(SIX.others):
        part = features[12 * place : 12 * (place + 1)]
        np.testing.assert_allclose(part[:3], R.T @ (positions[other] - positions[TORSO]))
        np.testing.assert_allclose(part[3:].reshape(3, 3), R.T @ rotations[other])
    np.testing.assert_allclose(features[-4:-1], R.T @ [0.0, 0.0, 1.0])
    assert features[-1] == positions[TORSO, 2]
    batch = extract(SIX, np.stack([positions, positions]), np.stack([rotations, rotations]))
    np.testing.assert_allclose(batch, [features, features])


@given(
    st.lists(st.booleans(), min_size=6, max_size=6), st.lists(st.booleans(), min_size=6, max_size=6)
)
@settings(max_examples=100, deadline=None)
def test_columns_are_known_where_their_trackers_are(position_mask, orientation_mask):
    positions, rotations = np.array(position_mask), np.array(orientation_mask)
    known = {
        "position": lambda other: positions[other],
        "rotation": lambda other: rotations[other],
        "gravity": lambda _: rotations[TORSO],
        "height": lambda _: positions[TORSO],
    }
    expected = [bool(known[kind](tracker)) for kind, tracker in meaning(SIX)]
    trust = SIX.trust(positions, rotations, 0.05)
    assert (trust > 0.0).tolist() == expected
    # What is seen from a pose that was itself predicted is believed less.
    seen_from = {"position": positions[TORSO] and rotations[TORSO], "rotation": rotations[TORSO]}
    whole = [bool(seen_from.get(kind, True)) for kind, _ in meaning(SIX)]
    assert trust.tolist() == [
        0.0 if not e else 1.0 if w else 0.05 for e, w in zip(expected, whole, strict=True)
    ]


@pytest.mark.parametrize("masked", range(6))
def test_known_columns_do_not_depend_on_masked_trackers(masked):
    """But for the reference's own orientation, which prediction replaces."""
    positions, rotations = poses(4)
    mask = np.arange(6) != masked
    known = SIX.trust(mask, mask) > 0.0
    features = extract(SIX, positions, rotations)
    positions[masked] += 7.0
    if masked != TORSO:
        rotations[masked] = Rotation.random(None, np.random.default_rng(5)).as_matrix()
    changed = extract(SIX, positions, rotations)
    np.testing.assert_array_equal(changed[known], features[known])
    assert not np.array_equal(changed, features)


def test_numbers_are_spread_over_columns():
    position, rotation = np.arange(6.0), 10.0 + np.arange(6.0)
    expected = [
        position[t] if kind in ("position", "height") else rotation[t] for kind, t in meaning(SIX)
    ]
    np.testing.assert_array_equal(SIX.columns(position, rotation), expected)


def test_features_of_a_database_are_those_of_its_trackers():
    """As MuJoCo's kinematics places them, on a subject unlike the database's."""
    subject = random_subject(9, trackers=6)
    layout = FeatureLayout.of(subject)
    qpos = random_poses(10, 30, spread=0.5).astype(np.float32)
    features = database_features(layout, chain_of(subject), qpos[:, :7], qpos[:, 7:])
    truth = BodyPoints(subject).tracker_poses(qpos.astype(float))
    expected = layout.extract(truth.positions, truth.quaternions)
    assert features.dtype == np.float32
    np.testing.assert_allclose(features, expected, atol=2e-6)
