"""Files that take their places only when they are complete and on disk."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def written_at_once(path: Path) -> Iterator[Path]:
    """A path to write to instead of `path`, in a temporary folder beside it.

    Everything that is in the folder at the end takes its place beside `path`, so that a
    writer may make several files that go together. If anything fails nothing is changed.

    Raises:
        OSError: the folder cannot be written to, or the disk is full.
    """
    folder = path.absolute().parent
    temporary = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=folder))
    try:
        yield temporary / path.name
        made = sorted(temporary.iterdir())
        for file in made:
            _to_disk(file)
        for file in made:
            file.replace(folder / file.name)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _to_disk(file: Path) -> None:
    """Make sure of the file's bytes, which is when a full disk may first say so."""
    with file.open("rb+") as opened:
        os.fsync(opened.fileno())
