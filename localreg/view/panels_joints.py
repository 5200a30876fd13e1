"""Gauges and graphs of the joint angles that somebody wants to see."""

from typing import Final

import numpy as np
from mujoco.studio.dear_imgui import dear_imgui as imgui

from localreg.body.skeleton import BONES, DOF_NAMES
from localreg.view.panels import Desk, Panel
from localreg.view.panels_plots import plot

CHOSEN_FIRST: Final = ("lfemurrx", "rfemurrx", "ltibiarx", "rtibiarx")
"""Angles shown until somebody chooses others: hips and knees, which tell walks apart."""

_LIMITS: Final = {
    f"{bone.name}r{dof}": limits
    for bone in BONES
    for dof, limits in zip(bone.dofs, bone.limits_deg, strict=True)
}


class JointsPanel(Panel):
    """Joint angles: a gauge each between the usual limits, and their graphs."""

    title = "Joints"

    def __init__(self) -> None:
        self.chosen = [name for name in CHOSEN_FIRST if name in DOF_NAMES]
        self._hint = ""

    def draw(self, desk: Desk) -> None:
        """The list to choose from, the gauges and the graphs."""
        if imgui.BeginCombo("angles", f"{len(self.chosen)} chosen"):
            changed, hint = imgui.InputText("find", self._hint)
            if changed:
                self._hint = hint
            for name in DOF_NAMES:
                if self._hint in name and imgui.Selectable(name, name in self.chosen):
                    self.toggle(name)
            imgui.EndCombo()
        if desk.moment is None or not self.chosen:
            imgui.TextDisabled("choose joint angles above")
            return
        degrees = np.degrees(desk.moment.qpos[7:])
        for name in self.chosen:
            value = float(degrees[DOF_NAMES.index(name)])
            low, high = _LIMITS[name]
            share = (value - low) / (high - low) if high > low else 0.5
            imgui.ProgressBar(
                min(max(share, 0.0), 1.0), imgui.Vec2(-1.0, 0.0), f"{name} {value:6.1f} deg"
            )
        columns = [DOF_NAMES.index(name) for name in self.chosen]
        shown = np.degrees(desk.history.angles[:, columns]).T
        lowest = min(0.0, float(shown.min()) * 1.1) if shown.size else 0.0
        lines = dict(zip(self.chosen, shown, strict=True))
        plot("joint angles", "deg", desk.history.ages, lines, least=10.0, lowest=lowest)

    def toggle(self, name: str) -> None:
        """Show an angle, or no longer."""
        if name in self.chosen:
            self.chosen.remove(name)
        else:
            self.chosen.append(name)
