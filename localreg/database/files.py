"""A folder of plain arrays with a manifest: written all or not at all, checked when read.

The manifest (JSON) names the format and its version and gives for every array its file,
type, shape, size and checksum, so that a damaged or foreign folder is told apart from a
good one before any of its numbers are believed.
"""

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy import ndarray

from localreg.errors import DatabaseError

FORMAT: Final = "localreg pose database"
VERSION: Final = 1
MANIFEST: Final = "manifest.json"

UNFINISHED: Final = ".*.new-*"
"""What folders are called while they are written; one may be left after a crash."""

SMALL: Final = 64 * 2**20
"""Databases up to this size [bytes] have their checksums verified at every load."""


def write_folder(
    folder: Path,
    document: Mapping[str, Any],
    arrays: Mapping[str, ndarray],
    form: str = FORMAT,
) -> None:
    """Write arrays and a document as a database folder, or as a folder of another format.

    Everything goes to a temporary folder beside the target, which takes the target's
    place only when it is complete and on disk. An older database there is kept until
    then, and kept for good when anything fails.

    Raises:
        DatabaseError: the place holds something that is no database, or the disk refuses.
    """
    folder = folder.absolute()
    if folder.exists() and not _is_replaceable(folder, form):
        raise DatabaseError(
            f"{folder} exists and is not a pose database; give another folder or remove it"
        )
    temporary = None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.new-", dir=folder.parent))
        temporary.chmod(0o755)
        _fill(temporary, document, arrays, form)
        _take_place(temporary, folder)
    except OSError as error:
        reason = error.strerror or str(error)
        raise DatabaseError(
            f"cannot write the database {folder}: {reason}; what was there before is unchanged"
        ) from error
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)


def read_folder(
    folder: Path, *, verify: bool | None = None, form: str = FORMAT
) -> tuple[dict[str, Any], dict[str, ndarray]]:
    """Read a database folder: its document and its arrays, mapped into memory read-only.

    Args:
        folder: the database.
        verify: whether to verify the arrays' checksums; by default when they are small
            (64 MB together). Presence, sizes, types and shapes are always checked.
        form: the format that the folder must be of.

    Raises:
        DatabaseError: the folder is missing, foreign, damaged or of another version.
    """
    manifest = _read_manifest(folder, form)
    try:
        entries = {str(name): dict(entry) for name, entry in manifest["arrays"].items()}
        total = sum(int(entry["bytes"]) for entry in entries.values())
        if verify is None:
            verify = total <= SMALL
        arrays = {
            name: _read_array(folder / str(entry["file"]), entry, verify)
            for name, entry in entries.items()
        }
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _damaged(folder, f"its {MANIFEST} lacks or garbles {error}") from error
    return manifest["document"], arrays


def identity_of(folder: Path) -> str:
    """What tells the arrays of a folder from any others, without reading them."""
    arrays = _read_manifest(folder)["arrays"]
    return _json_checksum({name: entry["blake2b"] for name, entry in arrays.items()})


def is_of_format(folder: Path, form: str) -> bool:
    """Whether a folder says that it is of a format, however damaged it may be."""
    try:
        manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(manifest, dict) and manifest.get("format") == form


def _fill(
    folder: Path, document: Mapping[str, Any], arrays: Mapping[str, ndarray], form: str
) -> None:
    entries = {}
    for name, array in arrays.items():
        path = folder / f"{name}.npy"
        with path.open("wb") as file:
            np.save(file, array, allow_pickle=False)
            file.flush()
            os.fsync(file.fileno())
        entries[name] = {
            "file": path.name,
            "dtype": array.dtype.str,
            "shape": list(array.shape),
            "bytes": path.stat().st_size,
            "blake2b": _checksum(path),
        }
    body = {
        "format": form,
        "version": VERSION,
        "arrays": entries,
        "document": dict(document),
    }
    manifest = {**body, "blake2b": _json_checksum(body)}
    with (folder / MANIFEST).open("w", encoding="utf-8") as file:
        json.dump(manifest, file, indent=1)
        file.flush()
        os.fsync(file.fileno())


def _take_place(temporary: Path, folder: Path) -> None:
    if not folder.exists():
        temporary.rename(folder)
        return
    # A folder cannot be renamed over one with files in it: the old one steps aside,
    # and back again should the new one fail to arrive.
    aside = Path(tempfile.mkdtemp(prefix=f".{folder.name}.old-", dir=folder.parent))
    try:
        folder.rename(aside / folder.name)
        try:
            temporary.rename(folder)
        except BaseException:
            (aside / folder.name).rename(folder)
            raise
    except BaseException:
        aside.rmdir()
        raise
    shutil.rmtree(aside, ignore_errors=True)


def _is_replaceable(folder: Path, form: str) -> bool:
    return folder.is_dir() and (not any(folder.iterdir()) or is_of_format(folder, form))


def _read_manifest(folder: Path, form: str = FORMAT) -> dict[str, Any]:
    path = folder / MANIFEST
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        if not folder.exists():
            raise DatabaseError(
                f"there is no database at {folder}; `localreg db build` makes one"
            ) from None
        raise DatabaseError(
            f"{folder} is not a pose database: it has no {MANIFEST}; `localreg db build` makes one"
        ) from None
    except OSError as error:
        raise DatabaseError(f"cannot read {path}: {error.strerror}") from error
    except ValueError as error:
        raise _damaged(folder, f"its {MANIFEST} is not JSON") from error
    if not isinstance(manifest, dict) or manifest.get("format") != form:
        raise DatabaseError(f"{folder} is not a pose database: its {MANIFEST} is another program's")
    version = manifest.get("version")
    if isinstance(version, int) and version > VERSION:
        raise DatabaseError(
            f"{folder} has database version {version}, newer than the {VERSION} that this program "
            "reads; update localreg or build the database again"
        )
    if version != VERSION:
        raise DatabaseError(
            f"{folder} has database version {version!r}; this program reads {VERSION}: "
            "build the database again"
        )
    checksum = manifest.pop("blake2b", None)
    if checksum != _json_checksum(manifest):
        raise _damaged(folder, f"the checksum of its {MANIFEST} does not match")
    return manifest


def _read_array(path: Path, entry: Mapping[str, Any], verify: bool) -> ndarray:
    try:
        size = path.stat().st_size
        if size != entry["bytes"]:
            raise _damaged(path.parent, f"{path.name} has {size} bytes instead of {entry['bytes']}")
        if verify and _checksum(path) != entry["blake2b"]:
            raise _damaged(path.parent, f"the checksum of {path.name} does not match")
        array = _open_array(path)
    except FileNotFoundError:
        raise _damaged(path.parent, f"{path.name} is missing") from None
    except OSError as error:
        raise DatabaseError(f"cannot read {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise _damaged(path.parent, f"{path.name} is not a plain NumPy array") from error
    if array.dtype.str != entry["dtype"] or list(array.shape) != entry["shape"]:
        raise _damaged(path.parent, f"{path.name} holds {array.dtype} {array.shape}")
    return array


def _open_array(path: Path) -> ndarray:
    return np.load(path, mmap_mode="r", allow_pickle=False)


def _damaged(folder: Path, what: str) -> DatabaseError:
    return DatabaseError(f"the database {folder} is damaged: {what}; build it again")


def _checksum(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, lambda: hashlib.blake2b(digest_size=32)).hexdigest()


def _json_checksum(body: Mapping[str, Any]) -> str:
    text = json.dumps(body, sort_keys=True, separators=(",", ":"))
    return hashlib.blake2b(text.encode(), digest_size=32).hexdigest()
