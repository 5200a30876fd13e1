"""What is drawn of a moment: the model to show, and the marks drawn into it.

The bodies (and floor, light, sky) are one MuJoCo model; trackers, errors and trails are
marks that change from moment to moment. Every host takes both:

- `build_stage` compiles the model, `Stage.place` poses its data for a moment;
- `marks` says what is drawn beside the bodies, as plain values;
- `draw` adds marks to an `MjvScene` (off-screen pictures; `user_scn` of the classic
  viewer), `geoms` makes a list of them (`extra_geoms` of `mujoco.studio`);
- `show_look` sets in an `MjvOption` which of the looks of the bodies is seen.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Final

import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.subject import Subject
from localreg.drawing.looks import LOOKS, Look, show_look
from localreg.drawing.scene import BLUE, Color, Figure, Scene, build_scene
from localreg.view.moment import Moment, TrackerMoment

__all__ = [
    "LOOKS",
    "Block",
    "Look",
    "Mark",
    "Rod",
    "Stage",
    "Style",
    "build_stage",
    "draw",
    "geoms",
    "light_for_studio",
    "marks",
    "show_look",
]

Rgba = tuple[float, float, float, float]

GHOST_GREEN: Final[Color] = (0.36, 0.74, 0.42)
"""The body that the other is compared with; it is seen through, so it is a strong green."""

GHOST_OPACITY: Final = 0.42
"""How much of it is seen."""

_GHOST_GIRTH: Final = 0.9  # of the other body's
_AXES: Final = ((0.86, 0.24, 0.22), (0.27, 0.66, 0.30), (0.20, 0.42, 0.88))
_CASE: Final[Rgba] = (0.13, 0.14, 0.16, 1.0)
_MASKED: Final[Rgba] = (0.55, 0.55, 0.56, 0.75)
_ERROR: Final[Rgba] = (0.96, 0.45, 0.05, 1.0)
_TRAIL: Final = (0.95, 0.58, 0.22)
_TRAIL_END: Final = (0.86, 0.845, 0.82)  # about the floor's color
_AWAY: Final = np.array([0.0, 0.0, -1000.0])  # where a body stands that is not to be seen
_NOWHERE: Final = np.zeros(3)
_UNTURNED: Final = np.eye(3).ravel()
_LEAST_ERROR: Final = 1e-4  # a shorter line cannot be seen [m]


@dataclass(frozen=True, eq=False, slots=True)
class Rod:
    """A straight round line between two points.

    Attributes:
        start: in the world [m].
        end: in the world [m].
        radius: [m].
        color: red, green, blue, opacity; 0 to 1.
    """

    start: Float[ndarray, "3"]
    end: Float[ndarray, "3"]
    radius: float
    color: Rgba


@dataclass(frozen=True, eq=False, slots=True)
class Block:
    """A cube, perhaps with a name.

    Attributes:
        position: of its center, in the world [m].
        quaternion: w x y z.
        half: half the length of an edge [m].
        color: red, green, blue, opacity; 0 to 1.
        label: written beside it; empty for nothing.
    """

    position: Float[ndarray, "3"]
    quaternion: Float[ndarray, "4"]
    half: float
    color: Rgba
    label: str = ""


Mark = Rod | Block
"""Something drawn that is no body."""


@dataclass(frozen=True)
class Style:
    """What of a moment is to be seen.

    Attributes:
        look: of the bodies.
        measured: where trackers were measured, as thick short axes; masked ones in gray.
        predicted: where the body has them, as thin long axes.
        errors: a line between the two.
        ghost: the body to compare with, if the moment has one.
        trails: where the trackers have been.
        labels: the trackers' names.
    """

    look: Look = "capsules"
    measured: bool = True
    predicted: bool = True
    errors: bool = True
    ghost: bool = True
    trails: bool = True
    labels: bool = False


@dataclass(frozen=True, eq=False)
class Stage:
    """The compiled model of a body, perhaps with a ghost.

    Attributes:
        scene: the model; `qpos` is the body's pose, then the ghost's.
        has_ghost: whether there is a second body.
    """

    scene: Scene
    has_ghost: bool

    @property
    def model(self) -> mujoco.MjModel:
        """The model to show."""
        return self.scene.model

    def place(self, data: mujoco.MjData, moment: Moment, style: Style | None = None) -> None:
        """Pose the bodies of a moment; `data` is ready to be drawn afterwards.

        Args:
            data: of this stage's model.
            moment: what is to be seen.
            style: whether the ghost is to be seen.
        """
        poses = [moment.qpos]
        if self.has_ghost:
            seen = moment.ghost is not None and (style is None or style.ghost)
            poses.append(moment.ghost if seen and moment.ghost is not None else _out_of_sight())
        self.scene.place(data, poses)


def build_stage(
    subject: Subject, ghost: Subject | None = None, *, color: Color = BLUE, floor: float = 0.0
) -> Stage:
    """The model of a body in a clear style on a floor, with light, shadow and sky.

    Args:
        subject: whose body is shown.
        ghost: whose body it is compared with, in translucent green; None for nobody's.
        color: of the body.
        floor: height of the floor [m].
    """
    figures = [Figure(subject, color, looks=True)]
    if ghost is not None:
        figures.append(Figure(ghost, GHOST_GREEN, GHOST_OPACITY, looks=True, girth=_GHOST_GIRTH))
    return Stage(build_scene(figures, floor=floor), ghost is not None)


def light_for_studio(model: mujoco.MjModel) -> None:
    """Change the light to what `mujoco.studio` makes the same picture of as the classic viewer.

    Its renderer lets only the brightest of the directional lights cast shadows, and takes the
    headlight for one of them.

    Args:
        model: of a stage; changed.
    """
    visual: Any = model.vis  # whose fields the stubs do not know
    visual.headlight.ambient[:] = 0.3
    visual.headlight.diffuse[:] = 0.0
    model.light_diffuse[:] = 0.95
    model.mat_rgba[model.material("floor").id, :3] = 0.72


def marks(moment: Moment, style: Style | None = None) -> list[Mark]:
    """What is drawn of a moment beside the bodies."""
    style = style or Style()
    found: list[Mark] = []
    if style.trails:
        for trail in moment.trails:
            found += _trail(trail)
    for tracker in moment.trackers:
        found += _tracker(tracker, style)
    return found


def draw(scene: mujoco.MjvScene, found: Iterable[Mark]) -> None:
    """Add marks to a scene behind what it holds; beyond its capacity they are left out."""
    for mark in found:
        if scene.ngeom >= scene.maxgeom:
            return
        _fill(scene.geoms[scene.ngeom], mark)
        scene.ngeom += 1


def geoms(found: Iterable[Mark]) -> list[mujoco.MjvGeom]:
    """The marks as a list, for hosts that own their scene."""
    made = []
    for mark in found:
        geom = mujoco.MjvGeom()
        _fill(geom, mark)
        made.append(geom)
    return made


def _out_of_sight() -> Float[ndarray, "63"]:
    qpos = np.zeros(63)
    qpos[:3], qpos[3] = _AWAY, 1.0
    return qpos


def _tracker(tracker: TrackerMoment, style: Style) -> list[Mark]:
    label = tracker.name if style.labels else ""
    found: list[Mark] = []
    here, turned = tracker.predicted_position, tracker.predicted_quaternion
    if tracker.is_masked:
        if style.measured:
            found += _axes(here, turned, 0.10, 0.006, (_MASKED[:3],) * 3, _MASKED[3])
            found.append(Block(here, turned, 0.018, _MASKED, label))
        return found
    if style.predicted:
        found += _axes(here, turned, 0.15, 0.0025, _AXES, 1.0)
    if style.measured:
        place = tracker.position if tracker.has_position else here
        turn = tracker.quaternion if tracker.has_orientation else turned
        if tracker.has_orientation:
            found += _axes(place, turn, 0.10, 0.0065, _AXES, 1.0)
        color = _CASE if tracker.has_position else _MASKED
        found.append(Block(place, turn, 0.018, color, label))
    if style.errors and tracker.has_position and tracker.distance > _LEAST_ERROR:
        found.append(Rod(tracker.position, here, 0.007, _ERROR))
    return found


def _axes(
    origin: Float[ndarray, "3"],
    quaternion: Float[ndarray, "4"],
    length: float,
    radius: float,
    colors: tuple[tuple[float, float, float], ...],
    opacity: float,
) -> list[Mark]:
    matrix = np.empty(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return [
        Rod(origin, origin + length * axis, radius, (*color, opacity))
        for axis, color in zip(matrix.reshape(3, 3).T, colors, strict=True)
    ]


def _trail(points: Float[ndarray, "points 3"]) -> list[Mark]:
    """The path, paler and thinner towards where it is oldest.

    Paler, not more transparent: where transparent pieces overlap they would show as beads.
    """
    found: list[Mark] = []
    pieces = len(points) - 1
    for i in range(pieces):
        share = (i + 1) / pieces
        red, green, blue = (
            share * new + (1.0 - share) * old for new, old in zip(_TRAIL, _TRAIL_END, strict=True)
        )
        radius = 0.001 + 0.0025 * share
        found.append(Rod(points[i], points[i + 1], radius, (red, green, blue, 1.0)))
    return found


def _fill(geom: mujoco.MjvGeom, mark: Mark) -> None:
    color = np.array(mark.color, dtype=np.float32)
    if isinstance(mark, Rod):
        kind = mujoco.mjtGeom.mjGEOM_CAPSULE
        mujoco.mjv_initGeom(geom, kind, _NOWHERE, _NOWHERE, _UNTURNED, color)
        mujoco.mjv_connector(geom, kind, mark.radius, mark.start, mark.end)
    else:
        matrix = np.empty(9)
        mujoco.mju_quat2Mat(matrix, mark.quaternion)
        size = np.full(3, mark.half)
        mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_BOX, size, mark.position, matrix, color)
        geom.label = mark.label
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR
    geom.specular, geom.shininess = 0.2, 0.3
