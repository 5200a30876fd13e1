"""The protocol of every evaluation: each clip is synthesized without having been seen.

For every clip its copies are masked from the database, its trackers are simulated, and
every method is run over them from the first frame to the last. Clips are shared out over
processes (`execution`) or machines (`cluster`); the results do not depend on how.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from localreg.body.subject import Subject
from localreg.database import PoseDatabase
from localreg.evaluation.execution import Run, processes
from localreg.evaluation.protocol import Protocol, Trial, plan_trials
from localreg.evaluation.results import ClipResult, Evaluation, Settings, program_version
from localreg.evaluation.worker import is_same
from localreg.motion.motion import Motion

Progress = Callable[[int, int, str], None]
"""Told how many frames are done, of how many, and which clip was last."""


def evaluate(
    motions: Sequence[Motion],
    database: PoseDatabase,
    protocol: Protocol | None = None,
    *,
    folder: Path | None = None,
    jobs: int = 1,
    run: Run | None = None,
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
        run: where to run trials instead, over the same database; for several evaluations.
        progress: is told after every clip.

    Raises:
        LocalregError: nothing to test or to learn from, or a process that died.
    """
    protocol = protocol or Protocol()
    trials, short = plan_trials(motions, database, protocol)
    total = sum(len(trial.motion) for trial in trials) * _runs(protocol)
    done, results = 0, []
    with _somewhere(run, database, min(jobs, len(trials)), folder) as somewhere:
        for clip in somewhere(_grouped(trials), protocol):
            results.extend(clip)
            done += sum(result.frames for result in clip)
            if progress is not None:
                progress(done, total, clip[0].name)
    return Evaluation(
        settings=settings_of(protocol, database, folder),
        clips=tuple(_in_order(results, trials, protocol)),
        too_short=tuple(short),
        conditions=_conditions(protocol),
    )


def settings_of(protocol: Protocol, database: PoseDatabase, folder: Path | None = None) -> Settings:
    """What figures depend on, as the contract names it; arguments as for `evaluate`."""
    return Settings(
        rate_hz=database.rate,
        seed=protocol.seed,
        start=protocol.start,
        noise_position_m=protocol.quality.noise_position,
        noise_orientation_deg=float(np.degrees(protocol.quality.noise_orientation)),
        database=_describe(folder, protocol),
        version=program_version(),
    )


@contextmanager
def _somewhere(
    run: Run | None, database: PoseDatabase, jobs: int, folder: Path | None
) -> Iterator[Run]:
    if run is not None:
        yield run
    else:
        with processes(database, jobs, folder) as own:
            yield own


def _grouped(trials: Sequence[Trial]) -> list[Trial]:
    """People together, because each needs estimators of its own; the longest clips first."""
    people: list[tuple[Subject, list[Trial]]] = []
    for trial in trials:
        subject = trial.motion.subject
        for known, group in people:
            if is_same(known, subject):
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


def _runs(protocol: Protocol) -> int:
    return len(protocol.methods) * len(protocol.signals)


def _describe(folder: Path | None, protocol: Protocol) -> str:
    if protocol.leave_out is None and folder is not None:
        return str(folder)
    return f"leave-out {protocol.leave_out or 'copies'}"


def _conditions(protocol: Protocol) -> dict[str, Any]:
    """What the contract's settings do not say, in the units of the command line."""
    quality = asdict(protocol.quality)
    for name in ("outlier_orientation", "slip_orientation"):
        quality[f"{name}_deg"] = float(np.degrees(quality.pop(name)))
    for name in ("signals", "noise_position", "noise_orientation"):
        del quality[name]
    quality["losses"] = [loss._asdict() for loss in protocol.quality.losses]
    return {
        "leave_out": protocol.leave_out,
        "trackers": protocol.trackers,
        "max_frames": protocol.max_frames,
        "database_share": protocol.database_share,
        **quality,
    }
