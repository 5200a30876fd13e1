"""The table of ablations: every change is one, and pays or not as the figures say."""

import json
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from benchmarks import ablations
from benchmarks.ablations import ABLATIONS, OURS, Ablation, ablation_table, main, run_ablations
from benchmarks.tables import columns_of
from localreg.errors import LocalregError
from localreg.evaluation import worker
from localreg.evaluation.protocol import Protocol
from localreg.evaluation.variants import find_variant
from localreg.synthesis.settings import METHODS, Settings
from tests.localreg.database.made_motion import make_motion
from tests.localreg.evaluation.standing import Builder, Standing


def test_every_change_changes_something_and_none_is_made_twice() -> None:
    assert len({a.words for a in ABLATIONS}) == len(ABLATIONS)
    made = [(a.method, a.is_mirrored) for a in ABLATIONS]
    assert len(set(made)) == len(made)
    assert (OURS, True) not in made
    for ablation in ABLATIONS:
        variant = find_variant(ablation.method)
        assert variant.method == OURS
        for name, value in variant.changes.items():
            assert getattr(METHODS[OURS], name) != value, (ablation.words, name)


def test_figures_hold_every_row_with_its_own_database(monkeypatch: pytest.MonkeyPatch) -> None:
    motions = [make_motion(i, 30, rate=40.0, name=f"clip{i}") for i in range(3)]
    builder = Builder()
    poses: dict[str, int] = {}

    def build(settings: Settings, subject: object, database: object, allowed: object) -> Standing:
        poses[str(settings.neighbours)] = len(database)  # type: ignore[arg-type]
        return builder(settings.prior, subject, database, allowed)  # type: ignore[arg-type]

    monkeypatch.setattr(worker, "build_estimator", builder)
    monkeypatch.setattr(worker, "build_synthesizer", build)
    chosen = (
        Ablation("few", f"{OURS}:neighbours=24"),
        Ablation("alone", f"{OURS}:neighbours=23", is_mirrored=False),
    )
    told: list[float] = []
    document = run_ablations(
        motions, Protocol(signals=("both", "position")), chosen,
        progress=lambda done, total, what: told.append(done / total),
    )  # fmt: skip
    columns = columns_of(document)
    assert list(columns[0].values) == [OURS, "few", "alone"]
    assert [len(values) for values in columns[0].values.values()] == [3, 3, 3]
    assert poses["24"] == 2 * poses["23"]
    assert told == sorted(told)
    assert told[-1] == 1.0
    assert json.loads(json.dumps(document))["settings"]["rate_hz"] == 40.0


def figures_with(more: np.ndarray) -> dict[str, object]:
    base = np.random.default_rng(0).uniform(1.0, 3.0, len(more))
    first, second = (a.words for a in ABLATIONS[:2])
    errors = {OURS: base, first: base + more, second: base - more}
    return {
        "clips": [
            {"name": f"c{i}", "method": method, "signals": "both",
             "joint_angle_error_deg": float(error), "mpjpe_cm": None}
            for method, values in errors.items() for i, error in enumerate(values)
        ]
    }  # fmt: skip


def test_parts_pay_or_not_as_the_figures_say(tmp_path: Path) -> None:
    document = figures_with(np.random.default_rng(1).normal(0.5, 0.1, 20))
    grid = ablation_table(columns_of(document))
    assert [row[0] for row in grid.rows] == ["nothing", ABLATIONS[0].words, ABLATIONS[1].words]
    assert [c.split("\n")[0] for c in grid.columns[1:]] == ["both", "both"]
    assert grid.rows[1][1].startswith("**+0.5")
    assert grid.rows[2][1].startswith("-0.5")
    assert grid.rows[2][1].endswith("less")
    assert grid.rows[1][2] == "breaks down"
    unsure = ablation_table(columns_of(figures_with(np.tile([0.5, -0.5], 10))))
    assert "*" not in unsure.rows[1][1]
    assert "less" not in unsure.rows[1][1]

    app = typer.Typer()
    app.command()(main)
    path = tmp_path / "figures.json"
    path.write_text(json.dumps(document))
    shown = CliRunner().invoke(app, ["--figures", str(path), "--only", ABLATIONS[1].words])
    assert shown.exit_code == 0, shown.output
    assert "| nothing |" in shown.stdout
    assert ABLATIONS[0].words not in shown.stdout
    assert CliRunner().invoke(app, []).exit_code == 2
    document["clips"] = [c for c in document["clips"] if c["method"] != OURS]  # type: ignore[attr-defined,index]
    path.write_text(json.dumps(document))
    with pytest.raises(LocalregError, match="lack the method itself"):
        ablations.main(None, path)
