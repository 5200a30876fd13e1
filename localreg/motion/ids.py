"""Who moves, and in which recording: one normal form of the names CMU's trials go by.

The same trial is called `02_01` in CMU's own files, `CMU_002_01` in dm_control's, and
bare numbers elsewhere. Everything here is written as CMU does: numbers of at least two
digits, so that copies of one trial can be told to be the same whatever file they are in.
"""

import re
from typing import Final

_TRIAL: Final = re.compile(r"(?:CMU[ _-]?)?(\d{1,4})_(\d{1,3})", re.IGNORECASE)
_SUBJECT: Final = re.compile(r"(?:CMU[ _-]?)?(\d{1,4})", re.IGNORECASE)


def normal_subject(name: str) -> str:
    """The normal form of a subject id.

    Numbers get two digits or more, `"2"`, `"002"` and `"CMU_002"` become `"02"`; any
    other name is left as it is.
    """
    match = _SUBJECT.fullmatch(name.strip())
    return f"{int(match[1]):02d}" if match else name.strip()


def normal_trial(name: str) -> str:
    """The normal form of a trial id.

    `"CMU_016_22"` and `"16_22"` become `"16_22"`; any other name is left as it is.
    """
    match = _TRIAL.fullmatch(name.strip())
    return f"{int(match[1]):02d}_{int(match[2]):02d}" if match else name.strip()


def subject_of_trial(name: str) -> str:
    """The subject that a trial's name tells, `"02"` of `"02_01"`; empty if it tells none."""
    match = _TRIAL.fullmatch(name.strip())
    return f"{int(match[1]):02d}" if match else ""
