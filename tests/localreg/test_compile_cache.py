import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from localreg import compile_cache
from localreg.compile_cache import keep_compiled_code

VARIABLES = ("JAX_COMPILATION_CACHE_DIR", "NUMBA_CACHE_DIR")

OF_JAX = """
import sys
from pathlib import Path
from localreg.compile_cache import keep_compiled_code
keep_compiled_code(Path(sys.argv[1]))
from localreg.jax_numerics import jax
import jax.numpy as jnp
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
print(float(jax.jit(lambda x: jnp.sin(x) @ x)(jnp.ones(7))))
"""

OF_NUMBA = """
import json, sys
from pathlib import Path
from localreg.compile_cache import keep_compiled_code
keep_compiled_code(Path(sys.argv[1]))
import numpy as np
from localreg.body.chain import exponential
out = np.empty(4)
exponential(np.array([0.0, 0.0, np.pi]), out)
stats = exponential.stats
print(json.dumps([out.round(12).tolist(), sum(stats.cache_hits.values())]))
"""


def run(program: str, folder: Path) -> Any:
    done = subprocess.run(
        [sys.executable, "-c", program, str(folder)],
        env={k: v for k, v in os.environ.items() if k not in VARIABLES},
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout)


def forget(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is named, and whatever the test makes the program name goes when it ends."""
    for name in VARIABLES:
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)


def test_code_is_kept_and_used_again(tmp_path: Path) -> None:
    first = run(OF_JAX, tmp_path / "kept")
    kept = sorted(p for p in (tmp_path / "kept").rglob("*-cache"))
    assert kept
    assert run(OF_JAX, tmp_path / "kept") == first
    assert sorted((tmp_path / "kept").rglob("*-cache")) == kept


def test_numba_keeps_its_code_there_too(tmp_path: Path) -> None:
    half_a_turn = [0.0, 0.0, 0.0, 1.0]
    assert run(OF_NUMBA, tmp_path) == [half_a_turn, 0]
    kept = sorted(p for p in tmp_path.rglob("*.nb*"))
    assert [p.suffix for p in kept] == [".nbc", ".nbi"]
    assert run(OF_NUMBA, tmp_path) == [half_a_turn, 1]
    assert sorted(p for p in tmp_path.rglob("*.nb*")) == kept


def test_code_of_other_sources_is_not_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Numba itself would not notice that a function in another file has changed."""
    package = tmp_path / "localreg"
    shutil.copytree(Path(compile_cache.__file__).parent / "body", package / "body")
    monkeypatch.setattr(compile_cache, "__file__", str(package / "compile_cache.py"))

    def numbas() -> str:
        forget(monkeypatch)
        keep_compiled_code(tmp_path / "kept")
        return os.environ["NUMBA_CACHE_DIR"]

    first = numbas()
    with (package / "body" / "subject.py").open("a") as file:
        file.write("# nothing that is compiled\n")
    assert numbas() == first
    with (package / "body" / "chain.py").open("a") as file:
        file.write("# something else\n")
    assert numbas() != first


def test_code_that_nobody_starts_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    forget(monkeypatch)
    keep_compiled_code(tmp_path)
    folder = Path(os.environ["JAX_COMPILATION_CACHE_DIR"])
    old, young = folder / "numba-old", folder / "numba-young"
    for place, days in ((old, 40), (young, 3)):
        (place / "deeper").mkdir(parents=True)
        os.utime(place, (time.time() - 86400 * days,) * 2)
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    keep_compiled_code(tmp_path)
    assert not old.exists()
    assert (young / "deeper").exists()
    assert Path(os.environ["NUMBA_CACHE_DIR"]).is_dir()


def test_the_users_own_folders_stay_in_force(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in VARIABLES:
        monkeypatch.setenv(name, str(tmp_path / "theirs"))
    keep_compiled_code(tmp_path / "ours")
    assert not (tmp_path / "ours").exists()
    assert {os.environ[name] for name in VARIABLES} == {str(tmp_path / "theirs")}


def test_a_folder_that_cannot_be_made_is_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    forget(monkeypatch)
    (tmp_path / "file").touch()
    keep_compiled_code(tmp_path / "file" / "kept")
    assert not set(VARIABLES) & set(os.environ)
