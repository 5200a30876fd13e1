"""Fetching from a site that stalls, cuts short and lies, on real sockets."""

import hashlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections import namedtuple

import pytest

from localreg.errors import MotionError
from localreg.motion import download
from localreg.motion.cmu_index import Trial, choose, read_index
from localreg.motion.download import (
    DiskFullError,
    Downloader,
    DownloadError,
    OfflineError,
    Patience,
)
from localreg.motion.fetch import ARCHIVE, Source, fetch, fetch_all, load_index
from localreg.motion.fetch_lock import LOCK_NAME
from localreg.motion.fetch_rates import RATES_NAME, write_rates
from localreg.motion.formats import read_motion
from localreg.motion.index import INDEX_NAME, activity_of
from localreg.motion.overrides import Overrides
from tests.localreg.motion.cmu_site import ARCHIVE as ARCHIVE_PATH
from tests.localreg.motion.cmu_site import PAGE, TRIALS, cmu_site

WALK = "/subjects/02/02_01.amc"
QUICK = Patience(timeout=2.0, tries=4, pause=0.01)
ALL_FILES = [
    "subjects/02/02.asf", "subjects/02/02_01.amc", "subjects/02/02_02.amc",
    "subjects/60/60.asf", "subjects/60/60_01.amc",
]  # fmt: skip


@pytest.fixture
def site():
    with cmu_site() as running:
        yield running


def source(site, **more):
    return Source(site.address, patience=more.pop("patience", QUICK), **more)


def only_walk(site, folder, **more):
    return fetch([Trial("02", "01", "walk")], folder, source(site), **more)


def there(folder):
    return sorted(
        file.relative_to(folder).as_posix() for file in folder.rglob("*.a?[cf]") if file.is_file()
    )


def assert_same(site, folder, names):
    for name in names:
        assert (folder / name).read_bytes() == site.files["/" + name]


def test_everything_arrives_and_is_motion(site, tmp_path):
    trials = load_index(tmp_path, source(site))
    steps = []
    report = fetch(trials, tmp_path, source(site), progress=lambda *step: steps.append(step))
    assert there(tmp_path) == ALL_FILES
    assert_same(site, tmp_path, ALL_FILES)
    assert sorted(report.fetched) == ALL_FILES
    assert not report.failed
    assert [step[:2] for step in steps] == [(i, 5) for i in range(1, 6)]
    assert site.most_at_once <= 4
    (motion,) = read_motion(tmp_path / "subjects/02/02_01.amc")
    assert len(motion) == 60
    path = tmp_path / "subjects/02/02_02.amc"
    assert activity_of(path, "02_02", tmp_path) == "run/jog"
    lock = json.loads((tmp_path / LOCK_NAME).read_text())["files"]
    for name in ALL_FILES:
        digest = hashlib.sha256(site.files["/" + name]).hexdigest()
        assert lock[name]["sha256"] == digest
        assert lock[name]["url"] == f"{site.address}/{name}"
    rules = Overrides.load(tmp_path / RATES_NAME)
    assert rules.settings(tmp_path / "subjects/60/60_01.amc").rate == 60.0
    assert rules.settings(path).rate is None
    assert not (tmp_path / ".partial").exists()


def test_rates_add_up_and_what_people_wrote_stays(site, tmp_path):
    salsa, waltz = Trial("60", "01", rate=60.0), Trial("60", "02", rate=30.0)
    (tmp_path / RATES_NAME).write_text('version = 1\n[[file]]\nmatch = "60_02.amc"\nrate = 25\n')
    write_rates([salsa], tmp_path)
    write_rates([Trial("02", "01", rate=120.0), waltz], tmp_path)
    rules = Overrides.load(tmp_path / RATES_NAME)
    assert [(rule.match, rule.rate) for rule in rules.file] == [
        ("60_02.amc", 25.0),
        ("60_01.amc", 60.0),
    ]


def test_what_is_there_is_not_fetched_again(site, tmp_path):
    only_walk(site, tmp_path)
    site.asked.clear()
    report = only_walk(site, tmp_path)
    assert site.asked == []
    assert sorted(report.kept) == ALL_FILES[:2]
    assert report.fetched == {}


@pytest.mark.parametrize(
    "tricks", [("503", "503"), ("stall",), ("silence",), ("cut", "cut"), ("short",), ("web page",)]
)
def test_a_bad_moment_passes(site, tmp_path, tricks):
    site.play(WALK, *tricks)
    report = only_walk(site, tmp_path)
    assert not report.failed
    assert_same(site, tmp_path, ALL_FILES[:2])
    assert len(site.requests(WALK)) == len(tricks) + 1


@pytest.mark.parametrize("trick", ["cut", "stall"])
def test_what_broke_off_goes_on_where_it_was(site, tmp_path, trick):
    site.play(WALK, trick)
    only_walk(site, tmp_path)
    first, second = site.requests(WALK)
    half = len(site.files[WALK]) // 2
    assert (first, second) == (None, f"bytes={half}-")
    assert_same(site, tmp_path, ALL_FILES[:2])


