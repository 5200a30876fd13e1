"""The wizard as a panel of the live view: leads through the poses beside the body it measures.

It is a front end of the same state machine as the terminal's. Frames come from the view, poses
are shown as the ghost, and the fit runs in a thread while the view goes on. A run goes on with
the subject that it began with; the file that is written is for the next one.
"""

import threading
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from jaxtyping import Float
from mujoco.studio.dear_imgui import dear_imgui as imgui
from numpy import ndarray

from calibration import motion_step
from calibration.eigen_skeleton import published_prior
from calibration.holds import Hold
from calibration.motion_step import MotionStep, Stretches
from calibration.poses import EIGHT_POSES, TargetPose
from calibration.wizard import Wizard
from calibration.wizard_state import State, WizardSettings
from localreg.body.subject import Mount, write_subject
from localreg.errors import LocalregError
from localreg.view.cameras import heading
from localreg.view.moment import Moment
from localreg.view.panels import Desk, Panel
from sensors import rotation
from sensors.pose import TrackerFrame

if TYPE_CHECKING:
    from calibration.result import Calibration

LEAST_TRACKERS: Final = 4
"""With fewer a person cannot be measured."""

_TITLES: Final = {
    State.READY: "paused",
    State.MOVING: "take the pose",
    State.HOLDING: "hold still",
    State.WALKING: "move about",
    State.DONE: "all is recorded",
}

Fitted = tuple["Calibration | None", tuple[str, ...], tuple[str, ...]]
"""What was found of the person, what was amiss in words, and the poses to repeat."""

Fitting = Callable[[Sequence[Hold], tuple[Mount, ...], Stretches], Fitted]
"""Makes a person of what was recorded."""


def fit_person(holds: Sequence[Hold], mounts: tuple[Mount, ...], motion: Stretches = ()) -> Fitted:
    """The usual fit; compiles for half a minute the first time.

    Args:
        holds: of the poses.
        mounts: which tracker on which bone.
        motion: what followed, judged by the poses of the sample set.

    Raises:
        LocalregError: it does not come to a result.
    """
    from calibration.calibrate import calibrate

    outcome = calibrate(holds, mounts, published_prior())
    texts = tuple(finding.text for finding in outcome.findings)
    found = outcome.calibration
    if found is not None and motion and not outcome.repeat:
        from calibration.with_motion import with_motion
        from localreg.live.database_choice import choose_database

        found = with_motion(found, motion, choose_database(None).poses)
    return found, texts, outcome.repeat


