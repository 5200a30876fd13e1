"""Text files of motions: reading them, and errors that name the line."""

from pathlib import Path

from localreg.errors import MotionError


def read_bytes(path: Path) -> bytes:
    """The bytes of a file.

    Raises:
        MotionError: the file cannot be read.
    """
    try:
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
    return [line.strip() for line in data.split(separator)]


def fault(path: Path, line: int, message: str) -> MotionError:
    """The error for something wrong in a line of a file, counted from one."""
    return MotionError(f"{path}, line {line}: {message}")


def show(token: bytes) -> str:
    """A token fit for a message: quoted, printable and not too long."""
    text = token.decode("utf-8", errors="replace")
    return repr(text if len(text) <= 40 else text[:37] + "...")
