import os
import subprocess
import sys
from pathlib import Path

PROGRAM = """
import sys
from pathlib import Path
from localreg.live.compile_cache import keep_compiled_code
keep_compiled_code(Path(sys.argv[1]))
from localreg.numerics import jax
import jax.numpy as jnp
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
print(float(jax.jit(lambda x: jnp.sin(x) @ x)(jnp.ones(7))))
"""


def run(folder: Path, **environment: str) -> float:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(folder)],
        env={**os.environ, **environment},
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


def test_the_users_own_folder_stays_in_force(tmp_path):
    run(tmp_path / "ours", JAX_COMPILATION_CACHE_DIR=str(tmp_path / "theirs"))
    assert not (tmp_path / "ours").exists()
    assert list((tmp_path / "theirs").iterdir())


def test_a_folder_that_cannot_be_made_is_no_error(tmp_path):
    (tmp_path / "file").touch()
    run(tmp_path / "file" / "kept")
