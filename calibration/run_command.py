"""What `localreg calibrate run` does."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from rich.console import Console

from calibration.calibrate import Outcome, calibrate
from calibration.eigen_skeleton import SkeletonPrior
from calibration.knowledge import known_file, write_knowledge
from calibration.live import Hooks, lead, make_judge
from calibration.motion_step import MotionStep
from calibration.people_commands import people
from calibration.poses import EIGHT_POSES, TargetPose, mirrored, with_swapped
from calibration.progress import forget, read_motion, read_progress, write_progress
from calibration.report import (
    findings_lines,
    lengths_table,
    motion_lines,
    mounts_table,
    summary_lines,
)
from calibration.setup import Source, configured, simulated
from calibration.simulated import Habits
from calibration.terminal import TerminalView
from calibration.with_motion import with_motion
from calibration.wizard import Wizard, check_names
from calibration.wizard_state import WizardSettings
from localreg.body.subject import read_subject, write_subject
from localreg.commands.console import notes, output, progress_bar
from localreg.errors import LocalregError
from localreg.live.database_choice import choose_database

_ROUNDS: Final = 2
"""How often the person is asked to repeat what the fit found wrong."""

_MOTION: Final = 60.0
_SIMULATED_MOTION: Final = 20.0
"""How much motion follows the poses if nobody says [s]."""


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
    motion: float | None = None
    database: Path | None = None

    @property
    def motion_seconds(self) -> float:
        """How much motion follows the poses [s]."""
        if self.motion is not None:
            return self.motion
        if self.quick:
            return 0.0
        return _MOTION if self.simulate is None else _SIMULATED_MOTION


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
        forget(file)
    console = notes()
    with _source(options) as source:
        trackers = tuple(mount.tracker for mount in source.mounts)
        holds = read_progress(file, trackers)
        holds = {name: hold for name, hold in holds.items() if name in {p.name for p in poses}}
        motion = MotionStep.of(
            source.mounts, options.motion_seconds, stretches=read_motion(file, trackers)
        )
        if holds and not options.only:
            walked = f" and {motion.collected:.0f} s of motion" if motion.stretches else ""
            console.print(f"going on after {len(holds)} poses{walked} recorded before ({file})")
        for name in options.only:
            holds.pop(name, None)
        wizard = Wizard(
            poses,
            trackers,
            judge=make_judge(EIGHT_POSES, source.mounts, prior),
            settings=WizardSettings(hold=options.hold),
            holds=holds,
            motion=motion,
        )
        outcome = _led(wizard, source, prior, options, file, console)
        truth = source.truth
        walked = source.walked
    if outcome.calibration is not None and motion.stretches:
        chosen = choose_database(options.database, console.print)
        with progress_bar("learning from motion") as bar:
            better = with_motion(
                outcome.calibration, motion.stretches, chosen.poses, hidden=walked, progress=bar
            )
        outcome = replace(outcome, calibration=better)
    _report(outcome, truth, options)
    leave_progress(file, wizard, outcome.repeat)


def leave_progress(file: Path, wizard: Wizard, repeat: Sequence[str]) -> None:
    """Keep what was good if poses are to be repeated, so that only they are asked for again."""
    good = tuple(hold for hold in wizard.holds if hold.pose not in repeat)
    if repeat and good:
        write_progress(file, good, wizard.trackers)
    else:
        forget(file)


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
        walk_seconds=options.motion_seconds,
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
    for line in motion_lines(result, outcome.findings):
        console.print(line, soft_wrap=True)
    write_subject(result.subject, options.out)
    write_knowledge(result.knowledge, result.subject, known_file(options.out))
    shown = output()
    shown.print(lengths_table(result, truth))
    shown.print(mounts_table(result))
    for line in summary_lines(result):
        shown.print(line, soft_wrap=True)
    shown.print(f"subject: {options.out}", soft_wrap=True)
    shown.print(
        f"more motion makes it better: localreg calibrate refine {options.out}", soft_wrap=True
    )
    if outcome.repeat:
        names = ", ".join(outcome.repeat)
        shown.print(
            f"better still: the same command without --fresh asks for {names} again", soft_wrap=True
        )
