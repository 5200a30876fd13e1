"""Panels beside the body: what one is, the desk that they share, and which there are.

A panel draws itself with Dear ImGui whenever it is asked to, and keeps what it must remember
in itself and on the desk. Packages add panels by entry point (group `localreg.panels`), so
that the view need not know them.
"""

from abc import ABC, abstractmethod
from importlib.metadata import entry_points
from typing import Final

from jaxtyping import Float
from numpy import ndarray

from localreg.view.cameras import Preset
from localreg.view.history import History
from localreg.view.moment import Moment
from localreg.view.scene import Style
from localreg.view.source import Source

GROUP: Final = "localreg.panels"
"""Entry points of this group name panel classes."""


class Desk:
    """What the panels of one view have in common.

    Args:
        source: where moments come from.

    Attributes:
        source: as given.
        style: what of a moment is to be seen; panels may replace it.
        camera: the preset that somebody asks for; None once it was obeyed.
        moment: what is being shown; None before the first.
        history: the last seconds.
        target: a pose to be taken, shown as the ghost; None for none.
        is_new: whether the moment came since the last drawing.
    """

    def __init__(self, source: Source) -> None:
        self.source = source
        self.style = Style()
        self.camera: Preset | None = None
        self.moment: Moment | None = None
        self.target: Float[ndarray, 63] | None = None
        self.history = History(len(source.subject.trackers))
        self.is_new = False

    def look(self) -> Moment | None:
        """Take the newest moment of the source."""
        newest = self.source.newest()
        self.is_new = newest is not None and newest is not self.moment
        if newest is not None and self.is_new:
            self.moment = newest
            self.history.add(newest)
        return self.moment


class Panel(ABC):
    """One section of the side window.

    Attributes:
        title: its heading, unique among the panels.
        is_open: whether it is unfolded at first.
    """

    title: str
    is_open: bool = False

    def is_wanted(self, desk: Desk) -> bool:
        """Whether it has anything to show of this source."""
        return True

    def watch(self, desk: Desk) -> None:  # noqa: B027  (most panels only draw)
        """Called for every frame drawn, whether the panel is unfolded or not."""

    @abstractmethod
    def draw(self, desk: Desk) -> None:
        """Draw it; the heading is there already."""


def panels_for(desk: Desk) -> list[Panel]:
    """The panels that have something to show, in the order in which they are shown."""
    from localreg.view.panels_joints import JointsPanel
    from localreg.view.panels_live import PriorPanel, TakePanel, TimingPanel, TrackersPanel
    from localreg.view.panels_scene import ScenePanel
    from localreg.view.panels_transport import TransportPanel

    panels: list[Panel] = [
        TransportPanel(), TakePanel(), TrackersPanel(), TimingPanel(), PriorPanel(),
        JointsPanel(), ScenePanel(),
    ]  # fmt: skip
    for point in sorted(entry_points(group=GROUP), key=lambda point: point.name):
        panels.append(point.load()())
    return [panel for panel in panels if panel.is_wanted(desk)]
