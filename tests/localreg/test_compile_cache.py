import os
import subprocess
import sys
from pathlib import Path

from localreg.compile_cache import keep_compiled_code

PROGRAM = """
import sys
from pathlib import Path
from localreg.compile_cache import keep_compiled_code
keep_compiled_code(Path(sys.argv[1]))
from localreg.jax_numerics import jax
import jax.numpy as jnp
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
print(float(jax.jit(lambda x: jnp.sin(x) @ x)(jnp.ones(7))))
"""


def run(folder: Path) -> float:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(folder)],
        env={k: v for k, v in os.environ.items() if k != "JAX_COMPILATION_CACHE_DIR"},
        capture_output=True,
        text=True,
        check=True,
    )
    return float(done.stdout)


def test_code_is_kept_and_used_again(tmp_path):
    first = run(tmp_path / "kept")
    kept = sorted(p for p in (tmp_path / "kept").rglob("*-cache"))
    assert kept
    assert run(tmp_path / "kept") == first
    assert sorted((tmp_path / "kept").rglob("*-cache")) == kept


def test_the_users_own_folder_stays_in_force(tmp_path, monkeypatch):
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "theirs"))
    keep_compiled_code(tmp_path / "ours")
    assert not (tmp_path / "ours").exists()


def test_a_folder_that_cannot_be_made_is_no_error(tmp_path, monkeypatch):
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    (tmp_path / "file").touch()
    keep_compiled_code(tmp_path / "file" / "kept")
    assert "JAX_COMPILATION_CACHE_DIR" not in os.environ
