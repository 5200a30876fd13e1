"""Text files of motions: reading them, and errors that name the line."""

from pathlib import Path
from typing import Final

from localreg.errors import MotionError

LARGEST: Final = 1e9
"""No length or angle of a motion is larger, in any unit; what is would only overflow."""

LARGEST_FILE: Final = 2**30
"""Bytes of the largest file that is read: hours of text, which takes some times its size."""


def read_bytes(path: Path) -> bytes:
    """The bytes of a file.

    Raises:
        MotionError: the file cannot be read, or is too large to be read at once.
    """
    try:
        size = path.stat().st_size
        if size > LARGEST_FILE:
            raise MotionError(f"{path} has {size / 2**30:.1f} GiB, more than 1; cut it into takes")
        return path.read_bytes()
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise MotionError(f"cannot read {path}: {reason}; check the path") from error


def split_lines(data: bytes) -> list[bytes]:
    """The lines of a text whichever way they end, numbered as editors number them.

    Some of CMU's files end lines with several carriage returns, so those count for
    nothing, except in a text that has no line feed at all.
    """
    separator = b"\n" if b"\n" in data else b"\r"
    lines = [line.strip() for line in data.split(separator)]
    return lines if lines[-1] else lines[:-1]


def fault(path: Path, line: int, message: str) -> MotionError:
    """The error for something wrong in a line of a file, counted from one."""
    return MotionError(f"{path}, line {max(line, 1)}: {message}")


def show(token: bytes) -> str:
    """A token fit for a message: quoted, printable and not too long."""
    text = token.decode("utf-8", errors="replace")
    return repr(text if len(text) <= 40 else text[:37] + "...")


def whole_number(token: bytes) -> int | None:
    """The whole number that a token of digits stands for; None if it is none or absurd."""
    return int(token) if token.isdigit() and len(token) <= 18 else None


def is_sane(value: float) -> bool:
    """Whether a number can be a length or an angle: finite and not absurdly large."""
    return abs(value) <= LARGEST
