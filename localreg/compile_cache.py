"""Keeps compiled code between runs, so that only the first warm-up takes a minute or two.

Numba's code of live frames takes 25 s to compile and 0.3 s to load again, JAX's of the other
methods 34 s and 5 s; the folder holds some 10 MB.
Imports nothing heavy: the command line calls it before it knows what is wanted.
"""

import contextlib
import hashlib
import os
import platform
import shutil
import time
from pathlib import Path
from typing import Final

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
    package = Path(__file__).parent
    texts = (
        path.read_bytes() for part in _SOURCES for path in sorted((package / part).glob("*.py"))
    )
    return _short(b"".join(text for text in texts if any(sign in text for sign in _COMPILED)))


def _short(facts: bytes) -> str:
    return hashlib.blake2b(facts, digest_size=6).hexdigest()


def _forget_others(place: Path) -> None:
    """Remove what earlier versions of the program compiled, once nobody starts them any more."""
    with contextlib.suppress(OSError):
        os.utime(place)
        for other in place.parent.glob("numba-*"):
            if time.time() - other.stat().st_mtime > _FORGOTTEN:
                shutil.rmtree(other, ignore_errors=True)
