"""Motions from CMU's site: chosen from its index, fetched with care, checksums kept.

Files lie as on the site, `subjects/35/35.asf` and `subjects/35/35_01.amc`, below a folder
of the user's, with CMU's index (`cmu-index.tsv`), which also tells activities to
`localreg.motion.index`, and a lock file (`cmu-lock.json`) with the checksum of everything
that was fetched. What is there and sound is not fetched again; what differs from its
checksum is, and a server that has something else now is an error, not a silent change.
"""

import queue
import threading
import time
import zipfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, Final

import pooch

from localreg.errors import MotionError
from localreg.motion.cmu_index import PAGE, Trial, read_index, write_index
from localreg.motion.download import (
    DiskFullError,
    Downloader,
    DownloadError,
    OfflineError,
    Patience,
    Told,
    check_room,
)
from localreg.motion.download_checks import CHECKS
from localreg.motion.fetch_lock import LOCK_NAME, Lock, unwritable
from localreg.motion.fetch_rates import write_rates
from localreg.motion.formats.atomic import written_at_once
from localreg.motion.index import INDEX_NAME

SITE: Final = "http://mocap.cs.cmu.edu"
"""CMU's site; it says that the data may be copied, modified and redistributed."""

CREDIT: Final = (
    "The data used in this project was obtained from mocap.cs.cmu.edu. The database was created "
    "with funding from NSF EIA-0196217."
)
"""What CMU asks to be said where its data is used."""

ARCHIVE: Final = "allasfamc.zip"
"""The whole database in one file, on CMU's site."""

MOST_CONNECTIONS: Final = 8
"""So many at once, and no more, are polite."""

_PARTIAL: Final = ".partial"
_TYPICAL: Final = 2_000_000  # of a motion: 38 of them are 1.87 MB on average [bytes]
_EVERY: Final = 2.0  # how often the lock file is written meanwhile [s]

Progress = Callable[[int, int, str], None]
"""Told how much is done, of how much, and what it is."""


@dataclass(frozen=True, slots=True)
class Source:
    """Where to fetch from, and how hard to try.

    Attributes:
        site: address of CMU's site or of a mirror of it.
        connections: how many files to fetch at once.
        patience: how long to try each.
    """

    site: str = SITE
    connections: int = 4
    patience: Patience = field(default_factory=Patience)

    def __post_init__(self) -> None:
        if not 1 <= self.connections <= MOST_CONNECTIONS:
            raise MotionError(
                f"{self.connections} connections at once; give 1 to {MOST_CONNECTIONS}"
            )
        if not self.site.startswith(("http://", "https://")):
            raise MotionError(f"{self.site} is no address; it must begin with http:// or https://")

    @property
    def base(self) -> str:
        """The address with a slash at its end."""
        return self.site.rstrip("/") + "/"


@dataclass
class Report:
    """What became of the files that were wanted.

    Attributes:
        fetched: files that came from the site, with their sizes [bytes].
        kept: files that were there already, sound.
        failed: files that could not be had, and why.
    """

    fetched: dict[str, int] = field(default_factory=dict)
    kept: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)


def load_index(
    folder: Path, source: Source, *, index: Path | None = None, update: bool = False
) -> list[Trial]:
    """All trials there are: from a file, from the copy in the folder, or from the site.

    Args:
        folder: where motions are kept; gets a copy of the index.
        source: where to fetch it from.
        index: a file to take instead.
        update: whether to fetch it again.

    Raises:
        LocalregError: there is no index to be had, or it is none.
    """
    copy = folder / INDEX_NAME
    if index is None and copy.is_file() and not update:
        index = copy
    if index is not None:
        try:
            text = index.read_text(encoding="utf-8", errors="replace")
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise MotionError(f"cannot read the index {index}: {reason}; check the path") from error
    else:
        text = _page(folder, source)
    trials = read_index(text)
    if index != copy:
        try:
            with written_at_once(_make_folder(folder) / INDEX_NAME) as temporary:
                write_index(trials, temporary)
        except OSError as error:
            raise unwritable(copy, error) from error
    return trials


