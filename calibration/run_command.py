"""What `localreg calibrate run`, `height` and `poses` do."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from calibration.anthropometry import NINE_BONES, length_of
from calibration.calibrate import Outcome, calibrate
from calibration.eigen_skeleton import (
    SkeletonPrior,
    bone_lengths,
    find_skeletons,
    learn,
    published_prior,
    subject_of,
)
from calibration.knowledge import known_file, write_knowledge
from calibration.live import Hooks, lead, make_judge
from calibration.observability import expected_deviations, information
from calibration.pictures import draw_poses
from calibration.poses import EIGHT_POSES, NAIVE_POSES, TargetPose, mirrored, with_swapped
from calibration.progress import read_progress, write_progress
from calibration.report import (
    findings_lines,
    lengths_table,
    mounts_table,
    poses_table,
    summary_lines,
)
from calibration.result import QUANTILE_90, relative_deviation
from calibration.setup import Source, configured, simulated
from calibration.simulated import Habits
from calibration.terminal import TerminalView
from calibration.wizard import Wizard, WizardSettings, check_names
from localreg.body.subject import CalibrationRecord, Subject, read_subject, write_subject
from localreg.commands.console import notes, output
from localreg.errors import LocalregError

_ROUNDS: Final = 2
"""How often the person is asked to repeat what the fit found wrong."""


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Options of the command; see `localreg calibrate run --help`."""

    out: Path
    config: str | None = None
    simulate: str | None = None
    quick: bool = False
    height: float | None = None
    skeletons: Path | None = None
    template: Path | None = None
    name: str = "me"
    only: tuple[str, ...] = ()
    progress: Path | None = None
    fresh: bool = False
    hold: float = 2.0
    pose_error: float = 5.0
    mistakes: tuple[str, ...] = ()
    seed: int = 0
    yes: bool = False


def people(skeletons: Path | None, height: float | None = None) -> SkeletonPrior:
    """What lengths are likely: of the table, of files, at a height."""
    prior = published_prior() if skeletons is None else learn(find_skeletons(skeletons))
    return prior if height is None else prior.at_stature(height)


def run(options: RunOptions) -> None:
    """Lead, fit, ask for repetitions, write.

    Raises:
        LocalregError: options that make no sense, a device that does not work, or no result.
    """
    if (options.config is None) == (options.simulate is None):
        raise LocalregError("give either --config NAME|FILE or --simulate MOTION")
    poses = EIGHT_POSES[:1] if options.quick else EIGHT_POSES
    check_names(options.only, poses)
    prior = people(options.skeletons, options.height)
    file = options.progress or options.out.with_suffix(".progress.json")
    if options.fresh:
        file.unlink(missing_ok=True)
    console = notes()
    with _source(options) as source:
        trackers = tuple(mount.tracker for mount in source.mounts)
        holds = read_progress(file, trackers)
        holds = {name: hold for name, hold in holds.items() if name in {p.name for p in poses}}
        if holds and not options.only:
            console.print(f"going on after {len(holds)} poses recorded before ({file})")
        for name in options.only:
            holds.pop(name, None)
        wizard = Wizard(
            poses,
            trackers,
            judge=make_judge(EIGHT_POSES, source.mounts, prior),
            settings=WizardSettings(hold=options.hold),
            holds=holds,
        )
        outcome = _led(wizard, source, prior, options, file, console)
        truth = source.truth
    _report(outcome, truth, options)
    leave_progress(file, wizard, outcome.repeat)


def leave_progress(file: Path, wizard: Wizard, repeat: Sequence[str]) -> None:
    """Keep what was good if poses are to be repeated, so that only they are asked for again."""
    good = tuple(hold for hold in wizard.holds if hold.pose not in repeat)
    if repeat and good:
        write_progress(file, good, wizard.trackers)
    else:
        file.unlink(missing_ok=True)


def _source(options: RunOptions) -> AbstractContextManager[Source]:
    template = None if options.template is None else read_subject(options.template)
    if options.config is not None:
        return configured(options.config, template)
    # An error of a joint is spread over the axes that it may be about.
    habits = Habits(pose_error=float(np.radians(options.pose_error / np.sqrt(3.0))))
    return simulated(
        str(options.simulate),
        EIGHT_POSES,
        seed=options.seed,
        habits=habits,
        mistakes=dict(_mistake(text) for text in options.mistakes),
    )


def _mistake(text: str) -> tuple[str, TargetPose]:
    """A pose and what is taken for it, from `POSE=POSE`."""
    name, _, other = text.partition("=")
    by_name = {pose.name: pose for pose in EIGHT_POSES}
    if name not in by_name or not (other in by_name or other in ("arms", "legs", "mirror")):
        raise LocalregError(
            f"{text!r} is no mistake; give POSE=POSE with one of {', '.join(by_name)}, or "
            "POSE=arms, POSE=legs, POSE=mirror"
        )
    if other in by_name:
        return name, by_name[other]
    pose = by_name[name]
    angles = mirrored(pose.angles) if other == "mirror" else with_swapped(pose.angles, other)
    return name, replace(pose, other_angles=angles)


