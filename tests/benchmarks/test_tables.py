"""The table of methods, on figures that were made up."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from benchmarks.tables import columns_of, main, method_table, published_order, rows_of
from localreg.errors import LocalregError
from localreg.synthesis.settings import METHODS

CLIPS = 20


def document(errors: dict[str, np.ndarray]) -> dict[str, Any]:
    return {
        "clips": [
            {
                "name": f"clip{i}", "method": method, "signals": signals,
                "joint_angle_error_deg": float(error), "mpjpe_cm": 0.5 * float(error),
                "mpjpe_root_aligned_cm": 3.0 * float(error),
            }
            for signals in ("both", "orientation")
            for method, values in errors.items()
            for i, error in enumerate(values)
        ]
    }  # fmt: skip


@pytest.fixture(scope="module")
def figures() -> dict[str, Any]:
    rng = np.random.default_rng(0)
    base = rng.uniform(1.0, 3.0, CLIPS)
    return document(
        {
            "ik": base + 3.0,
            "lpca": base + 0.3,
            "lpcr": base + 0.5 + 0.1 * rng.standard_normal(CLIPS),
            "paper": base + 0.5 + 0.1 * rng.standard_normal(CLIPS),
            "localreg": base,
            "joint": base + 0.2 * (rng.standard_normal(CLIPS) + 0.05),
            "ik-truth": base - 0.5,
        }
    )


def test_cells_are_lowest_tied_or_lost(figures: dict[str, Any]) -> None:
    grid = method_table(columns_of(figures))
    assert grid.title == f"Means over {CLIPS} clips"
    assert [c.split("\n")[0] for c in grid.columns] == [
        "method", "both", "both", "orientation", "orientation",
    ]  # fmt: skip
    rows = {row[0]: row[1] for row in grid.rows}
    marks = {method: cell.split(" ", 1)[1:] for method, cell in rows.items()}
    assert sorted(marks["localreg"] + marks["joint"]) == ["**lowest**", "tied"]
    assert marks["ik"] == marks["lpca"] == marks["paper"] == []
    assert marks["ik-truth"] == [], "it was given the truth and does not compete"
    assert float(rows["ik-truth"]) < float(rows["lpca"])


def test_the_published_order_is_compared_plainly(figures: dict[str, Any]) -> None:
    lines = published_order(columns_of(figures))
    assert len(lines) == 4 * 3
    assert lines[0].startswith("both, deg: ik minus lpca +2.70 [")
    assert lines[0].endswith("as published")
    assert lines[1].startswith("both, deg: lpca minus lpcr -0.2")
    assert lines[1].endswith("the other way round")
    assert lines[2].endswith("not told apart")


def test_rivals_have_a_row_more_where_a_set_wants_other_settings(
    figures: dict[str, Any],
) -> None:
    own = METHODS["lpcr"].rank
    chosen = {"ik": "ik:previous_pose=0.5", "lpca": "lpca:rank=7", "lpcr": f"lpcr:rank={own}"}
    rows = rows_of(["ik", "lpca", "lpcr", "localreg", "ik-truth"], chosen)
    assert rows == {
        **{name: name for name in ("ik", "lpca", "lpcr", "localreg", "ik-truth")},
        "ik:previous_pose=0.5": "ik, chosen for this set",
        "lpca:rank=7": "lpca, chosen for this set",
        "ik:previous_pose=0.5-truth": "ik-truth, chosen for this set",
    }
    extra = {**figures, "clips": list(figures["clips"])}
    extra["clips"] += [
        {**clip, "method": "lpca:rank=7"} for clip in figures["clips"] if clip["method"] == "lpca"
    ]
    grid = method_table(columns_of(extra), rows)
    assert grid.rows[-1][0] == "lpca, chosen for this set"
    assert published_order(columns_of(extra)) == published_order(columns_of(figures))


def test_it_reads_what_evaluations_write(figures: dict[str, Any], tmp_path: Path) -> None:
    app = typer.Typer()
    app.command()(main)
    path = tmp_path / "figures.json"
    path.write_text(json.dumps(figures))
    result = CliRunner().invoke(app, ["--figures", str(path)])
    assert result.exit_code == 0, result.output
    assert "| method | both [deg] | both [cm] | orientation [deg] |" in result.stdout
    assert "* both, deg: ik minus lpca" in result.stdout
    assert CliRunner().invoke(app, []).exit_code == 2
    with pytest.raises(LocalregError, match="not the figures of an evaluation"):
        columns_of({"clips": [{"name": "a"}]})