def fetch(
    trials: Sequence[Trial],
    folder: Path,
    source: Source | None = None,
    *,
    update: bool = False,
    progress: Progress | None = None,
) -> Report:
    """Fetch trials and the skeletons of their subjects.

    Files that cannot be had are left out and reported; only a server out of reach or a full
    disk ends it all.

    Args:
        trials: what to fetch.
        folder: where to; made if need be.
        source: where from.
        update: whether to take what the site has now, whatever the checksums say.
        progress: told after every file.

    Raises:
        DownloadError: the server cannot be reached, or the disk is full.
        MotionError: the folder cannot be used.
    """
    source = source or Source()
    people = dict.fromkeys(trial.subject for trial in trials)
    names = [f"subjects/{p}/{p}.asf" for p in people]
    names += [f"subjects/{trial.subject}/{trial.name}.amc" for trial in trials]
    lock = Lock.load(_make_folder(folder) / LOCK_NAME)
    for person in people:
        _make_folder(folder / "subjects" / person)
    report = Report()
    tell = progress or (lambda done, total, what: None)
    missing = [name for name in names if not (folder / name).is_file()]
    check_room(folder, _TYPICAL * sum(name.endswith(".amc") for name in missing))
    downloader: Any = _downloader(folder, source)
    cache = _cache(folder, source, names, {} if update else lock.hashes)

    def get(name: str) -> bool:
        path = folder / name
        if not path.is_file():
            cache.fetch(name, downloader=downloader)
            return True
        if update:
            with written_at_once(path) as temporary:
                downloader(cache.get_url(name), str(temporary), cache)
            return True
        before = path.stat().st_mtime_ns
        cache.fetch(name, downloader=downloader)
        return path.stat().st_mtime_ns != before

    said = time.monotonic()
    try:
        results = _at_once(names, get, source.connections)
        for done, (name, future) in enumerate(results, start=1):
            _settle(name, future, folder, source, lock, report)
            tell(done, len(names), name)
            if time.monotonic() - said > _EVERY:
                lock.save()
                said = time.monotonic()
    finally:
        downloader.stop()
        lock.save()
    _clean(folder)
    write_rates(trials, folder)
    return report


def _at_once(
    names: Sequence[str], get: Callable[[str], bool], workers: int
) -> Iterator[tuple[str, Future[bool]]]:
    """Every name with what `get` said of it, as it comes, some at a time.

    The threads are daemons: whoever interrupts the program need not wait for a server that
    stalls.
    """
    waiting: queue.SimpleQueue[str] = queue.SimpleQueue()
    finished: queue.SimpleQueue[tuple[str, Future[bool]]] = queue.SimpleQueue()
    is_over = threading.Event()
    for name in names:
        waiting.put(name)

    def work() -> None:
        while not is_over.is_set():
            try:
                name = waiting.get_nowait()
            except queue.Empty:
                return
            future: Future[bool] = Future()
            try:
                future.set_result(get(name))
            except Exception as error:
                future.set_exception(error)
            finished.put((name, future))

    for number in range(workers):
        threading.Thread(target=work, name=f"fetch-{number}", daemon=True).start()
    try:
        for _ in names:
            yield finished.get()
    finally:
        is_over.set()


def fetch_all(
    folder: Path,
    source: Source | None = None,
    *,
    update: bool = False,
    progress: Progress | None = None,
) -> Report:
    """Fetch the whole database as one archive and unpack it.

    The archive goes when it is unpacked; its checksum stays in the lock file.

    Raises:
        DownloadError: the archive cannot be had, or the disk is full.
        MotionError: the folder cannot be used, or the archive is damaged.
    """
    source = source or Source()
    lock = Lock.load(_make_folder(folder) / LOCK_NAME)
    tell = progress or (lambda done, total, what: None)

    def told(done: int, total: int) -> None:
        tell(done, max(total, done), ARCHIVE)

    known = {} if update else lock.hashes
    cache = _cache(folder, source, [ARCHIVE], known)
    downloader: Any = _downloader(folder, source, told)
    try:
        path = Path(cache.fetch(ARCHIVE, downloader=downloader))
    except ValueError as error:
        raise DownloadError(_changed(ARCHIVE, source)) from error
    except OSError as error:
        raise unwritable(folder / ARCHIVE, error) from error
    lock.record(ARCHIVE, path, source.base + ARCHIVE)
    report = _unpack(path, folder, source, lock, tell)
    lock.save()
    path.unlink()
    _clean(folder)
    return report


