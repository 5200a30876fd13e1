"""Rates that CMU's index gives, as overrides for commands that read the files."""

from collections.abc import Iterable
from pathlib import Path
from typing import Final

import tomli_w

from localreg.motion.cmu_index import Trial
from localreg.motion.fetch_lock import unwritable
from localreg.motion.formats.atomic import written_at_once
from localreg.motion.overrides import Overrides

RATES_NAME: Final = "cmu-rates.toml"
"""File name of the overrides with the rates that differ from the usual one."""

USUAL_RATE: Final = 120.0
"""Frames a second of most of CMU's recordings [Hz]."""


def write_rates(trials: Iterable[Trial], folder: Path) -> None:
    """Add the rates that differ from the usual one to the folder's overrides file.

    Rules that the file has already stay as they are.

    Raises:
        MotionError: the file cannot be written, or what is there is no overrides file.
    """
    path = folder / RATES_NAME
    rules = Overrides.load(path).file if path.is_file() else ()
    known = {rule.match for rule in rules}
    added = [
        {"match": f"{trial.name}.amc", "rate": trial.rate}
        for trial in trials
        if trial.rate not in (None, USUAL_RATE) and f"{trial.name}.amc" not in known
    ]
    if not added:
        return
    document = {
        "version": 1,
        "file": [*(rule.model_dump(exclude_none=True) for rule in rules), *added],
    }
    try:
        with written_at_once(path) as temporary:
            temporary.write_text(tomli_w.dumps(document), encoding="utf-8")
    except OSError as error:
        raise unwritable(path, error) from error
