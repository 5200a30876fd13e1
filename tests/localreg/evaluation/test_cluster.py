"""A real Dask scheduler with real workers, one of which is killed at work."""

import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from localreg.database import PoseDatabase
from localreg.errors import LocalregError
from localreg.evaluation import cluster, worker
from localreg.evaluation.leave_one_out import evaluate
from localreg.evaluation.protocol import Protocol
from tests.localreg.database.made_motion import make_motion
from tests.localreg.evaluation import cluster_work
from tests.localreg.evaluation.standing import Builder

pytest.importorskip("distributed")
PATIENCE = 120.0


@pytest.fixture
def log(tmp_path: Path) -> Path:
    folder = tmp_path / "log"
    folder.mkdir()
    return folder


@pytest.fixture
def processes(tmp_path: Path, log: Path) -> Iterator[list[subprocess.Popen[bytes]]]:
    """A scheduler and two workers, on ports that the system chose."""
    where = tmp_path / "scheduler.json"
    environment = {
        **os.environ,
        "PYTHONPATH": str(Path(__file__).parents[3]),
        cluster_work.LOG: str(log),
    }

    def start(*arguments: str) -> subprocess.Popen[bytes]:
        with (tmp_path / f"{len(started)}.log").open("wb") as output:
            return subprocess.Popen(
                [sys.executable, "-m", "dask", *arguments, "--no-dashboard"],
                env=environment, cwd=tmp_path, stdout=output, stderr=output,
            )  # fmt: skip

    started: list[subprocess.Popen[bytes]] = []
    file = ["--scheduler-file", str(where)]
    try:
        started.append(start("scheduler", *file, "--host", "127.0.0.1", "--port", "0"))
        for _ in range(2):
            started.append(start("worker", *file, "--nthreads", "1", "--no-nanny"))
        yield started
    finally:
        for process in started:
            process.kill()
            process.wait()


def address_of(folder: Path) -> str:
    """The scheduler's address once both workers are there."""
    from distributed import Client

    deadline = time.monotonic() + PATIENCE
    while not (folder / "scheduler.json").exists():
        assert time.monotonic() < deadline, "the scheduler did not come up"
        time.sleep(0.05)
    with Client(scheduler_file=str(folder / "scheduler.json"), set_as_default=False) as client:
        client.wait_for_workers(2, timeout=PATIENCE)
        return client.scheduler.address


def test_nothing_is_lost_and_nothing_done_twice_when_a_worker_dies(
    processes: list[subprocess.Popen[bytes]],
    tmp_path: Path,
    log: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    motions = [make_motion(i, 40, rate=40.0, name=f"clip{i}") for i in range(16)]
    database = PoseDatabase.build(motions)
    protocol = Protocol(methods=("paper", "ik"), signals=("both",))
    monkeypatch.setattr(worker, "build_estimator", Builder())
    expected = evaluate(motions, database, protocol)
    monkeypatch.setattr(cluster, "_run_on_worker", cluster_work.run_and_note)
    victim, told = processes[2], Counter[str]()

    def kill_one(done: int, total: int, what: str) -> None:
        told[what] += 1
        if len(told) == 4:
            deadline = time.monotonic() + PATIENCE
            while not list(log.glob(f"*-{victim.pid}")):
                assert time.monotonic() < deadline, "the second worker was given nothing"
                time.sleep(0.01)
            victim.kill()

    with cluster.cluster(database, address_of(tmp_path)) as run:
        found = evaluate(motions, database, protocol, run=run, progress=kill_one)
    assert victim.wait() != 0
    assert told == Counter(motion.provenance.name for motion in motions)
    assert [(c.method, c.name) for c in found.clips] == [(c.method, c.name) for c in expected.clips]
    for ours, theirs in zip(found.clips, expected.clips, strict=True):
        assert ours.figures == theirs.figures
        np.testing.assert_array_equal(ours.comparison.mpjpe_cm, theirs.comparison.mpjpe_cm)
    workers = {path.name.rpartition("-")[2] for path in log.iterdir()}
    assert len(workers) == 2, "both workers had work"


def test_nobody_at_the_address_is_said_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "_PATIENCE", "0.5s")
    database = PoseDatabase.build([make_motion(0, 40, rate=40.0)])
    with (
        pytest.raises(LocalregError, match="no Dask scheduler answers at tcp://127"),
        cluster.cluster(database, "tcp://127.0.0.1:9"),
    ):
        pass
