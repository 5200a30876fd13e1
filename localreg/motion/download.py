"""Downloads that go on where they broke off, for pooch: patient, polite, distrustful.

What has arrived lies in a partial file that outlives the program. The next try asks for the
rest (HTTP ranges) on condition that the server still has the same file, by its ETag or date;
a server that gives neither starts anew. A file counts as complete when its length is what
the server announced and its content is what its name promises.
"""

import errno
import hashlib
import json
import re
import shutil
import threading
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

import requests
from urllib3.exceptions import HTTPError, NewConnectionError, ReadTimeoutError

from localreg.errors import LocalregError

Check = Callable[[Path], str]
"""Says what is wrong with a complete file; empty if nothing."""

Told = Callable[[int, int], None]
"""Told how many bytes of a file have arrived, of how many (0 if unknown)."""

_CHUNK: Final = 2**16
_SPARE: Final = 64 * 2**20  # left free on every disk [bytes]
_LONGEST_WAIT: Final = 60.0
_PASSING: Final = frozenset({408, 425, 429, 500, 502, 503, 504})
_TRIES_TO_CONNECT: Final = 2


class DownloadError(LocalregError):
    """A file that cannot be had; says why."""


class OfflineError(DownloadError):
    """The server cannot be reached at all, so that asking for more files is no use."""


class DiskFullError(DownloadError):
    """There is no room for what is to be downloaded."""


class _PassingError(Exception):
    """Something that may be better next time."""

    def __init__(self, reason: str, wait: float = 0.0, *, connected: bool = True) -> None:
        super().__init__(reason)
        self.wait, self.connected = wait, connected


@dataclass(frozen=True, slots=True)
class Patience:
    """How long to try.

    Attributes:
        timeout: silence after which a server counts as stalled [s].
        tries: how often to try a file.
        pause: wait before the second try, doubled before each further one [s].
    """

    timeout: float = 30.0
    tries: int = 5
    pause: float = 1.0


class Downloader:
    """Gets files as pooch wants them got; may be used by several threads.

    Args:
        partial: folder for what is not complete yet.
        patience: how long to try.
        checks: by ending of a file's name, what tells whether its content is right.
        told: told of progress.
    """

    def __init__(
        self,
        partial: Path,
        patience: Patience | None = None,
        checks: dict[str, Check] | None = None,
        told: Told | None = None,
    ) -> None:
        self._partial = partial
        self._patience = patience or Patience()
        self._checks = checks or {}
        self._told = told or (lambda done, total: None)
        self._stopped = threading.Event()

    def stop(self) -> None:
        """Give up what is under way, keeping what has arrived."""
        self._stopped.set()

    def __call__(self, url: str, output_file: str, pooch: Any) -> None:
        """Download a file; called by pooch, which then compares checksums.

        Raises:
            DownloadError: the file cannot be had.
        """
        self._partial.mkdir(parents=True, exist_ok=True)
        name = re.sub(r"[^\w.]+", "-", url.rpartition("/")[2])[:80]
        part = self._partial / f"{hashlib.sha256(url.encode()).hexdigest()[:12]}-{name}.part"
        check = self._checks.get(Path(url).suffix.lower(), lambda file: "")
        reason = _PassingError("")
        for attempt in range(self._patience.tries):
            if self._stopped.is_set():
                break
            if attempt:
                wait = max(reason.wait, self._patience.pause * 2.0 ** (attempt - 1))
                self._stopped.wait(min(wait, _LONGEST_WAIT))
            try:
                self._attempt(url, part)
                if problem := check(part):
                    _forget(part)
                    raise _PassingError(problem)
                shutil.move(part, output_file)
                _forget(part)
                return
            except _PassingError as error:
                reason = error
                if not error.connected and attempt + 1 >= _TRIES_TO_CONNECT:
                    raise OfflineError(
                        f"cannot reach {url}: {error}; connect to the network, or name a mirror"
                    ) from error
            except OSError as error:
                if error.errno in (errno.ENOSPC, errno.EDQUOT):
                    raise DiskFullError(_full(self._partial)) from error
                raise DownloadError(f"cannot write {part}: {error}; mend that first") from error
        raise DownloadError(
            f"cannot get {url}: {reason}, {self._patience.tries} times in a row; try again later"
        )

    def _attempt(self, url: str, part: Path) -> None:
        """Try to complete the partial file."""
        have, same = _state(part)
        headers = {"User-Agent": user_agent(), "Accept-Encoding": "identity"}
        if have and same:
            headers |= {"Range": f"bytes={have}-", "If-Range": same}
        try:
            with requests.get(
                url, headers=headers, stream=True, timeout=self._patience.timeout
            ) as response:
                self._take(url, response, part, have if "Range" in headers else 0)
        except (requests.Timeout, ReadTimeoutError) as error:
            connected = not isinstance(error, requests.ConnectTimeout)
            reason = f"the server was silent for {self._patience.timeout:g} s"
            raise _PassingError(reason, connected=connected) from error
        except (requests.ConnectionError, HTTPError) as error:
            cause = getattr(error.args[0], "reason", None) if error.args else None
            connected = not isinstance(cause, NewConnectionError)
            reason = "the connection broke off" if connected else "no connection"
            raise _PassingError(reason, connected=connected) from error
        except requests.RequestException as error:
            raise DownloadError(f"cannot get {url}: {error}; correct the address") from error

    def _take(self, url: str, response: requests.Response, part: Path, have: int) -> None:
        """Write what the server answers to the partial file."""
        status = response.status_code
        if status in _PASSING:
            wait = response.headers.get("Retry-After", "")
            raise _PassingError(
                f"the server answers {status} {response.reason}",
                float(wait) if wait.isdigit() else 0.0,
            )
        if status == 416:  # more is there than the server has
            _forget(part)
            raise _PassingError("the file on the server has become shorter")
        if status not in (200, 206):
            raise DownloadError(
                f"the server has no {url}: it answers {status} {response.reason}; check the "
                "number, or name another mirror"
            )
        start = _start(response)
        if status == 200 or start != have:
            if status == 206:
                _forget(part)
                raise _PassingError("the server sent another part than the one asked for")
            _forget(part)
            have = 0
        length = response.headers.get("Content-Length", "")
        total = have + int(length) if length.isdigit() else 0
        check_room(part.parent, total - have)
        _remember(part, response)
        with part.open("ab" if have else "wb") as file:
            # What has come is taken at once: whole chunks would be lost when a server breaks off.
            while chunk := response.raw.read1(_CHUNK):
                file.write(chunk)
                have += len(chunk)
                self._told(have, total)
                if self._stopped.is_set():
                    raise DownloadError(f"{url}: stopped; what has arrived is kept")
        if total and have != total:
            raise _PassingError(f"{have} bytes came of {total}")