def test_without_a_validator_nothing_is_pieced_together(site, tmp_path):
    site.validators = False
    site.play(WALK, "cut")
    only_walk(site, tmp_path)
    assert site.requests(WALK) == [None, None]
    assert_same(site, tmp_path, ALL_FILES[:2])


def test_a_file_that_changed_meanwhile_is_begun_anew(site, tmp_path):
    partial = tmp_path / ".partial"
    site.play(WALK, "cut")
    once = Downloader(partial, Patience(2.0, 1, 0.01))
    with pytest.raises(DownloadError, match="broke off"):
        once(site.address + WALK, str(tmp_path / "x.amc"), None)
    assert any(partial.iterdir())
    old = site.files[WALK]
    site.files[WALK] = old.replace(b"lhumerus", b"LHUMERUS")
    once(site.address + WALK, str(tmp_path / "x.amc"), None)
    assert (tmp_path / "x.amc").read_bytes() == site.files[WALK]


def test_a_constant_liar_is_found_out(site, tmp_path):
    site.play(WALK, *["short"] * 9)
    report = only_walk(site, tmp_path)
    assert "not a whole AMC file" in report.failed["subjects/02/02_01.amc"]
    assert there(tmp_path) == ["subjects/02/02.asf"]
    lock = json.loads((tmp_path / LOCK_NAME).read_text())["files"]
    assert list(lock) == ["subjects/02/02.asf"]


def test_what_is_missing_is_said_and_the_rest_arrives(site, tmp_path):
    trials = load_index(tmp_path, source(site))
    del site.files[WALK]
    report = fetch(trials, tmp_path, source(site))
    (name,) = report.failed
    assert name == "subjects/02/02_01.amc"
    assert "404" in report.failed[name]
    assert there(tmp_path) == [file for file in ALL_FILES if file != name]
    assert len(site.requests(WALK)) == 1  # what is not there will not be there in a second


def test_other_content_than_before_is_no_silent_change(site, tmp_path):
    only_walk(site, tmp_path)
    path = tmp_path / "subjects/02/02_01.amc"
    first = path.read_bytes()
    site.files[WALK] = first.replace(b":FULLY-SPECIFIED", b":fully-specified")
    path.unlink()
    report = only_walk(site, tmp_path)
    assert "checksum" in report.failed["subjects/02/02_01.amc"]
    assert not path.exists()
    assert not only_walk(site, tmp_path, update=True).failed
    assert path.read_bytes() == site.files[WALK]
    assert only_walk(site, tmp_path).failed == {}
    site.files[WALK] = first
    assert not only_walk(site, tmp_path, update=True).failed
    assert path.read_bytes() == first


def test_a_damaged_file_is_fetched_again(site, tmp_path):
    only_walk(site, tmp_path)
    path = tmp_path / "subjects/02/02_01.amc"
    path.write_bytes(path.read_bytes()[:-50])
    report = only_walk(site, tmp_path)
    assert list(report.fetched) == ["subjects/02/02_01.amc"]
    assert_same(site, tmp_path, ALL_FILES[:2])


def test_files_from_elsewhere_are_kept_and_noted(site, tmp_path):
    path = tmp_path / "subjects/02/02_01.amc"
    path.parent.mkdir(parents=True)
    path.write_bytes(site.files[WALK])
    report = only_walk(site, tmp_path)
    assert report.kept == ["subjects/02/02_01.amc"]
    assert "subjects/02/02_01.amc" in json.loads((tmp_path / LOCK_NAME).read_text())["files"]


def test_offline_is_said_at_once(tmp_path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # bound but not listening: connections are refused
        address = f"http://127.0.0.1:{taken.getsockname()[1]}"
        nowhere = Source(address, patience=Patience(5.0, 5, 0.01))
        with pytest.raises(OfflineError, match="connect to the network"):
            load_index(tmp_path / "a", nowhere)
        assert list((tmp_path / "a").iterdir()) == []
        with pytest.raises(OfflineError, match="connect to the network"):
            fetch([Trial("02", "01")], tmp_path / "a", nowhere)


def test_no_room_is_said_before_and_during(site, tmp_path, monkeypatch):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(10**9, 10**9 - 10**6, 10**6))
    with pytest.raises(DiskFullError, match="1 MB are free"):
        only_walk(site, tmp_path)
    assert site.asked == []
    monkeypatch.setattr(download, "_SPARE", 0)
    big = tmp_path / "x"
    site.files["/x"] = b"x" * 2_000_000
    with pytest.raises(DiskFullError, match="2 MB are needed"):
        Downloader(tmp_path / "p", QUICK)(site.address + "/x", str(big), None)
    assert not big.exists()


