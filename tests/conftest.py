"""What all tests share: double precision, and the real motions if they are at hand."""

import os
from pathlib import Path

import jax
import pytest

jax.config.update("jax_enable_x64", True)
# Tests on several processes are told the width of a terminal that they do not have.
os.environ.pop("COLUMNS", None)


@pytest.fixture(scope="session")
def motions_dir() -> Path:
    """The folder of real motion files, named by LOCALREG_MOTIONS."""
    name = os.environ.get("LOCALREG_MOTIONS", "")
    if not name:
        pytest.skip("set LOCALREG_MOTIONS to a folder of CMU motions to run this test")
    folder = Path(name)
    assert folder.is_dir(), f"LOCALREG_MOTIONS names {folder}, which is no folder"
    return folder
