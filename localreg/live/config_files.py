"""Configurations that come along, by name: from the clone, or from inside the package."""

import difflib
from pathlib import Path
from typing import Final

from localreg.errors import LocalregError

_PACKAGE: Final = Path(__file__).resolve().parents[1]

# A wheel carries the folder inside the package; a clone has it beside.
_FOLDERS: Final = (_PACKAGE / "configs", _PACKAGE.parent / "configs")

# Files of the same folder that are no configurations of a run.
_OTHERS: Final = frozenset({"cmu-overrides"})


def shipped_configs() -> dict[str, Path]:
    """The configurations that come along, by name."""
    folder = next((folder for folder in _FOLDERS if folder.is_dir()), None)
    files = [] if folder is None else sorted(folder.glob("*.toml"))
    return {file.stem: file for file in files if file.stem not in _OTHERS}


def find_config(name: str) -> Path:
    """The file of a configuration.

    Args:
        name: a name that comes along, for example `is900`, or a path.

    Raises:
        LocalregError: there is neither; lists the names.
    """
    path = Path(name).expanduser()
    if path.suffix == ".toml" or len(path.parts) > 1:
        if not path.is_file():
            raise LocalregError(f"there is no configuration file {path}")
        return path
    shipped = shipped_configs()
    if name in shipped:
        return shipped[name]
    near = difflib.get_close_matches(name, shipped, n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    raise LocalregError(
        f"no configuration is named {name!r}; {hint}there are {', '.join(shipped)}, or give a file "
        "ending in .toml"
    )
