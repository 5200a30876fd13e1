"""The first start: what is compiled beside is what frames run, and the next start knows of it."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from localreg import compile_cache
from localreg.database import PoseDatabase
from localreg.live.compiling import Compiling
from localreg.motion.formats.sample import read_sample

SIGNATURES = """
import gc, json, sys
from dataclasses import replace
from pathlib import Path
from localreg.live.database_choice import choose_database
from localreg.live.warm_up import warm_up
from localreg.synthesis.methods import METHODS, build_synthesizer
from localreg.synthesis.stand_in import look_ahead_once, stand_in
from numba.core.registry import CPUDispatcher

def compiled():
    return {
        f"{d.py_func.__module__}.{d.py_func.__qualname__}": sorted(map(str, d.signatures))
        for d in gc.get_objects()
        if isinstance(d, CPUDispatcher) and d.py_func.__module__.startswith("localreg")
    }

warm_up(stand_in())
look_ahead_once()
alone = compiled()
chosen = choose_database(Path(sys.argv[1]))
quick = replace(METHODS["localreg"], rehearsals=20)
warm_up(build_synthesizer(quick, chosen.subject, chosen.poses))
print(json.dumps([alone, compiled()]))
"""

BY_ITSELF = (
    "localreg.synthesis.ask._ask",
    "localreg.synthesis.attention._observe",
    "localreg.synthesis.compiled.minimize",
    "localreg.synthesis.local_fit._fit",
    "localreg.synthesis.local_fit._normal",
    "localreg.synthesis.local_fit.kernel_weights",
    "localreg.synthesis.local_fit.within_reach",
    "localreg.synthesis.look_ahead.correct",
    "localreg.synthesis.look_ahead.look_ahead",
    "localreg.synthesis.look_ahead.regress",
    "localreg.synthesis.state._remember",
    "localreg.synthesis.synthesizer._inverse",
    "localreg.synthesis.synthesizer._residuals",
)

# Two at once would both find no index, were it not for the lock: saving it takes a while here.
ONE_TYPE = """
import sys, time
from pathlib import Path
import numpy as np
from localreg.compile_cache import write_in_turn
from numba.core.caching import IndexDataCacheFile

save_index = IndexDataCacheFile._save_index

def slowly(self, overloads):
    time.sleep(0.5)
    save_index(self, overloads)

IndexDataCacheFile._save_index = slowly
write_in_turn()
write_in_turn()
sys.path.insert(0, sys.argv[1])
from doubled import doubled
Path(sys.argv[1], sys.argv[2]).touch()
while len(list(Path(sys.argv[1]).glob("float*"))) < 2:
    time.sleep(0.01)
print(doubled(np.ones(2, sys.argv[2])).dtype, sum(doubled.stats.cache_hits.values()))
"""


def test_frames_run_what_was_compiled_beside(tmp_path: Path) -> None:
    pytest.importorskip("envpool_assets")
    PoseDatabase.build([motion.first(240) for motion in read_sample()[:3]]).save(tmp_path / "db")
    done = subprocess.run(
        [sys.executable, "-c", SIGNATURES, str(tmp_path / "db")],
        capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    alone, live = json.loads(done.stdout)
    for name in BY_ITSELF:
        assert alone[name], name
        assert live[name] == alone[name], name


def test_processes_that_compile_at_once_keep_both_types(tmp_path: Path) -> None:
    (tmp_path / "doubled.py").write_text(
        "from numba import njit\n\n\n@njit(cache=True)\ndef doubled(x):\n    return x + x\n"
    )
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "kept")}

    def at_once() -> list[str]:
        running = [
            subprocess.Popen(
                [sys.executable, "-c", ONE_TYPE, str(tmp_path), kind],
                env=environment, stdout=subprocess.PIPE, text=True,
            )
            for kind in ("float32", "float64")
        ]  # fmt: skip
        said = [process.communicate(timeout=120)[0].strip() for process in running]
        for kind in ("float32", "float64"):
            (tmp_path / kind).unlink()
        return said

    assert at_once() == ["float32 0", "float64 0"]
    assert at_once() == ["float32 1", "float64 1"]


def test_a_start_is_the_first_until_all_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    mark = f"complete-by-a-test-{os.getpid()}"
    monkeypatch.setattr(compile_cache, "_mark", lambda: mark)
    kept = Path(os.environ["NUMBA_CACHE_DIR"]) / mark
    try:
        with Compiling() as compiling:
            assert compiling.is_first
            assert compiling.progress().startswith("compiling once for this machine: ")
            compiling.wait()
            compiling.finish()
        assert kept.exists()
        with Compiling() as compiling:
            assert not compiling.is_first
            begun = time.monotonic()
            compiling.wait()
            assert time.monotonic() - begun < 1.0
    finally:
        kept.unlink(missing_ok=True)


def test_what_compiles_beside_ends_with_the_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    with Compiling() as compiling:
        process = compiling._process
        assert process is None or process.poll() is None
    assert process is None or process.returncode == -9
    assert compile_cache.wants_compiling()


def test_a_touched_source_is_compiled_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    source = tmp_path / "chain.py"
    source.write_text("")
    monkeypatch.setattr(compile_cache, "_compiled_sources", lambda: [(source, b"")])
    assert compile_cache.wants_compiling()
    compile_cache.note_compiled()
    assert not compile_cache.wants_compiling()
    os.utime(source, (1.0, 1.0))
    assert compile_cache.wants_compiling()


def test_nothing_is_compiled_early_where_nothing_can_be_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    assert not compile_cache.wants_compiling()
    assert compile_cache.count_compiled() == 0