class WizardPanel(Panel):
    """Asks for the poses, records them, fits, and says where the result is.

    Args:
        poses: in their order.
        settings: times and patience.
        fitting: makes a person of what was recorded.
        motion: how much motion follows the poses [s].
    """

    title = "Calibration"

    def __init__(
        self,
        poses: Sequence[TargetPose] = EIGHT_POSES,
        settings: WizardSettings | None = None,
        fitting: Fitting = fit_person,
        motion: float = 60.0,
    ) -> None:
        self._seconds = motion
        self._poses, self._settings, self._fitting = tuple(poses), settings, fitting
        self._fit: threading.Thread | None = None
        self.wizard: Wizard | None = None
        self.words = ""

    @property
    def is_fitting(self) -> bool:
        """Whether the person is being computed."""
        return self._fit is not None and self._fit.is_alive()

    def join(self, timeout: float) -> None:
        """Wait for the fit, at most so long [s]."""
        if self._fit is not None:
            self._fit.join(timeout)

    def is_wanted(self, desk: Desk) -> bool:
        """Whether somebody stands there live, with enough trackers."""
        source = desk.source
        return source.folder is not None and len(source.subject.trackers) >= LEAST_TRACKERS

    def begin(self, desk: Desk) -> None:
        """Ask for the poses, from the first."""
        subject = desk.source.subject
        motion = MotionStep.of(subject.mounts, self._seconds)
        self.wizard = Wizard(self._poses, subject.trackers, settings=self._settings, motion=motion)
        self.wizard.go()
        self.words = ""

    def leave(self, desk: Desk) -> None:
        """Forget what was recorded."""
        self.wizard, desk.target = None, None

    def watch(self, desk: Desk) -> None:
        """Take the newest frame, folded or not."""
        wizard, moment = self.wizard, desk.moment
        if wizard is None or moment is None or not desk.is_new:
            return
        if wizard.state is State.DONE:
            if self._fit is None:
                self._begin_fit(wizard, desk)
            elif not self._fit.is_alive():
                self._fit = None
                if wizard.state is State.DONE:
                    self.leave(desk)
            return
        if len(moment.trackers) == len(wizard.trackers):
            wizard.push(frame_of(moment))
        desk.target = None if wizard.pose is None else beside(wizard.pose.qpos(), moment.qpos)

    def draw(self, desk: Desk) -> None:
        """What to do, how far it is, and buttons for the keys of the terminal."""
        wizard = self.wizard
        if wizard is None:
            imgui.TextWrapped(
                f"{len(self._poses)} poses, a few seconds each, and {self._seconds:.0f} s of "
                "walking about tell this person's lengths and where the trackers sit."
            )
            if imgui.Button("recalibrate"):
                self.begin(desk)
        elif self.is_fitting:
            imgui.TextWrapped("fitting; half a minute the first time")
        else:
            self._draw_wizard(wizard, desk)
        if self.words:
            imgui.TextWrapped(self.words)

    def _draw_wizard(self, wizard: Wizard, desk: Desk) -> None:
        seen = wizard.snapshot()
        if seen.pose is not None:
            imgui.SeparatorText(f"pose {seen.number} of {seen.total}: {seen.pose.name}")
            for part, words in zip(("legs", "arms", "head"), seen.pose.words, strict=True):
                imgui.TextWrapped(f"{part}: {words}")
        elif seen.state is not State.DONE:
            imgui.SeparatorText(motion_step.NAME)
            imgui.TextWrapped(motion_step.WORDS)
            imgui.TextWrapped(motion_step.told(seen.left, seen.stiff))
        imgui.ProgressBar(seen.held, imgui.Vec2(-1.0, 0.0), _TITLES[seen.state])
        if imgui.Button("go" if seen.state is State.READY else "pause"):
            (wizard.go if seen.state is State.READY else wizard.pause)()
        imgui.SameLine()
        if imgui.Button("back"):
            wizard.back()
        imgui.SameLine()
        if imgui.Button("skip"):
            wizard.skip()
        imgui.SameLine()
        if imgui.Button("leave"):
            self.leave(desk)
        if seen.message:
            imgui.TextWrapped(seen.message)
        if seen.unseen:
            imgui.TextWrapped(f"not seen: {', '.join(seen.unseen)}")

    def _begin_fit(self, wizard: Wizard, desk: Desk) -> None:
        desk.target = None
        subject, folder = desk.source.subject, desk.source.folder
        if folder is None:
            return
        self._fit = threading.Thread(
            target=self._run_fit, args=(wizard, subject.mounts, folder), name="fit", daemon=True
        )
        self._fit.start()

    def _run_fit(self, wizard: Wizard, mounts: tuple[Mount, ...], folder: Path) -> None:
        try:
            motion = () if wizard.motion is None else wizard.motion.stretches
            found, findings, repeat = self._fitting(wizard.holds, mounts, motion)
            if found is not None:
                file = folder / f"subject-{datetime.now():%Y%m%d-%H%M%S}.toml"
                folder.mkdir(parents=True, exist_ok=True)
                write_subject(found.subject, file)
                _keep_knowledge(found, file)
                findings += (f"Written to {file.name}; begin the next run with it: --subject",)
            self.words = "\n".join(findings) or "there is no result; record the poses again"
            if repeat:
                wizard.repeat(repeat)
        except (LocalregError, OSError) as error:
            # An error of the disk names its file, which is nobody else's business.
            told = error.strerror if isinstance(error, OSError) else str(error)
            self.words = f"no result: {told or 'the disk does not take it'}"


def _keep_knowledge(found: "Calibration", file: Path) -> None:
    from calibration.knowledge import known_file, write_knowledge

    write_knowledge(found.knowledge, found.subject, known_file(file))


def frame_of(moment: Moment) -> TrackerFrame:
    """What the trackers said at a moment."""
    trackers = moment.trackers
    return TrackerFrame(
        time=moment.time,
        positions=np.array([tracker.position for tracker in trackers]),
        quaternions=np.array([tracker.quaternion for tracker in trackers]),
        position_mask=np.array([tracker.has_position for tracker in trackers]),
        orientation_mask=np.array([tracker.has_orientation for tracker in trackers]),
    )


def beside(target: Float[ndarray, "63"], body: Float[ndarray, "63"]) -> Float[ndarray, "63"]:
    """A pose where a body stands, facing where it faces; heights stay."""
    facing, wanted = heading(target), heading(body)
    turn = 0.0 if facing is None or wanted is None else wanted - facing
    about = np.array([np.cos(0.5 * turn), 0.0, 0.0, np.sin(0.5 * turn)])
    moved = target.copy()
    moved[:2] = body[:2]
    moved[3:7] = rotation.multiply(about, target[3:7])
    return moved
