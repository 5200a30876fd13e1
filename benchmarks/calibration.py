"""How well calibration finds simulated people, and what that buys.

    python -m benchmarks.calibration --people 50 --skeletons DIR --json calibration.json

Every person has the lengths of a real ASF file that the eigen-skeleton has not seen, trackers
strapped on anyhow, tracker noise of 3 mm and 0.5 deg, and holds every pose with errors in all
joints. Beside the errors stands the Cramer-Rao bound (with beliefs: van Trees): what an estimate
that reaches it would show, on the mean and at worst, among as many people. Without ASF files
people are drawn from the published table.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import typer
from jaxtyping import Float
from numpy import ndarray
from rich.table import Table
from scipy.spatial.transform import Rotation

from calibration.anthropometry import NINE_BONES
from calibration.calibrate import Outcome, calibrate
from calibration.eigen_skeleton import (
    SkeletonPrior,
    average_subject,
    find_skeletons,
    learn,
    lengths_of,
    published_prior,
    stature,
)
from calibration.fit import FitSettings, align, default_mounts
from calibration.holds import Hold
from calibration.motion_fit import MotionFit
from calibration.motion_mounts import apart
from calibration.observability import expected_deviations, information
from calibration.poses import EIGHT_POSES, NAIVE_POSES, TargetPose, with_swapped
from calibration.refinement import Stretch, refine
from calibration.result import QUANTILE_90, REPORTED, nine_deviations, nine_lengths
from calibration.setup import true_lengths
from calibration.simulated import Habits, held, perform, random_person
from localreg.body.skeleton import BODY_NAMES
from localreg.body.subject import Subject, canonical_subject
from localreg.commands.console import notes, output, progress_bar
from localreg.database.store import PoseDatabase
from localreg.evaluation.body_points import BodyPoints
from localreg.evaluation.metrics import SETTLING_FRAMES, joint_angle_errors_deg
from localreg.evaluation.playback import play
from localreg.evaluation.results import without_nan, write_json
from localreg.evaluation.trackers import simulate_trackers
from localreg.motion.motion import Motion
from localreg.motion.sources import read_sources
from localreg.synthesis.methods import build_estimator

PUBLISHED: Final = {"mean_percent": 1.4, "worst_percent": 5.2, "head": 4.2, "radius": 5.2}
"""Two people against an optical system, nine bones each."""

TRACKERS: Final = canonical_subject().mounts
_MEAN_ABSOLUTE: Final = float(np.sqrt(2.0 / np.pi))
_DRAWS: Final = 1000
_PLAYED: Final = 6
_LONGEST_STRETCH: Final = 10.0
_LAST_BONES: Final = ("head", "foot", "toes", "hand", "fingers", "thumb")
_BETWEEN: Final = [i for i, name in enumerate(BODY_NAMES) if not name.endswith(_LAST_BONES)]
"""Bone ends but those of last bones, whose lengths no tracker can tell from its mount."""

_PER_JOINT: Final = float(np.radians(5.0 / np.sqrt(3.0)))
_PER_AXIS: Final = float(np.radians(5.0))


@dataclass(frozen=True, eq=False)
class Person:
    """Someone to calibrate.

    Attributes:
        name: the file that the lengths are from.
        lengths: true lengths [m].
        prior: the eigen-skeleton without that file.
        seed: of mounts, errors and noise.
    """

    name: str
    lengths: Float[ndarray, "18"]
    prior: SkeletonPrior
    seed: int


@dataclass(frozen=True, eq=False)
class Condition:
    """A way of calibrating.

    Attributes:
        name: for the table.
        habits: how well the person holds poses.
        poses: that are asked for.
        performed: that are done; the same but where one goes wrong.
        knows_height: whether the person's height is known to 1.5 cm.
    """

    name: str
    habits: Habits
    poses: Sequence[TargetPose] = EIGHT_POSES
    performed: Sequence[TargetPose] | None = None
    knows_height: bool = False


def conditions() -> list[Condition]:
    """All that are compared."""
    wrong = list(EIGHT_POSES)
    wrong[1] = replace(wrong[1], other_angles=with_swapped(wrong[1].angles, "arms"))
    usual = Habits(pose_error=_PER_JOINT)
    return [
        Condition("perfect poses", Habits(pose_error=1e-4, plant_error=3e-5)),
        Condition("5 deg a joint", usual),
        Condition("5 deg a joint, height known", usual, knows_height=True),
        Condition("arms swapped in one pose", usual, performed=wrong),
        Condition("5 deg about each axis", Habits(pose_error=_PER_AXIS)),
        Condition("naive poses", usual, poses=NAIVE_POSES),
        Condition("T-pose alone", usual, poses=EIGHT_POSES[:1]),
    ]


def draw_people(count: int, skeletons: Path | None) -> list[Person]:
    """People whose files the eigen-skeleton has not seen; files that are odd are no people."""
    if skeletons is None:
        prior = published_prior()
        rng = np.random.default_rng(0)
        drawn = rng.multivariate_normal(prior.mean, prior.covariance, count)
        return [Person("drawn", np.exp(row), prior, seed) for seed, row in enumerate(drawn)]
    found = find_skeletons(skeletons)
    names = [name for name in found if name not in learn(found).odd]
    priors = {
        name: learn({other: row for other, row in found.items() if other != name})
        for name in names[:count]
    }
    return [
        Person(name, found[name], priors[name], seed)
        for seed in range(count)
        for name in [names[seed % len(names)]]
    ]


@dataclass(frozen=True, eq=False)
class Trial:
    """One person under one condition.

    Attributes:
        error: relative error of each of the nine lengths.
        deviation: as reported.
        mount_error: distance of each mount from the truth [m].
        turn_error: the same of its turn [rad].
        outcome: all of it.
        person: with the true mounts.
        holds: what was recorded.
        seconds: that the fit took.
    """

    error: Float[ndarray, "9"]
    deviation: Float[ndarray, "9"]
    mount_error: Float[ndarray, " J"]
    turn_error: Float[ndarray, " J"]
    outcome: Outcome
    person: Subject
    holds: tuple[Hold, ...]
    seconds: float


def run_trial(person: Person, condition: Condition) -> Trial:
    """Strap on trackers, hold the poses, calibrate, compare."""
    rng = np.random.default_rng((person.seed, 1))
    habits = condition.habits
    body = random_person(person.lengths, TRACKERS, habits.mount_spread, rng)
    qpos = perform(body, condition.performed or condition.poses, habits, rng)
    holds = held(body, condition.poses, qpos, habits, rng)
    prior = person.prior
    if condition.knows_height:
        prior = prior.at_stature(stature(person.lengths) + rng.normal(0.0, 0.015))
    begin = time.perf_counter()
    outcome = calibrate(holds, TRACKERS, prior, poses=condition.poses)
    seconds = time.perf_counter() - begin
    result = outcome.result
    error = nine_lengths(result.groups) / nine_lengths(person.lengths) - 1.0
    pairs = zip(body.mounts, result.subject.mounts, strict=True)
    mounts, turns = np.array([apart(true, found) for true, found in pairs]).T
    return Trial(
        error,
        nine_deviations(result.groups, result.log_covariance),
        mounts,
        turns,
        outcome,
        body,
        tuple(holds),
        seconds,
    )


def bound(person: Person, condition: Condition) -> Float[ndarray, "9"]:
    """The least standard deviations that anybody could reach."""
    habits = condition.habits
    settings = FitSettings(
        mount_sigma=habits.mount_spread,
        pose_sigma=habits.pose_error,
        plant_sigma=habits.plant_error,
    )
    prior = person.prior
    if condition.knows_height:
        prior = prior.at_stature(stature(person.lengths))
    told, believed = information(
        condition.poses,
        prior,
        settings=settings,
        position_sd=habits.noise_position / np.sqrt(habits.frames),
        orientation_sd=habits.noise_orientation / np.sqrt(habits.frames),
    )
    return expected_deviations(believed + told.sum(axis=0), prior)


def summarize(
    condition: Condition, trials: Sequence[Trial], bounds: Float[ndarray, "n 9"]
) -> dict[str, Any]:
    """The figures of a condition."""
    errors = np.array([trial.error for trial in trials])
    deviations = np.array([trial.deviation for trial in trials])
    absolute = 100.0 * np.abs(errors)
    within = np.abs(errors) <= QUANTILE_90 * deviations
    least = 100.0 * np.sqrt(np.mean(bounds**2, axis=0))
    rms = 100.0 * np.sqrt(np.mean(errors**2, axis=0))
    named = sum(bool(trial.outcome.findings) for trial in trials)
    worst = _worst_at_the_bound(bounds)
    return {
        "condition": condition.name,
        "people": len(trials),
        "mean_error_percent": float(absolute.mean()),
        "worst_error_percent": float(absolute.max()),
        "bound_mean_error_percent": float(_MEAN_ABSOLUTE * least.mean()),
        "bound_worst_error_percent": float(np.median(worst.max(axis=1))),
        "bound_worst_error_90_percent": float(np.quantile(worst.max(axis=1), 0.9)),
        "rms_over_bound": float(np.sqrt(np.mean(rms**2) / np.mean(least**2))),
        "coverage_90": float(within.mean()),
        "mount_error_mm": float(1e3 * np.median([t.mount_error for t in trials])),
        "mount_turn_error_deg": float(np.degrees(np.median([t.turn_error for t in trials]))),
        "observable": _observable_errors(trials),
        "named_something_amiss": named,
        "seconds_median": float(np.median([trial.seconds for trial in trials])),
        "bones": {
            bone: {
                "mean_error_percent": float(absolute[:, i].mean()),
                "worst_error_percent": float(absolute[:, i].max()),
                "bound_mean_error_percent": float(_MEAN_ABSOLUTE * least[i]),
                "bound_worst_error_percent": float(np.median(worst[:, i])),
                "rms_error_percent": float(rms[i]),
                "bound_rms_error_percent": float(least[i]),
                "rms_over_bound": float(rms[i] / least[i]),
                "coverage_90": float(within[:, i].mean()),
            }
            for i, bone in enumerate(NINE_BONES)
        },
    }


def _worst_at_the_bound(bounds: Float[ndarray, "n 9"]) -> Float[ndarray, "draws 9"]:
    """Worst errors of each bone among so many people whose errors have the bound's spread [%]."""
    rng = np.random.default_rng(0)
    drawn = rng.normal(0.0, 1.0, (_DRAWS, *bounds.shape))
    return 100.0 * np.abs(drawn * bounds).max(axis=1)


