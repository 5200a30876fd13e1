"""What calibration buys: synthesis with subjects that are known more or less well."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from rich.table import Table
from scipy.spatial.transform import Rotation

from benchmarks.calibration_trials import EXACT, TRACKERS, Person, Trial, run_trial
from calibration.anthropometry import GROUP_COUNT, group_of_bone
from calibration.eigen_skeleton import SkeletonPrior, average_subject, lengths_of
from calibration.fit import align, default_mounts
from calibration.knowledge import Knowledge
from calibration.motion_fit import MotionFit
from calibration.motion_mounts import apart
from calibration.poses import EIGHT_POSES
from calibration.refinement import Stretch, refine
from calibration.result import QUANTILE_90, nine_deviations, nine_lengths
from localreg.body.skeleton import BODY_NAMES
from localreg.body.subject import Subject
from localreg.database.store import PoseDatabase
from localreg.evaluation.body_points import BodyPoints
from localreg.evaluation.metrics import SETTLING_FRAMES, joint_angle_errors_deg
from localreg.evaluation.playback import play
from localreg.evaluation.trackers import simulate_trackers
from localreg.motion.motion import Motion
from localreg.motion.sources import read_sources
from localreg.synthesis.methods import build_estimator

_PLAYED: Final = 6
_LONGEST_STRETCH: Final = 10.0
_LAST_BONES: Final = ("head", "foot", "toes", "hand", "fingers", "thumb")
_BETWEEN: Final = [i for i, name in enumerate(BODY_NAMES) if not name.endswith(_LAST_BONES)]
"""Bone ends but those of last bones, whose lengths no tracker can tell from its mount."""


def average_wearer(trial: Trial, prior: SkeletonPrior) -> Subject:
    """What one does without calibration: average lengths, mounts turned as the T-pose shows."""
    average = average_subject(prior)
    mounts = default_mounts(average, TRACKERS)
    target = EIGHT_POSES[0].qpos()[None]
    seen = BodyPoints(replace(average, mounts=mounts)).tracker_poses(target)
    hold = trial.holds[0]
    R, _, _ = align(seen.positions[0], hold.positions, hold.position_mask)
    bones = R * Rotation.from_quat(seen.quaternions[0], scalar_first=True)
    turns = bones.inv() * Rotation.from_quat(hold.quaternions, scalar_first=True)
    return replace(
        average,
        mounts=tuple(
            replace(mount, quaternion=tuple(turn.as_quat(scalar_first=True).tolist()))
            for mount, turn in zip(mounts, turns, strict=True)
        ),
    )


def refined(
    trial: Trial, database: PoseDatabase, clips: Sequence[Motion], seconds: float, seed: int
) -> MotionFit:
    """What ordinary motion adds to the poses, each clip seen without itself in the database."""
    stretches, left = [], seconds
    for number, clip in enumerate(clips):
        if left <= 0.0:
            break
        motion = replace(clip.resampled(database.rate), subject=trial.person)
        motion = motion.first(max(round(min(left, _LONGEST_STRETCH) * motion.rate), 1))
        frames = list(simulate_trackers(motion, seed=1000 + 100 * seed + number))
        stretches.append(Stretch(frames, database.exclude_motion(clip)))
        left -= len(motion) / motion.rate
    result = trial.outcome.result
    return refine(
        result.subject,
        result.knowledge,
        stretches,
        lambda person: build_estimator("localreg", person, database),
        database,
    )


def drawn_at_the_bound(true: Subject, known: Knowledge, rng: Any) -> Subject:
    """The person as an estimate would have them that errs as little as the poses allow.

    What is known of a person's numbers after a fit is, at the true ones, the Cramer-Rao bound.
    """
    J = len(true.mounts)
    off = rng.multivariate_normal(np.zeros(len(known.covariance)), known.covariance)
    lengths, places, turns = np.split(off, [GROUP_COUNT, GROUP_COUNT + 3 * J])
    return replace(
        true,
        lengths=true.lengths * np.exp(lengths)[group_of_bone()],
        mounts=tuple(
            replace(
                mount,
                position=tuple((np.array(mount.position) + place).tolist()),
                quaternion=tuple(
                    (Rotation.from_quat(mount.quaternion, scalar_first=True) * turn)
                    .as_quat(scalar_first=True)
                    .tolist()
                ),
            )
            for mount, place, turn in zip(
                true.mounts,
                places.reshape(J, 3),
                Rotation.from_rotvec(turns.reshape(J, 3)),
                strict=True,
            )
        ),
    )


def wearers(person: Person, trial: Trial, better: Subject) -> dict[str, Subject]:
    """What synthesis may be told of a person, from all to nothing."""
    true, result = trial.person, trial.outcome.result
    calibrated = result.subject
    rng = np.random.default_rng((person.seed, 2))
    return {
        "true": true,
        "eight poses, held exactly": run_trial(person, EXACT).outcome.result.subject,
        "eight poses": calibrated,
        "as near as the eight poses allow": drawn_at_the_bound(true, result.knowledge, rng),
        "true lengths, mounts of the poses": replace(true, mounts=calibrated.mounts),
        "lengths of the poses, true mounts": replace(calibrated, mounts=true.mounts),
        "poses and motion": better,
        "true lengths, mounts of both": replace(true, mounts=better.mounts),
        "lengths of both, true mounts": replace(better, mounts=true.mounts),
        "average": average_wearer(trial, person.prior),
    }


def synthesis_errors(
    trials: Sequence[tuple[Person, Trial]],
    sources: Sequence[str],
    clips: int,
    frames: int,
    seconds: float,
    progress: Callable[[int, int, str], None],
) -> tuple[list[dict[str, Any]], list[MotionFit]]:
    """What motion adds to the poses, and the error of synthesis with the true subject, with what
    was found of it, and with the average one.

    Clips are moved to the simulated person's body; the database is the sample set without the
    clip that plays. Every sixth clip is played and none of those is refined by. A refinement's
    settings were chosen on the first five people and clips that are not played here.
    """
    database = PoseDatabase.build(read_sources(["sample"])[0], mirror=True)
    motions = read_sources(list(sources))[0]
    chosen = sorted(motions[::_PLAYED], key=len)[-clips:]
    others = [m for first in range(2, _PLAYED) for m in motions[first::_PLAYED]]
    rows, fits = [], []
    total = len(trials) * len(chosen)
    for person, trial in trials:
        progress(len(rows), total, f"{person.name}: refining")
        fits.append(refined(trial, database, others, seconds, person.seed))
        told = wearers(person, trial, fits[-1].subject)
        for clip in chosen:
            progress(len(rows), total, clip.provenance.name)
            motion = replace(clip.resampled(database.rate).first(frames), subject=trial.person)
            trackers = simulate_trackers(motion, seed=person.seed)
            allowed = database.exclude_motion(clip)
            truth = BodyPoints(trial.person).bone_ends(motion.qpos)
            row: dict[str, Any] = {"person": person.name, "clip": clip.provenance.name}
            row["subjects"] = {}
            for name, wearer in told.items():
                estimator = build_estimator("localreg", wearer, database, allowed)
                qpos = play(estimator, trackers).qpos
                ends = BodyPoints(wearer).bone_ends(qpos)
                distances = np.linalg.norm(ends - truth, axis=-1)[SETTLING_FRAMES:]
                angles = joint_angle_errors_deg(qpos[:, 7:], motion.angles)[SETTLING_FRAMES:]
                row["subjects"][name] = {
                    "joint_angle_error_deg": float(angles.mean()),
                    "mpjpe_between_trackers_cm": float(100.0 * distances[:, _BETWEEN].mean()),
                    "mpjpe_cm": float(100.0 * distances.mean()),
                }
            rows.append(row)
    progress(total, total, "")
    return rows, fits


def motion_means(
    trials: Sequence[tuple[Person, Trial]], fits: Sequence[MotionFit]
) -> dict[str, dict[str, float]]:
    """Errors of these people after the poses alone, and after poses and motion."""
    before = [(t.outcome.result.subject, t.outcome.result.knowledge) for _, t in trials]
    after = [(fit.subject, fit.knowledge) for fit in fits]
    means = {}
    for name, known in (("eight poses", before), ("poses and motion", after)):
        errors, inside, mounts, turns = [], [], [], []
        for (person, trial), (subject, knowledge) in zip(trials, known, strict=True):
            groups = lengths_of(subject)
            error = nine_lengths(groups) / nine_lengths(person.lengths) - 1.0
            errors.append(np.abs(error))
            deviations = nine_deviations(groups, knowledge.log_lengths)
            inside.append(np.abs(error) <= QUANTILE_90 * deviations)
            for true, found in zip(trial.person.mounts, subject.mounts, strict=True):
                distance, turn = apart(true, found)
                mounts.append(distance)
                turns.append(turn)
        means[name] = {
            "mean_error_percent": float(100.0 * np.mean(errors)),
            "worst_error_percent": float(100.0 * np.max(errors)),
            "coverage_90": float(np.mean(inside)),
            "mount_error_mm": float(1e3 * np.median(mounts)),
            "mount_turn_error_deg": float(np.degrees(np.median(turns))),
        }
    return means


def synthesis_means(rows: Sequence[dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Means over people and clips."""
    first = rows[0]["subjects"]
    return {
        name: {
            figure: float(np.mean([row["subjects"][name][figure] for row in rows]))
            for figure in first[name]
        }
        for name in first
    }


