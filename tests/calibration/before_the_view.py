"""Somebody who stands before the live view and holds poses."""

from pathlib import Path

import numpy as np

from calibration.panel import WizardPanel
from calibration.wizard_state import WizardSettings
from localreg.body.subject import canonical_subject
from localreg.evaluation.body_points import BodyPoints
from localreg.view.moment import Moment, Observer
from localreg.view.panels import Desk
from localreg.view.source import Source
from sensors.pose import TrackerFrame

RATE = 30.0
"""Of the pictures, which see less than every frame [Hz]."""

PATIENCE = 180.0
SETTINGS = WizardSettings(hold=0.6, get_ready=0.2)


class Person(Source):
    """Somebody who holds one pose after another before the view."""

    def __init__(self, folder: Path | None, person=None) -> None:
        self.subject = canonical_subject() if person is None else person
        self.folder = folder
        self._observer = Observer(self.subject)
        self._points = BodyPoints(self.subject)
        self._rng = np.random.default_rng(3)
        self._time = 0.0
        self._moment: Moment | None = None

    def newest(self) -> Moment | None:
        return self._moment

    def take(self, qpos: np.ndarray) -> None:
        """Be in a pose for one more picture."""
        self._time += 1.0 / RATE
        poses = self._points.tracker_poses(qpos[None])
        mask = np.ones(len(self.subject.trackers), dtype=bool)
        positions = poses.positions[0] + self._rng.normal(0.0, 0.001, poses.positions[0].shape)
        frame = TrackerFrame(self._time, positions, poses.quaternions[0], mask, mask)
        self._moment = self._observer.observe(self._time, qpos, frame)


def hold(panel: WizardPanel, desk: Desk, person: Person, before, pose) -> None:
    """Go from one pose to another and stay there."""
    for share in (*np.linspace(0.0, 1.0, 20), *[1.0] * round(2.0 * RATE)):
        qpos = (1.0 - share) * before + share * pose
        qpos[3:7] /= np.linalg.norm(qpos[3:7])
        person.take(qpos)
        desk.look()
        panel.watch(desk)