def _page(folder: Path, source: Source) -> str:
    """CMU's list of motions, as it is on the site."""
    page = _make_folder(folder / _PARTIAL) / "index.html"
    try:
        Downloader(folder / _PARTIAL, source.patience)(source.base + PAGE, str(page), None)
        return page.read_text(encoding="utf-8", errors="replace")
    finally:
        page.unlink(missing_ok=True)
        _clean(folder)


def _cache(
    folder: Path, source: Source, names: Sequence[str], hashes: dict[str, str]
) -> pooch.Pooch:
    pooch.get_logger().setLevel("ERROR")
    registry = {name: hashes.get(name) for name in names}
    return pooch.create(path=folder, base_url=source.base, registry=registry)


def _downloader(folder: Path, source: Source, told: Told | None = None) -> Downloader:
    return Downloader(folder / _PARTIAL, source.patience, CHECKS, told)


def _settle(
    name: str, future: Future[bool], folder: Path, source: Source, lock: Lock, report: Report
) -> None:
    """Note what became of one file; only what ends it all is raised."""
    try:
        is_new = future.result()
    except (OfflineError, DiskFullError):
        raise
    except DownloadError as error:
        report.failed[name] = str(error)
        return
    except ValueError:  # what pooch says of another checksum
        report.failed[name] = _changed(name, source)
        return
    except OSError as error:
        raise unwritable(folder / name, error) from error
    if is_new or name not in lock.files:
        lock.record(name, folder / name, source.base + name)
    if is_new:
        report.fetched[name] = lock.files[name]["bytes"]
    else:
        report.kept.append(name)


def _changed(name: str, source: Source) -> str:
    return (
        f"{source.base}{name} is not what was fetched from there before (its checksum differs "
        f"from {LOCK_NAME}); --update takes the new one"
    )


def _unpack(path: Path, folder: Path, source: Source, lock: Lock, tell: Progress) -> Report:
    """Unpack the motions and skeletons of an archive, each with its checksum verified."""
    report = Report()
    try:
        with zipfile.ZipFile(path) as archive:
            members = [
                (info, name)
                for info in archive.infolist()
                if (name := _member(info.filename)) is not None
            ]
            if not members:
                raise MotionError(f"{path} holds no motions; remove it and fetch again")
            check_room(folder, sum(info.file_size for info, _ in members))
            for done, (info, name) in enumerate(members, start=1):
                target = folder / name
                _make_folder(target.parent)
                with archive.open(info) as packed, written_at_once(target) as temporary:
                    temporary.write_bytes(packed.read())
                lock.record(name, target, source.base + ARCHIVE)
                report.fetched[name] = info.file_size
                tell(done, len(members), name)
    except (zipfile.BadZipFile, NotImplementedError, EOFError) as error:
        raise MotionError(f"{path} is damaged ({error}); remove it and fetch again") from error
    except OSError as error:
        raise unwritable(folder, error) from error
    return report


def _member(filename: str) -> str | None:
    """Where a file of an archive belongs, `subjects/NN/NN_TT.amc`; None if it is no motion."""
    parts = PurePosixPath(filename).parts[-3:]
    if len(parts) < 3 or parts[0] != "subjects" or ".." in parts:
        return None
    name = "/".join(parts)
    return name if name.lower().endswith((".asf", ".amc")) else None


def _make_folder(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise MotionError(f"cannot make {folder}: {reason}; choose another place") from error
    return folder


def _clean(folder: Path) -> None:
    """Remove the folder of partial files if nothing is left in it."""
    partial = folder / _PARTIAL
    if partial.is_dir() and not any(partial.iterdir()):
        partial.rmdir()
