"""A page on which every panel is unfolded and has something to show; ends with its input.

python -m tests.localreg.view.all_panels FOLDER [file]
"""

import math
import sys
import threading
from pathlib import Path

import numpy as np

from calibration.panel import WizardPanel
from localreg.body.subject import canonical_subject
from localreg.evaluation.body_points import BodyPoints
from localreg.view import web_host
from localreg.view.feed import About, Glimpse, moment_of
from localreg.view.moment import Heard, Moment, NeighborClip, Observer, Timing
from localreg.view.panels import Desk, panels_for
from localreg.view.panels_plugin import BodyPlugin
from localreg.view.scene import Stage
from localreg.view.source import COMMANDS, Command, Source
from localreg.view.transport import Deck, Playhead
from sensors.pose import TrackerFrame


class Swaying(Source):
    """Somebody who sways, with one tracker that comes and goes."""

    def __init__(self, folder: Path, *, is_file: bool) -> None:
        self.subject = self.ghost = canonical_subject()
        self.transport = Deck(Playhead(100, 40.0)) if is_file else None
        self.folder = None if is_file else folder
        self.commands = () if is_file else COMMANDS
        self._observer, self._points = Observer(self.subject), BodyPoints(self.subject)
        self._index = 0

    def newest(self) -> Moment:
        self._index += 1
        time = self._index / 30.0
        qpos = np.zeros(63)
        qpos[0], qpos[2], qpos[3:5], qpos[27] = math.sin(time), 1.0, 0.5**0.5, math.cos(time)
        poses = self._points.tracker_poses(qpos[None])
        seen = np.ones(len(self.subject.trackers), dtype=bool)
        seen[2] = self._index % 20 > 10
        frame = TrackerFrame(time, poses.positions[0] + 0.01, poses.quaternions[0], seen, seen)
        shown = Glimpse(self._index, frame, qpos, 0.5, not seen[2], self._index == 1, qpos)
        about = About(
            timing=Timing(0.005, 0.012, self._index, 1, 0.003, 0.006),
            heard={name: Heard(40.0, 0.02) for name in self.subject.trackers[:3]},
            neighbors=(NeighborClip("16_01", "walk", 0.5), NeighborClip("x", "", 0.1)),
            title="swaying",
        )
        return moment_of(shown, about, self._observer)

    def command(self, name: Command) -> None:
        """Nobody presses anything."""

    @property
    def note(self) -> str:
        return "recording take.bvh"

    @property
    def notice(self) -> str:
        return "nobody is tracked"

    @property
    def is_recording(self) -> bool:
        return True


def unfolded(stage: Stage, desk: Desk) -> BodyPlugin:
    """The plugin with all panels open, the wizard at work."""
    panels = panels_for(desk)
    for panel in panels:
        panel.is_open = True
        if isinstance(panel, WizardPanel):
            panel.begin(desk)
    return BodyPlugin(stage, desk, panels)


def main(folder: str, *rest: str) -> None:
    """Serve until the input ends."""
    web_host.BodyPlugin = unfolded
    page = web_host.WebHost(Swaying(Path(folder), is_file=bool(rest)), port=0)

    def wait() -> None:
        sys.stdin.read()
        page.close()

    threading.Thread(target=wait, daemon=True).start()
    page.run(lambda: print(page.url, flush=True))


if __name__ == "__main__":
    main(*sys.argv[1:])
