"""The protocol of every evaluation: each clip is synthesized without having been seen.

For every clip its copies are masked from the database, its trackers are simulated, and
every method is run over them from the first frame to the last. Clips are shared out over
processes, each of which compiles a method once; the results do not depend on how.
"""

import multiprocessing
import os
import signal
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from localreg.body.subject import Subject
from localreg.database import PoseDatabase
from localreg.errors import LocalregError, SynthesisError
from localreg.evaluation.body_points import BodyPoints
from localreg.evaluation.metrics import compare
from localreg.evaluation.playback import play, warm_up
from localreg.evaluation.protocol import WITHOUT_DATABASE, Protocol, Trial, plan_trials
from localreg.evaluation.results import ClipResult, Evaluation, Settings, program_version
from localreg.evaluation.trackers import SimulatedTrackers, simulate_trackers
from localreg.motion.motion import Motion
from localreg.synthesis.estimator import AnyEstimator
from localreg.synthesis.methods import METHODS, build_estimator

Progress = Callable[[int, int, str], None]
"""Told how many frames are done, of how many, and which clip was last."""


def evaluate(
    motions: Sequence[Motion],
    database: PoseDatabase,
    protocol: Protocol | None = None,
    *,
    folder: Path | None = None,
    jobs: int = 1,
    progress: Progress | None = None,
) -> Evaluation:
    """Evaluate methods on clips.

    Args:
        motions: the test clips, whole and at any rate; unless `protocol.leave_out` is
            None, the database was built from them.
        database: what the methods learn from.
        protocol: the settings.
        folder: where the database is saved, if it is; other processes map it from there.
        jobs: number of processes.
        progress: is told after every clip.

    Raises:
        LocalregError: a method that is not known, nothing to test or to learn from, or a
            process that died.
    """
    protocol = protocol or Protocol()
    unknown = [method for method in protocol.methods if method not in METHODS]
    if unknown:
        raise SynthesisError(
            f"no method named {', '.join(unknown)}; choose among {', '.join(METHODS)}"
        )
    trials, short = plan_trials(motions, database, protocol)
    total = sum(len(trial.motion) for trial in trials) * _runs(protocol)
    done, results = 0, []
    for clip in _run_all(trials, database, protocol, folder, min(jobs, len(trials))):
        results.extend(clip)
        done += sum(result.frames for result in clip)
        if progress is not None:
            progress(done, total, clip[0].name)
    return Evaluation(
        settings=Settings(
            rate_hz=database.rate,
            seed=protocol.seed,
            start=protocol.start,
            noise_position_m=protocol.quality.noise_position,
            noise_orientation_deg=float(np.degrees(protocol.quality.noise_orientation)),
            database=_describe(folder, protocol),
            version=program_version(),
        ),
        clips=tuple(_in_order(results, trials, protocol)),
        too_short=tuple(short),
    )


class Worker:
    """Runs trials one after another and keeps what the next one can use.

    Args:
        database: what the methods learn from.
        protocol: the settings.
    """

    def __init__(self, database: PoseDatabase, protocol: Protocol) -> None:
        self._database = database
        self._protocol = protocol
        self._subject: Subject | None = None
        self._body: BodyPoints | None = None
        self._estimators: dict[str, tuple[AnyEstimator, Trial]] = {}

    def run(self, trial: Trial) -> list[ClipResult]:
        """All methods with all signals on one clip.

        Raises:
            SynthesisError: a method cannot work with these trackers; names the clip.
        """
        protocol, motion = self._protocol, trial.motion
        body = self._body_of(motion.subject)
        start = motion.qpos[0] if protocol.start == "truth" else None
        results = []
        for signals in protocol.signals:
            quality = replace(protocol.quality, signals=signals)
            trackers = simulate_trackers(motion, quality, seed=protocol.seed, body=body)
            for method in protocol.methods:
                try:
                    estimator = self._estimator(method, trial, trackers)
                    playback = play(estimator, trackers, true_start=start)
                except SynthesisError as error:
                    raise SynthesisError(
                        f"{method} on clip {motion.provenance.name}: {error}"
                    ) from error
                results.append(
                    ClipResult(
                        name=motion.provenance.name,
                        frames=len(motion),
                        method=method,
                        signals=signals,
                        comparison=compare(motion, playback.qpos, body=body),
                        step_ms=playback.step_ms,
                    )
                )
        return results

    def _body_of(self, subject: Subject) -> BodyPoints:
        """The subject's body; with another one, estimators have to be built anew."""
        if self._body is None or self._subject is None or not _is_same(self._subject, subject):
            self._subject, self._body = subject, BodyPoints(subject)
            self._estimators = {}
        return self._body

    def _estimator(self, method: str, trial: Trial, trackers: SimulatedTrackers) -> AnyEstimator:
        """The method with the trial's clips masked from its database."""
        known = self._estimators.get(method)
        if known is not None and (known[1] is trial or method in WITHOUT_DATABASE):
            return known[0]
        allowed = None if method in WITHOUT_DATABASE else trial.allowed(self._database)
        if known is not None and allowed is not None:
            estimator = known[0].leave_out(allowed)
        else:
            estimator = build_estimator(method, trial.motion.subject, self._database, allowed)
            warm_up(estimator, trackers)
        self._estimators[method] = (estimator, trial)
        return estimator


