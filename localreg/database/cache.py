"""Arrays that take long to work out, kept in the user's cache folder and mapped from there.

Entries are named by a digest of everything they depend on, so that a stale one is never
found; it is removed when room is wanted. An entry is written whole or not at all, and one
that cannot be read or written costs the time to work it out, nothing else.
"""

import contextlib
import hashlib
import os
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import numpy as np
from numpy import ndarray

from localreg.database.files import UNFINISHED, is_of_format, read_folder, write_folder
from localreg.errors import DatabaseError

FORMAT: Final = "localreg cached arrays"
FOLDER: Final = "LOCALREG_CACHE_DIR"
"""The environment variable that names another folder than the user's own."""

MOST_BYTES: Final = 4 * 2**30
"""The folder is kept below this size [bytes]."""

_PAGE: Final = 4096  # bytes


def cache_folder() -> Path:
    """Where entries are kept: `LOCALREG_CACHE_DIR`, or a folder of the user's cache."""
    if named := os.environ.get(FOLDER):
        return Path(named)
    from platformdirs import user_cache_path

    return user_cache_path("localreg") / "arrays"


def digest(*parts: str | float | ndarray) -> str:
    """A short name for exactly these values."""
    known = hashlib.blake2b(digest_size=16)
    for part in parts:
        if isinstance(part, np.ndarray):
            known.update(f"{part.dtype.str}{part.shape}".encode())
            known.update(np.ascontiguousarray(part).tobytes())
        else:
            known.update(f"{part!r};".encode())
    return known.hexdigest()


def cached_arrays(
    name: str,
    make: Callable[[], Mapping[str, ndarray]],
    folder: Path | None = None,
    most_bytes: int = MOST_BYTES,
) -> dict[str, ndarray]:
    """The arrays of that name, made if they are not there; mapped read-only if they are.

    They are plain arrays in either case: a memory map is slow to index.

    Args:
        name: from `digest`.
        make: works them out.
        folder: where entries are kept; `cache_folder()` by default.
        most_bytes: the least recently used entries make room beyond this size.
    """
    place = (cache_folder() if folder is None else folder) / name
    found = _read(place)
    if found is not None:
        return found
    made = dict(make())
    try:
        write_folder(place, {}, made, FORMAT)
        _make_room(place, most_bytes)
    except (DatabaseError, OSError):
        return _read_only(made)
    # Mapped pages can be let go when memory is short; the arrays as made cannot.
    return _read(place) or _read_only(made)


def touch(array: ndarray) -> None:
    """Have all pages of a mapped array in memory, so that none is fetched in a frame."""
    flat = array.reshape(-1)
    flat[:: max(1, _PAGE // flat.itemsize)].max(initial=0)


def _read(place: Path) -> dict[str, ndarray] | None:
    try:
        arrays = read_folder(place, verify=False, form=FORMAT)[1]
    except DatabaseError:
        return None
    with contextlib.suppress(OSError):
        os.utime(place)
    return _read_only(arrays)


def _read_only(arrays: Mapping[str, ndarray]) -> dict[str, ndarray]:
    """Views of one type, whether mapped or not, that nobody can write to."""
    views = {name: array.view(np.ndarray) for name, array in arrays.items()}
    for view in views.values():
        view.flags.writeable = False
    return views


def _make_room(kept: Path, most_bytes: int) -> None:
    """Remove the least recently used entries; what is mapped by anybody stays readable.

    The folder may be one that the user has named and hold other things: they are let be.
    """
    entries = []
    for path in kept.parent.iterdir():
        if not is_of_format(path, FORMAT) and not path.match(UNFINISHED):
            continue
        with contextlib.suppress(OSError):
            size = sum(file.stat().st_size for file in path.iterdir())
            entries.append((path.stat().st_mtime, size, path))
    total = sum(size for _, size, _ in entries)
    for _, size, path in sorted(entries):
        if total <= most_bytes:
            break
        if path != kept:
            shutil.rmtree(path, ignore_errors=True)
            total -= size