def _led(
    wizard: Wizard,
    source: Source,
    prior: SkeletonPrior,
    options: RunOptions,
    file: Path,
    console: Console,
) -> Outcome:
    hooks = Hooks() if source.performer is None else Hooks(asked=source.performer.ask)
    method = "T-pose" if options.quick else "eight poses"
    view = TerminalView(console)
    if options.yes or not view.has_keys:
        wizard.go()
    for round_number in range(_ROUNDS + 1):
        with view:
            holds = lead(wizard, source.trackers.stream, view, progress=file, hooks=hooks)
        with console.status("fitting (compiling; half a minute the first time)"):
            outcome = calibrate(
                holds, source.mounts, prior, poses=wizard.poses, name=options.name, method=method
            )
        again = [name for name in outcome.repeat if name in {p.name for p in wizard.poses}]
        if not again or round_number == _ROUNDS or options.quick:
            return outcome
        for line in findings_lines(outcome.findings):
            console.print(line, soft_wrap=True)
        if source.performer is not None:
            for name in again:
                source.performer.ask(name, True)
        wizard.repeat(again)
    raise AssertionError("unreachable")


def _report(outcome: Outcome, truth: dict[str, float] | None, options: RunOptions) -> None:
    console = notes()
    for line in findings_lines(outcome.findings):
        console.print(line, soft_wrap=True)
    result = outcome.calibration
    if result is None:
        raise LocalregError(
            "there is no result; mend what is said above and begin again, with --fresh"
        )
    write_subject(result.subject, options.out)
    write_knowledge(result.knowledge, result.subject, known_file(options.out))
    shown = output()
    shown.print(lengths_table(result, truth))
    shown.print(mounts_table(result))
    for line in summary_lines(result):
        shown.print(line, soft_wrap=True)
    shown.print(f"subject: {options.out}", soft_wrap=True)
    shown.print(
        f"a minute of ordinary motion makes it better: localreg calibrate refine {options.out}",
        soft_wrap=True,
    )
    if outcome.repeat:
        names = ", ".join(outcome.repeat)
        shown.print(
            f"better still: the same command without --fresh asks for {names} again", soft_wrap=True
        )


def height_only(metres: float, out: Path, skeletons: Path | None, name: str) -> None:
    """The likeliest person of a height, with honest deviations.

    Raises:
        LocalregError: nobody is so high, or the file cannot be written.
    """
    prior = people(skeletons, metres)
    subject = guessed_subject(prior, name)
    write_subject(subject, out)
    table = Table(title=f"guessed from a height of {metres:.2f} m", title_justify="left")
    table.add_column("")
    table.add_column("[cm]", justify="right")
    table.add_column("90 % within [cm]", justify="right")
    for label, parts in NINE_BONES.items():
        value = length_of(parts, prior.lengths)
        half = QUANTILE_90 * value * relative_deviation(parts, prior.lengths, prior.covariance)
        table.add_row(label, f"{100 * value:.1f}", f"{100 * half:.1f}")
    shown = output()
    shown.print(table)
    shown.print("tracker mounts are the default ones; eight poses would find them")
    shown.print(f"subject: {out}", soft_wrap=True)


def guessed_subject(prior: SkeletonPrior, name: str) -> Subject:
    """The average person of a prior, with its deviations on record."""
    deviations = prior.lengths * np.sqrt(np.diag(prior.covariance))
    record = CalibrationRecord(
        date=datetime.now(UTC).isoformat(timespec="seconds"),
        method="height",
        lengths_from=prior.sources,
        length_sd=bone_lengths(deviations),
    )
    return replace(subject_of(name, prior.lengths), calibration=record)


def show_poses(png: Path | None, with_information: bool, skeletons: Path | None) -> None:
    """The poses in words, as pictures, or as information.

    Raises:
        LocalregError: a picture cannot be written.
    """
    shown = output()
    shown.print(poses_table(EIGHT_POSES))
    if png is not None:
        with notes().status("drawing"):
            files, note = draw_poses(EIGHT_POSES, png)
        for file in files:
            shown.print(str(file), soft_wrap=True)
        if note:
            typer.echo(note, err=True)
    if with_information:
        with notes().status("linearizing"):
            table = information_table(people(skeletons))
        shown.print(table)


def information_table(prior: SkeletonPrior) -> Table:
    """Expected deviations of the nine lengths: beforehand, after each pose, and naively."""
    told, believed = information(EIGHT_POSES, prior)
    naive, _ = information(NAIVE_POSES, prior)
    table = Table(title="expected standard deviations [%]", title_justify="left")
    table.add_column("after")
    for bone in NINE_BONES:
        table.add_column(bone, justify="right")
    table.add_column("mean", justify="right")

    def add(name: str, matrix: np.ndarray) -> None:
        values = 100.0 * expected_deviations(matrix, prior)
        table.add_row(name, *(f"{value:.1f}" for value in values), f"{values.mean():.1f}")

    add("nothing", believed)
    known = believed.copy()
    for number, (pose, more) in enumerate(zip(EIGHT_POSES, told, strict=True), start=1):
        known = known + more
        add(f"{number} {pose.name}", known)
    add("eight naive poses", believed + naive.sum(axis=0))
    return table