def _observable_errors(trials: Sequence[Trial]) -> dict[str, Any]:
    """The worst of what reports call observable, and which lengths all of them call so."""
    lengths, places, always = [0.0], [0.0], set(REPORTED)
    for trial in trials:
        result, truth = trial.outcome.result, true_lengths(trial.person)
        told = {length.name: length.value for length in result.lengths if length.is_observable}
        always &= set(told)
        lengths += [abs(value / truth[name] - 1.0) for name, value in told.items()]
        for found, true, estimate in zip(
            result.subject.mounts, trial.person.mounts, result.mounts, strict=True
        ):
            away = np.abs(np.array(found.position) - np.array(true.position))
            places += away[np.array(estimate.is_observable)].tolist()
    return {
        "lengths": [name for name in REPORTED if name in always],
        "worst_length_percent": float(100.0 * max(lengths)),
        "worst_mount_mm": float(1e3 * max(places)),
        "worst_turn_deg": float(np.degrees(max(trial.turn_error.max() for trial in trials))),
    }


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


def wearers(person: Person, trial: Trial, better: Subject) -> dict[str, Subject]:
    """What synthesis may be told of a person, from all to nothing."""
    true, calibrated = trial.person, trial.outcome.result.subject
    return {
        "true": true,
        "eight poses": calibrated,
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


def main(
    people: Annotated[int, typer.Option(min=1, help="Simulated people a condition.")] = 10,
    skeletons: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder with ASF files.")
    ] = None,
    only: Annotated[list[str] | None, typer.Option(help="Only this condition; may repeat.")] = None,
    synthesis: Annotated[
        int, typer.Option(min=0, help="People to synthesize with, the last of them.")
    ] = 2,
    motion: Annotated[
        list[str] | None,
        typer.Option(metavar="SOURCE", help="Clips to synthesize; default: the sample set."),
    ] = None,
    clips: Annotated[int, typer.Option(min=1, help="Longest clips of it for each.")] = 2,
    frames: Annotated[int, typer.Option(min=20, help="Frames of each clip.")] = 200,
    seconds: Annotated[float, typer.Option(min=5.0, help="Motion to refine by [s].")] = 60.0,
    json: Annotated[Path | None, typer.Option(help="Also write the figures here.")] = None,
) -> None:
    """Calibrate simulated people and show the table."""
    drawn = draw_people(people, skeletons)
    chosen = [c for c in conditions() if not only or c.name in only]
    if not chosen:
        raise typer.BadParameter(f"conditions are {', '.join(c.name for c in conditions())}")
    summaries, usual = [], []
    with progress_bar("calibrating") as bar:
        for place, condition in enumerate(chosen):
            trials, bounds = [], []
            known: dict[int, Float[ndarray, 9]] = {}
            for number, person in enumerate(drawn):
                bar(place * people + number, len(chosen) * people, condition.name)
                trials.append(run_trial(person, condition))
                if id(person.prior) not in known:
                    known[id(person.prior)] = bound(person, condition)
                bounds.append(known[id(person.prior)])
            summaries.append(summarize(condition, trials, np.array(bounds)))
            if condition.name == "5 deg a joint":
                usual = list(zip(drawn, trials, strict=True))
    shown = output()
    shown.print(_conditions_table(summaries, people, skeletons is not None))
    shown.print(_observable_table(summaries))
    for summary in summaries:
        if summary["condition"] == "5 deg a joint":
            shown.print(_bones_table(summary))
    document: dict[str, Any] = {"schema": 1, "people": people, "conditions": summaries,
                                "published": PUBLISHED}  # fmt: skip
    if synthesis and usual:
        with progress_bar("synthesizing") as bar:
            movers = usual[-synthesis:]
            rows, fits = synthesis_errors(movers, motion or ["sample"], clips, frames, seconds, bar)
        moved = motion_means(movers, fits)
        document["motion"] = {"people": len(movers), "seconds": seconds, "mean": moved}
        document["synthesis"] = {"clips": rows, "mean": synthesis_means(rows)}
        shown.print(_motion_table(moved, len(movers), seconds))
        shown.print(_synthesis_table(synthesis_means(rows)))
    if json is not None:
        write_json(without_nan(document), json)
        notes().print(f"figures: {json}")


