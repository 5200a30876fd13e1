"""The search for settings: it finds a known minimum, and asks for nothing twice."""

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import tune_baselines
from benchmarks.tune_baselines import GRID, Search, mean_error, read_settings, write_settings
from localreg.database import PoseDatabase
from localreg.errors import LocalregError
from localreg.evaluation.protocol import Protocol, plan_trials
from localreg.evaluation.variants import find_variant
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


def made_up(settings: Settings, number: int) -> float:
    """Errors of two sets, the second of which wants a wider floor."""
    wanted = (2.0, 8.0)[number]
    return float(
        1.0
        + abs(settings.neighbours - 100) / 100
        + abs(settings.rank - 6) / 10
        + abs(np.log(np.degrees(settings.floor) / wanted))
    )


def test_rivals_have_what_was_found_for_all_sets() -> None:
    found = read_settings(Path(tune_baselines.__file__).with_name("rivals.toml"))
    assert set(found["all"]) == set(GRID)
    for method, name in found["all"].items():
        chosen, own = find_variant(name).settings, METHODS[method]
        for axis in GRID[method]:
            assert getattr(chosen, axis) == pytest.approx(getattr(own, axis)), (method, axis)


def test_the_search_finds_the_least_error() -> None:
    asked: list[tuple[Settings, int]] = []

    def evaluate(problems: Sequence[tuple[Settings, int]]) -> list[float]:
        asked.extend(problems)
        return [made_up(*problem) for problem in problems]

    told: list[str] = []
    search = Search("paper", evaluate, told.append)
    for sets, floor in (((0,), 2.0), ((1,), 8.0)):
        best = search.best(METHODS["paper"], sets)
        assert (best.neighbours, best.rank) == (100, 6)
        assert np.degrees(best.floor) == pytest.approx(floor)
        assert search.errors(best, sets) == pytest.approx([1.0])
        assert best.prior == "paper"
        assert not best.search_by_trackers, "the published search stays as published"
    common = search.best(METHODS["paper"], (0, 1))
    assert 2.0 <= np.degrees(common.floor) <= 8.0001
    assert len(asked) == len(set(asked)), "nothing is run twice"
    assert told[0].startswith("paper floor: ")
    assert "/" in told[-1], "an error for each set"


def test_a_percent_counts_alike_in_every_set() -> None:
    def evaluate(problems: Sequence[tuple[Settings, int]]) -> list[float]:
        # 3 ranks cost a tenth of a small error, and save a twentieth of a large one.
        return [(1.0, 10.0)[n] * (1.0 if s.rank != 3 else (1.1, 0.95)[n]) for s, n in problems]

    search = Search("paper", evaluate)
    assert search.best(METHODS["paper"], (0, 1)).rank != 3
    assert search.best(METHODS["paper"], (1,)).rank == 3


def test_what_was_found_is_written_as_names_of_variants(tmp_path: Path) -> None:
    best = replace(METHODS["lpca"], floor=np.radians(3.0), search_by_trackers=False)
    path = tmp_path / "found.toml"
    write_settings(path, {"all": {"lpca": METHODS["lpca"]}, "cmu": {"lpca": best}})
    assert set(read_settings(path)) == {"all", "cmu"}
    name = read_settings(path)["cmu"]["lpca"]
    assert name.startswith("lpca:floor=0.0523")
    assert find_variant(name).settings == best
    path.write_text("[all]\nlpca = 3\n")
    with pytest.raises(LocalregError, match="make it with"):
        read_settings(path)


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