def check_room(folder: Path, needed: int) -> None:
    """Check that a disk has room for so many bytes, and some to spare.

    Raises:
        DiskFullError: it has not.
    """
    if needed + _SPARE > shutil.disk_usage(folder).free:
        raise DiskFullError(_full(folder, needed))


def user_agent() -> str:
    """How this program introduces itself to servers."""
    try:
        return f"localreg-mocap/{version('localreg-mocap')} (motion capture research)"
    except PackageNotFoundError:
        return "localreg-mocap (motion capture research)"


def _full(folder: Path, needed: int = 0) -> str:
    free = shutil.disk_usage(folder).free / 2**20
    wanted = f", {needed / 2**20:.0f} MB are needed" if needed else ""
    return (
        f"the disk of {folder} is full: {free:.0f} MB are free{wanted}; make room or choose fewer"
    )


def _start(response: requests.Response) -> int:
    """Where the bytes of a partial answer begin."""
    content = response.headers.get("Content-Range", "")
    first = content.removeprefix("bytes ").partition("-")[0]
    return int(first) if first.isdigit() else 0


def _notes(part: Path) -> Path:
    return part.with_suffix(".json")


def _state(part: Path) -> tuple[int, str]:
    """How many bytes are there, and what tells the server's file from a newer one."""
    try:
        same = json.loads(_notes(part).read_text(encoding="utf-8"))["same"]
        return part.stat().st_size, str(same)
    except (OSError, ValueError, KeyError, TypeError):
        return 0, ""


def _remember(part: Path, response: requests.Response) -> None:
    """Keep what tells the server's file from a newer one; weak ETags do not."""
    tag = response.headers.get("ETag", "")
    same = tag if tag and not tag.startswith("W/") else response.headers.get("Last-Modified", "")
    _notes(part).write_text(json.dumps({"same": same}), encoding="utf-8")


def _forget(part: Path) -> None:
    part.unlink(missing_ok=True)
    _notes(part).unlink(missing_ok=True)
