"""What is learned from a whole saved database is learned once."""

from pathlib import Path

import numpy as np
import pytest
from numpy import ndarray

from localreg.body.chain import Chain
from localreg.body.subject import Subject
from localreg.database import PoseDatabase
from localreg.database import view as view_module
from localreg.database.cache import FOLDER
from localreg.database.features import FeatureLayout
from localreg.motion.motion import Motion
from localreg.synthesis import kept_experience
from localreg.synthesis.examples import ExampleSource
from localreg.synthesis.experience import Experience, learn, learn_half
from localreg.synthesis.halves import Measured
from localreg.synthesis.kept_experience import experience_over, half_over
from localreg.synthesis.local_regression import LocalRegression
from localreg.synthesis.methods import build_synthesizer
from localreg.synthesis.settings import Settings
from tests.localreg.synthesis.sessions import RATE

SETTINGS = Settings(neighbours=40, rehearsals=30, components=16)


@pytest.fixture
def saved(walks: dict[str, Motion], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A saved database that is worth keeping things of, and a cache folder of its own."""
    monkeypatch.setattr(view_module, "_WORTH_KEEPING", 1)
    monkeypatch.setenv(FOLDER, str(tmp_path / "cache"))
    names = ("16_22", "16_25", "69_01")
    PoseDatabase.build((walks[name] for name in names), rate=RATE).save(tmp_path / "db")
    return tmp_path / "db"


@pytest.fixture
def lessons(monkeypatch: pytest.MonkeyPatch) -> list[Settings]:
    """Filled with the settings of whatever is learned."""
    told: list[Settings] = []

    def telling(
        source: ExampleSource, settings: Settings, noise: ndarray, chain: Chain
    ) -> Experience:
        told.append(settings)
        return learn(source, settings, noise, chain)

    monkeypatch.setattr(kept_experience, "learn", telling)
    return told


def test_the_second_start_knows_what_the_first_has_learned(
    saved: Path, lessons: list[Settings], subject: Subject
) -> None:
    build_synthesizer(SETTINGS, subject, PoseDatabase.load(saved))
    assert lessons == [SETTINGS]
    estimator = build_synthesizer(SETTINGS, subject, PoseDatabase.load(saved))
    assert lessons == [SETTINGS]
    prior = estimator.prior
    assert isinstance(prior, LocalRegression)
    noise = prior.experience.pose.noise[3 * 56 :]
    kept, fresh = (
        make(prior.source, SETTINGS, noise, estimator.chain) for make in (experience_over, learn)
    )
    rows = np.flatnonzero(prior.source.targets)[::9]
    for kind in ("pose", "step"):
        one, other = getattr(kept, kind), getattr(fresh, kind)
        for each in (None, np.full(len(one.noise), 0.5)):
            np.testing.assert_array_equal(one.of(rows, each), other.of(rows, each))
    np.testing.assert_array_equal(kept.steps.of(rows), fresh.steps.of(rows))
    for name in ("pose_share", "step_share", "pose_growth", "step_growth", "caution", "usual"):
        np.testing.assert_array_equal(getattr(kept, name), getattr(fresh, name), err_msg=name)
    trust = np.linspace(0.0, 1.0, len(fresh.feature_share))
    valid = np.array([True, True, False])
    assert kept.whole_distance(2.0, valid, trust) == fresh.whole_distance(2.0, valid, trust)


@pytest.mark.parametrize("signals", ["position", "orientation"])
def test_halves_are_learned_once_too(
    saved: Path, subject: Subject, signals: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured = Measured.of(
        FeatureLayout.of(subject),
        position=signals == "position",
        orientation=signals == "orientation",
    )

    def prior() -> LocalRegression:
        found = build_synthesizer(SETTINGS, subject, PoseDatabase.load(saved)).prior
        assert isinstance(found, LocalRegression)
        return found

    one = prior()
    fresh = learn_half(one.experience, one.source, SETTINGS, one.chain, measured)
    half_over(one.experience, one.source, SETTINGS, one.chain, measured)
    monkeypatch.setattr(kept_experience, "learn_half", None)
    other = prior()
    kept = half_over(other.experience, other.source, SETTINGS, other.chain, measured)
    rows = np.flatnonzero(other.source.targets)[::9]
    np.testing.assert_array_equal(kept.pose.of(rows), fresh.pose.of(rows))
    np.testing.assert_array_equal(kept.step.of(rows), fresh.step.of(rows))
    for name in ("noise", "center", "onto"):
        np.testing.assert_array_equal(getattr(kept.pose, name), getattr(fresh.pose, name))
    for name in (*kept_experience._LEARNED, *kept_experience._NUMBERS):
        np.testing.assert_array_equal(getattr(kept, name), getattr(fresh, name), err_msg=name)
    # Of less than all nothing is kept.
    database = other.source.database
    allowed = database.exclude(clip=database.clips[0].name)
    less = build_synthesizer(SETTINGS, subject, database, allowed).prior
    assert isinstance(less, LocalRegression)
    with pytest.raises(TypeError):
        half_over(less.experience, less.source, SETTINGS, less.chain, measured)


def test_other_settings_or_less_of_the_database_are_learned_anew(
    saved: Path, lessons: list[Settings], subject: Subject
) -> None:
    other = Settings(neighbours=41, rehearsals=30, components=16)
    database = PoseDatabase.load(saved)
    less = database.exclude(clip=database.clips[0].name)
    for settings, allowed in ((SETTINGS, None), (other, None), (SETTINGS, less)):
        build_synthesizer(settings, subject, database, allowed)
    assert lessons == [SETTINGS, other, SETTINGS]
    # What was learned from less is not taken for what the whole would teach.
    build_synthesizer(SETTINGS, subject, database)
    assert len(lessons) == 3
