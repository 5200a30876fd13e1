"""Keeps compiled code between runs, so that only the first start has to compile.

Numba's code of live frames takes a minute of one processor to compile and 0.3 s to load again (9
MB), JAX's of the other methods 34 s and 5 s.
Imports nothing heavy: the command line calls it before it knows what is wanted.
"""

import contextlib
import hashlib
import os
import platform
import shutil
import sys
import time
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

_JAX: Final = "JAX_COMPILATION_CACHE_DIR"
_WORTH_KEEPING: Final = ("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.2")
_NUMBA: Final = "NUMBA_CACHE_DIR"

_SOURCES: Final = ("body", "database", "motion", "synthesis")  # where numba compiles
_COMPILED: Final = (b"njit", b"(NamedTuple)")  # in whatever decides what it makes of them
_FORGOTTEN: Final = 30 * 24 * 3600.0  # after so long without a start [s]


def keep_compiled_code(folder: Path | None = None) -> None:
    """Let numba and JAX, here and in child processes, keep what they compile.

    Call it before either is imported. Folders that the user has named (`NUMBA_CACHE_DIR`,
    `JAX_COMPILATION_CACHE_DIR`) stay in force, and `JAX_ENABLE_COMPILATION_CACHE=0` forbids
    JAX's. Code is made for one kind of processor, so every kind has a folder of its own: a
    home directory may be shared by machines. A folder that cannot be used costs the time,
    nothing else.

    Args:
        folder: where; by default in the user's cache directory.
    """
    keep_numba_code(folder)
    place = _of_this_processor(folder)
    if _JAX not in os.environ and _is_usable(place):
        os.environ[_JAX] = str(place)
        os.environ.setdefault(*_WORTH_KEEPING)


def keep_numba_code(folder: Path | None = None) -> None:
    """The same for numba alone.

    Numba looks for changes only in the file that a function stands in, not in those of what
    it calls, so its folder is named by all of them.
    """
    if _NUMBA in os.environ:
        return
    place = _of_this_processor(folder) / f"numba-{_sources()}"
    if _is_usable(place):
        os.environ[_NUMBA] = str(place)
        _forget_others(place)


def wants_compiling() -> bool:
    """Whether the code of frames has not been kept yet, but will be."""
    place = _kept()
    return place is not None and not (place / _mark()).exists()


def note_compiled() -> None:
    """Say that all of the code of frames is kept now."""
    place = _kept()
    if place is not None:
        with contextlib.suppress(OSError):
            (place / _mark()).touch()


def count_compiled() -> int:
    """How many functions are kept, from all places that the program was started in."""
    place = _kept()
    return 0 if place is None else sum(1 for _ in place.rglob("*.nbi"))


def write_in_turn() -> None:
    """Let processes that compile the same functions at once keep both what they made.

    Numba numbers what it keeps of a function by looking at what is there, and nothing stops
    another process from taking the same number for other types: the index would then name
    the code of one for the types of the other.
    """
    from numba.core.caching import IndexDataCacheFile

    save, load = IndexDataCacheFile.save, IndexDataCacheFile.load
    if getattr(save, "_in_turn", False):
        return

    def save_in_turn(self: Any, key: Any, data: Any) -> None:
        with _turn(Path(self._cache_path)):
            save(self, key, data)

    def load_in_turn(self: Any, key: Any) -> Any:
        with _turn(Path(self._cache_path)):
            return load(self, key)

    save_in_turn._in_turn = True  # type: ignore[attr-defined]
    IndexDataCacheFile.save, IndexDataCacheFile.load = save_in_turn, load_in_turn


@contextlib.contextmanager
def _turn(folder: Path) -> Iterator[None]:
    """While nobody else reads or writes a folder; at once if there is none yet."""
    import fcntl

    try:
        lock = (folder / "lock").open("w")
    except OSError:
        yield
        return
    with lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _kept() -> Path | None:
    """Numba's folder, if what it compiles is kept in one of ours or the user's."""
    name = os.environ.get(_NUMBA, "")
    return Path(name) if name and _is_usable(Path(name)) else None


def _mark() -> str:
    """Name of what says that all is kept.

    Numba, too, takes a file that was moved or touched for another one.
    """
    facts = [sys.version, version("numba")]
    for path, _ in _compiled_sources():
        facts.append(f"{path} {path.stat().st_mtime_ns}")
    return f"complete-{_short(chr(10).join(facts).encode())}"


def _of_this_processor(folder: Path | None) -> Path:
    if folder is None:
        from platformdirs import user_cache_path

        folder = user_cache_path("localreg") / "compiled"
    return folder / _processor()


def _is_usable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


def _processor() -> str:
    """A short name of this kind of processor, the same for the same instructions."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    kinds = ("flags", "features", "model name", "cpu part")
    facts = sorted({line for line in lines if line.lower().startswith(kinds)})
    return _short("\n".join([platform.machine(), platform.processor(), *facts]).encode())


def _sources() -> str:
    """A short name of all that numba compiles here."""
    return _short(b"".join(text for _, text in _compiled_sources()))


def _compiled_sources() -> list[tuple[Path, bytes]]:
    """The files that decide what numba makes, and what they say."""
    package = Path(__file__).parent
    paths = (path for part in _SOURCES for path in sorted((package / part).glob("*.py")))
    texts = ((path, path.read_bytes()) for path in paths)
    return [(path, text) for path, text in texts if any(sign in text for sign in _COMPILED)]


def _short(facts: bytes) -> str:
    return hashlib.blake2b(facts, digest_size=6).hexdigest()


def _forget_others(place: Path) -> None:
    """Remove what earlier versions of the program compiled, once nobody starts them any more."""
    with contextlib.suppress(OSError):
        os.utime(place)
        for other in place.parent.glob("numba-*"):
            if time.time() - other.stat().st_mtime > _FORGOTTEN:
                shutil.rmtree(other, ignore_errors=True)