def test_the_archive_is_unpacked_inside_its_folder(site, tmp_path):
    site.play(ARCHIVE_PATH, "cut", "stall", "503")
    steps = []
    folder = tmp_path / "deep" / "er"
    report = fetch_all(folder, source(site), progress=lambda *step: steps.append(step))
    assert sorted(report.fetched) == ALL_FILES
    assert there(tmp_path) == [f"deep/er/{name}" for name in ALL_FILES]
    assert_same(site, folder, ALL_FILES)
    assert not (folder / ARCHIVE).exists()
    assert ARCHIVE in json.loads((folder / LOCK_NAME).read_text())["files"]
    assert steps[-1][:2] == (5, 5)
    ranges = site.requests(ARCHIVE_PATH)
    assert ranges[0] is None
    assert all(asked.startswith("bytes=") for asked in ranges[1:])


@pytest.mark.parametrize("damage", ["cut off", "bit"])
def test_a_damaged_archive_is_refused(site, tmp_path, damage):
    data = bytearray(site.files[ARCHIVE_PATH])
    if damage == "bit":
        data[len(data) // 3] ^= 16
    site.files[ARCHIVE_PATH] = bytes(data if damage == "bit" else data[:-100])
    with pytest.raises((MotionError, DownloadError), match=r"damaged|not a whole archive"):
        fetch_all(tmp_path, source(site))


CHILD = """
import sys
from pathlib import Path
from localreg.motion.cmu_index import Trial
from localreg.motion.download import Patience
from localreg.motion.fetch import Source, fetch
fetch([Trial("02", "01")], Path(sys.argv[2]), Source(sys.argv[1], patience=Patience(60.0, 5, 0.01)))
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_killed_download_goes_on_where_it_was(site, tmp_path, how):
    site.play(WALK, "stall")
    command = [sys.executable, "-c", CHILD, site.address, str(tmp_path)]
    child = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    half = len(site.files[WALK]) // 2
    deadline = time.monotonic() + 60.0
    while not any(file.stat().st_size == half for file in tmp_path.glob(".partial/*.part")):
        assert time.monotonic() < deadline
        assert child.poll() is None
        time.sleep(0.02)
    os.kill(child.pid, how)
    child.wait(40.0)  # the server will be silent for longer than that
    assert not (tmp_path / "subjects/02/02_01.amc").exists()
    only_walk(site, tmp_path)
    assert site.requests(WALK)[-1] == f"bytes={half}-"
    assert_same(site, tmp_path, ALL_FILES[:2])


def test_the_index_of_the_page_and_of_a_table_are_the_same(site, tmp_path):
    trials = load_index(tmp_path, source(site))
    assert [(t.name, t.description, t.rate) for t in trials] == [
        (f"{subject}_{number}", *known)
        for subject, numbers in TRIALS.items()
        for number, known in numbers.items()
    ]
    site.asked.clear()
    assert load_index(tmp_path, source(site)) == trials  # from the copy in the folder
    assert site.asked == []
    assert load_index(tmp_path / "other", source(site), index=tmp_path / INDEX_NAME) == trials
    assert site.asked == []
    site.files[PAGE] = b"<html>under construction</html>"
    with pytest.raises(MotionError, match="lists no motions"):
        load_index(tmp_path, source(site), update=True)
    assert load_index(tmp_path, source(site)) == trials


def test_the_index_at_hand_is_understood(motions_dir):
    trials = read_index((motions_dir / INDEX_NAME).read_text())
    assert len(trials) == 2435
    assert len({trial.subject for trial in trials}) == 109
    chosen = choose(trials, ["2", "35-36"], ["walk"])
    assert {trial.subject for trial in chosen} == {"02", "35", "36"}
    assert all("walk" in trial.description for trial in chosen)
    assert [t.name for t in choose(trials, ["02_03"])] == ["02_03"]


@pytest.mark.parametrize(
    ("subjects", "activities", "message"),
    [
        (["9"], [], "no subject 9"),
        (["02_77"], [], "no trial 02_77"),
        (["x"], [], "no subject; write numbers"),
        (["5-1"], [], "no subject; write numbers"),
        (["02"], ["fly"], "described by fly"),
    ],
)
def test_impossible_choices_say_what_is_possible(subjects, activities, message):
    trials = [Trial("02", "01", "walk"), Trial("05", "03", "dance")]
    with pytest.raises(MotionError, match=message):
        choose(trials, subjects, activities)


def test_settings_are_polite():
    with pytest.raises(MotionError, match="1 to 8"):
        Source(connections=100)
    with pytest.raises(MotionError, match="http://"):
        Source("mocap.cs.cmu.edu")


def test_a_foreign_lock_file_is_an_error(site, tmp_path):
    (tmp_path / LOCK_NAME).write_text('{"files": [1]}')
    with pytest.raises(MotionError, match="not a lock file"):
        only_walk(site, tmp_path)