def _conditions_table(summaries: Sequence[dict[str, Any]], people: int, real: bool) -> Table:
    source = "held-out ASF files" if real else "the published table"
    table = Table(title=f"nine lengths of {people} people from {source}", title_justify="left")
    for name in ("", "mean [%]", "bound [%]", "worst [%]", "bound's worst [%]", "rms / bound",
                 "in 90 % interval", "mounts [mm]", "[deg]", "fit [s]"):  # fmt: skip
        table.add_column(name, justify="right" if name else "left")
    for s in summaries:
        table.add_row(
            s["condition"],
            f"{s['mean_error_percent']:.2f}",
            f"{s['bound_mean_error_percent']:.2f}",
            f"{s['worst_error_percent']:.1f}",
            f"{s['bound_worst_error_percent']:.1f} ({s['bound_worst_error_90_percent']:.1f})",
            f"{s['rms_over_bound']:.2f}",
            f"{100 * s['coverage_90']:.0f} %",
            f"{s['mount_error_mm']:.1f}",
            f"{s['mount_turn_error_deg']:.2f}",
            f"{s['seconds_median']:.1f}",
        )
    table.caption = (
        "bound: the mean error of an estimate that reaches the Cramér-Rao bound; its worst: the "
        "worst of as many such errors, median (and 90 % quantile)"
    )
    table.add_row("published, 2 people", "1.40", "", "5.2", "", "", "", "", "", "")
    return table


