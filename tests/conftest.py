"""What all tests share: double precision, and the real motions if they are at hand."""

import os
import signal
from pathlib import Path

import jax
import pytest

from localreg.compile_cache import keep_numba_code

# Programs that tests start share with them what is compiled.
keep_numba_code()
jax.config.update("jax_enable_x64", True)
# Tests on several processes are told the width of a terminal that they do not have.
os.environ.pop("COLUMNS", None)
# A job in a script's background ignores interrupts, and so would the programs that tests start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def motions_dir() -> Path:
    """The folder of real motion files, named by LOCALREG_MOTIONS."""
    name = os.environ.get("LOCALREG_MOTIONS", "")
    if not name:
        pytest.skip("set LOCALREG_MOTIONS to a folder of CMU motions to run this test")
    folder = Path(name)
    assert folder.is_dir(), f"LOCALREG_MOTIONS names {folder}, which is no folder"
    return folder
