"""What the workers of a Dask cluster run in tests: the real work, noted, with `Standing`."""

import os
import time
from pathlib import Path

from localreg.database import PoseDatabase
from localreg.evaluation import cluster, worker
from localreg.evaluation.protocol import Protocol, Trial
from localreg.evaluation.results import ClipResult
from tests.localreg.evaluation.standing import Builder

LOG = "LOCALREG_TEST_LOG"
"""Names the folder in which every run is noted."""

_real_work = cluster._run_on_worker


def run_and_note(database: PoseDatabase, trial: Trial, protocol: Protocol) -> list[ClipResult]:
    """Takes its time, so that a worker can be killed at work."""
    begun = Path(os.environ[LOG]) / f"{trial.motion.provenance.name}-{os.getpid()}"
    begun.touch()
    time.sleep(0.3)
    worker.build_estimator = Builder()
    return _real_work(database, trial, protocol)