def _observable_table(summaries: Sequence[dict[str, Any]]) -> Table:
    title = "the worst of what reports call observable"
    table = Table(title=title, title_justify="left")
    for name in ("", "length [%]", "mount, along an axis [mm]", "mount's turn [deg]"):
        table.add_column(name, justify="right" if name else "left")
    table.add_column("lengths that every report calls observable")
    for summary in summaries:
        worst = summary["observable"]
        table.add_row(
            summary["condition"],
            f"{worst['worst_length_percent']:.2f}",
            f"{worst['worst_mount_mm']:.2f}",
            f"{worst['worst_turn_deg']:.2f}",
            ", ".join(worst["lengths"]),
        )
    return table


def _bones_table(summary: dict[str, Any]) -> Table:
    table = Table(title=f"bone by bone, {summary['condition']} [%]", title_justify="left")
    table.add_column("")
    for bone in summary["bones"]:
        table.add_column(bone, justify="right")
    for label, figure, scale, form in (
        ("mean error", "mean_error_percent", 1.0, "{:.2f}"),
        ("the bound's", "bound_mean_error_percent", 1.0, "{:.2f}"),
        ("rms error", "rms_error_percent", 1.0, "{:.2f}"),
        ("the bound's", "bound_rms_error_percent", 1.0, "{:.2f}"),
        ("rms / bound", "rms_over_bound", 1.0, "{:.2f}"),
        ("worst error", "worst_error_percent", 1.0, "{:.1f}"),
        ("the bound's", "bound_worst_error_percent", 1.0, "{:.1f}"),
        ("in 90 % interval", "coverage_90", 100.0, "{:.0f}"),
    ):
        row = [form.format(scale * bone[figure]) for bone in summary["bones"].values()]
        table.add_row(label, *row)
    return table


def _motion_table(means: dict[str, dict[str, float]], people: int, seconds: float) -> Table:
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


def _synthesis_table(means: dict[str, dict[str, float]]) -> Table:
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
        "lengths follow usual proportions"
    )
    return table


if __name__ == "__main__":
    typer.run(main)
