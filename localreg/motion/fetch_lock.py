"""The lock file: checksums of what was fetched, kept beside it."""

import json
import time
from pathlib import Path
from typing import Any, Final, Self

import pooch

from localreg.errors import MotionError
from localreg.motion.formats.atomic import written_at_once

LOCK_NAME: Final = "cmu-lock.json"
"""File name of the checksums of what was fetched."""


class Lock:
    """Checksums of what was fetched, in a file beside it.

    Attributes:
        path: the file.
        files: by name the file's SHA-256, its size [bytes], where and when it was fetched.
    """

    def __init__(self, path: Path, files: dict[str, dict[str, Any]]) -> None:
        self.path, self.files = path, files

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read the lock file; empty if there is none.

        Raises:
            MotionError: it cannot be read as one.
        """
        if not path.is_file():
            return cls(path, {})
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
            files = {
                str(name): dict(entry, sha256=str(entry["sha256"]))
                for name, entry in document["files"].items()
            }
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise MotionError(
                f"{path} is not a lock file of this program; remove it to do without checksums"
            ) from error
        return cls(path, files)

    @property
    def hashes(self) -> dict[str, str]:
        """Checksums by name, as pooch writes them."""
        return {name: f"sha256:{entry['sha256']}" for name, entry in self.files.items()}

    def record(self, name: str, path: Path, url: str) -> None:
        """Note the checksum of a file, and the address that it came from."""
        self.files[name] = {
            "sha256": pooch.file_hash(str(path), alg="sha256"),
            "bytes": path.stat().st_size,
            "url": url,
            "date": time.strftime("%Y-%m-%d", time.gmtime()),
        }

    def save(self) -> None:
        """Write the file, at once or not at all."""
        document = {"version": 1, "files": dict(sorted(self.files.items()))}
        try:
            with written_at_once(self.path) as temporary:
                temporary.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
        except OSError as error:
            raise unwritable(self.path, error) from error


def unwritable(path: Path, error: OSError) -> MotionError:
    """The error for a file that cannot be written."""
    reason = (error.strerror or str(error)).lower()
    return MotionError(f"cannot write {path}: {reason}; make room there or choose another place")
