"""The search for settings: it finds a known minimum, and asks for nothing twice."""

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
import pytest

from benchmarks import tune_baselines
from benchmarks.tune_baselines import GRID, mean_error, search
from localreg.database import PoseDatabase
from localreg.evaluation.protocol import Protocol, plan_trials
from localreg.synthesis.settings import METHODS, Settings
from tests.localreg.database.made_motion import make_motion
from tests.localreg.evaluation.standing import Standing


@pytest.mark.parametrize("method", GRID)
def test_every_axis_is_a_setting_and_its_present_value_is_tried(method: str) -> None:
    known = {field.name for field in fields(Settings)}
    for name, values in GRID[method].items():
        assert name in known
        assert getattr(METHODS[method], name) in values, (method, name)
        assert len(values) == len(set(values))


def test_the_search_finds_the_least_error() -> None:
    asked: list[Settings] = []

    def evaluate(settings: Sequence[Settings]) -> list[float]:
        asked.extend(settings)
        return [
            abs(s.neighbours - 100) / 100 + abs(s.rank - 6) / 10 + abs(np.degrees(s.floor) - 5.0)
            for s in settings
        ]

    told: list[str] = []
    best, least, lines = search("paper", evaluate, lambda done, total, what: told.append(what))  # type: ignore[arg-type]
    assert (best.neighbours, best.rank, round(np.degrees(best.floor))) == (100, 6, 5)
    assert least == pytest.approx(0.0, abs=1e-9)
    assert len(asked) == len(set(asked)), "nothing is run twice"
    assert len(lines) == len(told) == 6
    assert best.prior == "paper"
    assert not best.search_by_trackers, "the published search stays as published"


def test_errors_are_means_over_signals_and_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    motions = [make_motion(i, 30, rate=40.0, name=f"clip{i}") for i in range(3)]
    database = PoseDatabase.build(motions)
    protocol = Protocol(("localreg",), ("both", "position"))
    trials, _ = plan_trials(motions[:2], database, protocol)
    made: list[Standing] = []

    def build(settings: Settings, subject: object, database: object, allowed: object) -> Standing:
        made.append(Standing(subject, 40.0, settings.prior, allowed))  # type: ignore[arg-type]
        return made[-1]

    monkeypatch.setattr(tune_baselines, "build_synthesizer", build)
    expected = np.mean([np.abs(np.degrees(m.angles[5:])).mean() for m in motions[:2]])
    for method in ("paper", "ik"):
        made.clear()
        assert mean_error(METHODS[method], trials, database, protocol) == pytest.approx(expected)
        starts = [what for one in made for _, what, _ in one.asked if what.startswith("init")]
        cold = ["init", "init"]
        assert starts == 2 * (cold if method == "paper" else ["init", "init_at"] * 2)
        assert len(made) == 1, "the same person, the same body"
        masks = [
            allowed for what, allowed in ((w, a) for _, w, a in made[0].asked) if what == "init"
        ]
        assert [mask is None for mask in masks] == [method == "ik"] * 4
        if method == "paper":
            assert masks[0] is not masks[-1]
            assert not np.array_equal(masks[0], masks[-1])  # type: ignore[arg-type]
