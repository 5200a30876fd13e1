"""Tables are put where the marks are, and nowhere else."""

from pathlib import Path

import pytest

from benchmarks.marks import put_table
from localreg.errors import LocalregError


def test_a_table_takes_the_place_of_the_old_one(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    other = "<!-- b -->\nstays\n<!-- /b -->\n"
    page.write_text(f"before\n<!-- a -->\nold\n<!-- /a -->\nafter\n{other}")
    for _ in range(2):
        put_table(page, "| new |", "a")
        assert page.read_text() == f"before\n<!-- a -->\n| new |\n<!-- /a -->\nafter\n{other}"
    with pytest.raises(LocalregError, match="has no <!-- c -->"):
        put_table(page, "| new |", "c")
