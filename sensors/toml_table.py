"""Replaces one table of a TOML file and leaves everything else as it is, comments too."""

import re
import tempfile
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import tomli_w

from sensors.errors import ConfigurationError

_HEADER = re.compile(r"^\s*\[{1,2}[^\[\]]+\]{1,2}\s*(#.*)?$")


def replace_table(path: Path, name: str, values: Mapping[str, Any]) -> None:
    """Set a table of a file; it is added at the end if there is none.

    The file is replaced at once, so that nobody ever sees half of it.

    Args:
        path: a TOML file.
        name: of the table, without brackets.
        values: its whole new content.

    Raises:
        ConfigurationError: if the file cannot be read or written, or the result would not
            be what it was with a new table.
    """
    try:
        text = path.read_text(encoding="utf-8")
        before = tomllib.loads(text)
        changed = _with_table(text, name, tomli_w.dumps({name: dict(values)}))
        expected = {**before, name: tomllib.loads(tomli_w.dumps(dict(values)))}
        if tomllib.loads(changed) != expected:
            raise ConfigurationError(
                f"the table [{name}] of {path} is written in a way that cannot be replaced; "
                f"write it as [{name}] with one setting a line"
            )
        _write(path, changed)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigurationError(f"cannot change {path}: {error}") from error


def _with_table(text: str, name: str, table: str) -> str:
    lines = text.splitlines(keepends=True)
    header = re.compile(rf"^\s*\[\s*{re.escape(name)}\s*\]\s*(#.*)?$")
    start = next((i for i, line in enumerate(lines) if header.match(line.rstrip("\n"))), None)
    if start is None:
        separator = "" if not text or text.endswith("\n\n") else "\n"
        return text.rstrip("\n") + "\n" * bool(text) + separator + table
    end = start + 1
    while end < len(lines) and not _HEADER.match(lines[end].rstrip("\n")):
        end += 1
    # Comments and blank lines right before the next table belong to that table.
    while end > start + 1 and lines[end - 1].lstrip().startswith(("#", "\n")):
        end -= 1
    return "".join(lines[:start]) + table + "".join(lines[end:])


def _write(path: Path, text: str) -> None:
    with tempfile.NamedTemporaryFile(
        "w", encoding="utf-8", dir=path.resolve().parent, delete=False
    ) as file:
        file.write(text)
    scratch = Path(file.name)
    try:
        scratch.chmod(path.stat().st_mode & 0o777)
        scratch.replace(path.resolve())
    except OSError:
        scratch.unlink(missing_ok=True)
        raise
