"""Rehearsals: never on a pose's own clip, the same every time, and with small databases."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from numpy import ndarray

from localreg.body.chain import Chain
from localreg.database import PoseDatabase
from localreg.motion.motion import Motion
from localreg.synthesis import experience, rehearsal
from localreg.synthesis.examples import ExampleSource
from localreg.synthesis.experience import Experience, learn
from localreg.synthesis.local_regression import LocalRegression
from localreg.synthesis.methods import build_synthesizer
from localreg.synthesis.rehearsal import Outcome, Rehearsal
from localreg.synthesis.settings import Settings
from localreg.synthesis.windows import Windows
from tests.localreg.synthesis.sessions import RATE

SETTINGS = Settings(neighbours=60, rehearsals=80, components=24)


class Lesson(NamedTuple):
    """All that `learn` is given."""

    source: ExampleSource
    settings: Settings
    noise: ndarray
    chain: Chain

    def learned(self) -> Experience:
        return learn(self.source, self.settings, self.noise, self.chain)


Given = Callable[..., Lesson]


@pytest.fixture(scope="module")
def lesson(subject) -> Given:
    def over(database: PoseDatabase, allowed: ndarray | None = None) -> Lesson:
        estimator = build_synthesizer(SETTINGS, subject, database, allowed)
        prior = estimator.prior
        assert isinstance(prior, LocalRegression)
        noise = prior.experience.pose.noise[3 * 56 :]
        return Lesson(prior.source, SETTINGS, noise, estimator.chain)

    return over


def named(motion: Motion, name: str) -> Motion:
    return replace(motion, provenance=replace(motion.provenance, name=name, trial=name))


@pytest.fixture(scope="module")
def with_copies(walks: dict[str, Motion]) -> PoseDatabase:
    """Three walks with their mirror images, and one of them a second time, begun later."""
    again = replace(named(walks["16_22"], "copy"), qpos=walks["16_22"].qpos[7:].copy())
    motions = [walks["16_22"], walks["16_25"], walks["69_01"], again]
    return PoseDatabase.build(motions, rate=RATE)


def arrays(found: Experience) -> dict[str, ndarray]:
    """All that was learned, by name."""
    fields = {name: np.asarray(value) for name, value in vars(found).items() if name not in PARTS}
    parts = {
        f"{part}.{name}": value
        for part in PARTS
        for name, value in vars(getattr(found, part)).items()
        if not isinstance(value, Windows)
    }
    return fields | parts


PARTS = ("pose", "step", "steps")


def test_rehearsals_never_see_their_own_clip_or_its_copies(lesson, with_copies, monkeypatch):
    group_of_clip = np.array([clip.group for clip in with_copies.clips])
    assert len(set(group_of_clip)) == 3 < len(with_copies.clips) == 8
    groups = group_of_clip[with_copies.clip_index]
    given = lesson(with_copies)
    rehearsed: list[int] = []
    predict = rehearsal._predict

    def watching(source, settings, row, query, near, *rest):
        rehearsed.append(row)
        assert np.all(np.isfinite(near.squared_distances))
        assert np.all(source.targets[near.rows])
        assert not np.any(groups[near.rows] == groups[row])
        # All others may be seen, and those that are nearest are.
        squared = source.search.squared_distances([query])[0]
        squared[groups == groups[row]] = np.inf
        np.testing.assert_allclose(
            np.sort(near.squared_distances), np.sort(squared)[: len(near.rows)], atol=1e-3
        )
        return predict(source, settings, row, query, near, *rest)

    monkeypatch.setattr(rehearsal, "_predict", watching)
    given.learned()
    assert len(rehearsed) >= SETTINGS.rehearsals
    # Every clip has its turn.
    assert set(with_copies.clip_index[rehearsed]) == set(range(8))


def test_learning_is_a_function_of_what_is_given(lesson, with_copies):
    given = lesson(with_copies)
    first = arrays(given.learned())
    np.random.seed(3)  # noqa: NPY002 (nobody's global state must matter)
    second = arrays(given.learned())
    for name, value in first.items():
        np.testing.assert_array_equal(value, second[name], err_msg=name)


def test_the_order_of_clips_hardly_matters(lesson, walks):
    """Other rows are rehearsed, with other noise; what is learned is alike."""
    names = ["16_22", "16_25", "69_01", "69_20"]
    one, other = (
        lesson(PoseDatabase.build((walks[n] for n in order), rate=RATE)).learned()
        for order in (names, names[::-1])
    )
    assert one.usual == pytest.approx(other.usual, rel=0.3)
    for growth in ("pose_growth", "step_growth"):
        traces = [np.trace(getattr(found, growth)) for found in (one, other)]
        assert traces[0] == pytest.approx(traces[1], rel=0.4)
    for share in ("feature_share", "history_share"):
        sums = [getattr(found, share).sum() for found in (one, other)]
        assert sums[0] == pytest.approx(sums[1], rel=0.3)


def test_the_believed_shares_have_the_least_error_and_growth_is_that_error(
    lesson, with_copies, monkeypatch
):
    given = lesson(with_copies)
    rehearsals: list[Rehearsal] = []
    rehearse = experience.rehearse

    def watching(*args):
        rehearsals.append(rehearse(*args))
        return rehearsals[-1]

    monkeypatch.setattr(experience, "rehearse", watching)
    found = given.learned()
    last = rehearsals[-1]
    weights = 1.0 / np.maximum(last.squared_distance, 0.05)
    for kind in ("pose", "step"):
        outcome, share = getattr(last, kind), getattr(found, f"{kind}_share")
        assert np.all((share >= 0.0) & (share <= 1.0))
        assert len(set(share.tolist())) > 10

        def loss(share: ndarray, outcome: Outcome = outcome) -> ndarray:
            return weights @ np.square(outcome.wanted - share * outcome.predicted)

        for other in (0.0, 0.99 * share, np.minimum(1.01 * share, 1.0), 1.0):
            assert np.all(loss(share) <= loss(np.full(len(share), other)) * (1.0 + 1e-9))
        errors = outcome.wanted - share * outcome.predicted
        expected = sum(w * np.outer(e, e) for w, e in zip(weights, errors, strict=True)) / len(
            weights
        )
        np.testing.assert_allclose(getattr(found, f"{kind}_growth"), expected, atol=1e-12)
    assert np.mean(last.squared_distance <= found.usual) == pytest.approx(0.9, abs=0.02)


@pytest.mark.parametrize(
    "allowed", [slice(None), slice(40, 41), slice(40, 48)], ids=["all", "one pose", "eight"]
)
def test_a_single_clip_teaches_to_expect_anything(lesson, walks, allowed):
    """It cannot be rehearsed on; errors must then be large and no coordinate tied to another."""
    database = PoseDatabase.build([walks["16_22"]], rate=RATE)
    which = np.zeros(len(database), dtype=bool)
    which[allowed] = True
    found = lesson(database, which).learned()
    for values in arrays(found).values():
        assert np.all(np.isfinite(values))
    np.testing.assert_allclose(found.pose_growth, np.radians(10.0) ** 2 * np.eye(56), atol=1e-12)
    np.testing.assert_allclose(found.step_growth, np.radians(1.0) ** 2 * np.eye(62), atol=1e-12)


def test_a_handful_of_poses_of_two_clips_can_be_learned_from(lesson, database):
    allowed = np.zeros(len(database), dtype=bool)
    for clip in (database.clips[0], database.clips[-1]):
        allowed[clip.start + 10 : clip.start + 18] = True
    found = lesson(database, allowed).learned()
    for values in arrays(found).values():
        assert np.all(np.isfinite(values))
    for growth in (found.pose_growth, found.step_growth):
        assert np.linalg.eigvalsh(growth)[0] > -1e-9
        assert np.all(np.diagonal(growth) >= 0.0)


def test_distances_of_partial_queries_are_made_whole(localreg):
    known = localreg.prior.experience
    m, f = len(known.history_share), len(known.feature_share)
    nothing = np.zeros(m, dtype=bool), np.zeros(f)
    everything = np.ones(m, dtype=bool), np.ones(f)
    assert known.whole_distance(2.0, *everything) == pytest.approx(2.0)
    assert known.whole_distance(2.0, *nothing) == np.inf
    assert known.whole_distance(0.0, everything[0], nothing[1]) == 0.0
    shares = np.concatenate([known.history_share, known.feature_share])
    assert np.all(shares >= 0.0)
    for seed in range(10):
        rng = np.random.default_rng(seed)
        valid, trust = rng.random(m) < 0.5, rng.choice([0.0, 0.05, 1.0], f)
        counted = np.concatenate([valid, trust**2])
        found = known.whole_distance(2.0, valid, trust)
        assert found == pytest.approx(2.0 * shares.sum() / (shares @ counted))
        # Knowing less of an equal distance can only mean to be farther away.
        assert known.whole_distance(2.0, valid, trust * (rng.random(f) < 0.5)) >= found
