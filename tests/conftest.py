"""What every test needs: double precision, and the folder of real motions if there is one."""

import os
from pathlib import Path

import jax
import pytest

jax.config.update("jax_enable_x64", True)


@pytest.fixture(scope="session")
def motions_dir() -> Path:
    """Folder of CMU motions that LOCALREG_MOTIONS names; skips the test without it."""
    folder = os.environ.get("LOCALREG_MOTIONS")
    if not folder:
        pytest.skip("set LOCALREG_MOTIONS to a folder of CMU motions to run this test")
    path = Path(folder)
    if not path.is_dir():
        pytest.fail(f"LOCALREG_MOTIONS names {path}, which is no folder")
    return path