def motion_table(means: dict[str, dict[str, float]], people: int, seconds: float) -> Table:
    title = f"the same lengths, the last {people} people alone, {seconds:.0f} s of motion"
    table = Table(title=title, title_justify="left")
    for name in ("", "mean [%]", "worst [%]", "in 90 % interval", "mounts [mm]", "[deg]"):
        table.add_column(name, justify="right" if name else "left")
    for name, s in means.items():
        table.add_row(
            name,
            f"{s['mean_error_percent']:.2f}",
            f"{s['worst_error_percent']:.1f}",
            f"{100 * s['coverage_90']:.0f} %",
            f"{s['mount_error_mm']:.1f}",
            f"{s['mount_turn_error_deg']:.2f}",
        )
    return table


def synthesis_table(means: dict[str, dict[str, float]]) -> Table:
    table = Table(title="synthesis with these subjects", title_justify="left")
    for name in ("subject", "joint angles [deg]", "to true", "MPJPE between trackers [cm]",
                 "to true", "MPJPE of all bone ends [cm]", "to true"):  # fmt: skip
        table.add_column(name, justify="left" if name == "subject" else "right")
    for name, figures in means.items():
        row = [name]
        for figure, value in figures.items():
            row += [f"{value:.2f}", f"{100 * (value / means['true'][figure] - 1):+.0f} %"]
        table.add_row(*row)
    table.caption = (
        "between trackers: without the ends of head, hands, fingers, thumbs, feet and toes, whose "
        "lengths follow usual proportions; as near as the poses allow: the true person, off by a "
        "draw at the Cramér-Rao bound"
    )
    return table