def _run_all(
    trials: Sequence[Trial],
    database: PoseDatabase,
    protocol: Protocol,
    folder: Path | None,
    jobs: int,
) -> Iterator[list[ClipResult]]:
    """The results of every trial, in the order in which they are done."""
    trials = _grouped(trials)
    if jobs <= 1:
        worker = Worker(database, protocol)
        yield from map(worker.run, trials)
        return
    with tempfile.TemporaryDirectory(prefix="localreg-") as temporary:
        if folder is None:
            folder = Path(temporary) / "database"
            database.save(folder)
        with _pool(jobs, folder, protocol) as pool:
            futures = [pool.submit(_run_in_process, trial) for trial in trials]
            yield from _results(futures)


@contextmanager
def _pool(jobs: int, folder: Path, protocol: Protocol) -> Iterator[ProcessPoolExecutor]:
    """Processes that are gone at the end, whatever happens meanwhile."""
    others = set(multiprocessing.active_children())
    # Forked processes would inherit XLA's threads without the threads.
    pool = ProcessPoolExecutor(
        jobs, multiprocessing.get_context("spawn"), _begin_process, (folder, protocol)
    )
    try:
        yield pool
        pool.shutdown()
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in set(multiprocessing.active_children()) - others:
            process.terminate()
        raise


def _results(futures: Iterable[Future[list[ClipResult]]]) -> Iterator[list[ClipResult]]:
    try:
        for future in as_completed(futures):
            yield future.result()
    except BrokenProcessPool as error:
        raise LocalregError(
            "a process of the evaluation died, probably for want of memory; give fewer --jobs"
        ) from error


_WORKERS: Final[list[Worker]] = []


def _begin_process(folder: Path, protocol: Protocol) -> None:
    # Ctrl-C is the parent's to handle, which ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _WORKERS[:] = [Worker(PoseDatabase.load(folder, verify=False), protocol)]


def _run_in_process(trial: Trial) -> list[ClipResult]:
    return _WORKERS[0].run(trial)


def _grouped(trials: Sequence[Trial]) -> list[Trial]:
    """People together, because each needs estimators of its own; the longest clips first."""
    people: list[tuple[Subject, list[Trial]]] = []
    for trial in trials:
        subject = trial.motion.subject
        for known, group in people:
            if _is_same(known, subject):
                group.append(trial)
                break
        else:
            people.append((subject, [trial]))
    return [
        trial
        for _, group in people
        for trial in sorted(group, key=lambda trial: len(trial.motion), reverse=True)
    ]


def _in_order(
    results: Sequence[ClipResult], trials: Sequence[Trial], protocol: Protocol
) -> list[ClipResult]:
    place = {trial.motion.provenance.name: index for index, trial in enumerate(trials)}
    return sorted(
        results,
        key=lambda result: (
            protocol.methods.index(result.method),
            protocol.signals.index(result.signals),
            place[result.name],
        ),
    )


def _is_same(one: Subject, other: Subject) -> bool:
    return one is other or (one.mounts == other.mounts and one.same_proportions(other))


def _runs(protocol: Protocol) -> int:
    return len(protocol.methods) * len(protocol.signals)


def _describe(folder: Path | None, protocol: Protocol) -> str:
    if protocol.leave_out is None and folder is not None:
        return str(folder)
    return f"leave-out {protocol.leave_out or 'copies'}"


def default_jobs() -> int:
    """One process for every core that this process may use."""
    return len(os.sched_getaffinity(0))
