"""A scene as a MuJoCo model: floor, sky, light, one or more bodies, measured trackers.

The same scene serves pictures and live views: it is a plain `MjModel` whose `qpos` is the
poses of its bodies one after the other, and whose mocap bodies are the trackers.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import mujoco
import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from localreg.body.model import build_spec, tracker_site
from localreg.body.skeleton import QPOS_SIZE
from localreg.body.subject import Subject
from localreg.drawing.looks import add_looks

Color = tuple[float, float, float]

BLUE: Final[Color] = (0.25, 0.47, 0.75)
"""Synthesized bodies."""

GREEN: Final[Color] = (0.52, 0.70, 0.52)
"""True bodies."""

GRAY: Final[Color] = (0.62, 0.61, 0.60)
"""Bodies that stand for nothing in particular."""

_AXIS_COLORS: Final = ((0.85, 0.26, 0.22), (0.30, 0.66, 0.30), (0.22, 0.42, 0.85))
_AXIS_LENGTH: Final = 0.15
_AXIS_RADIUS: Final = 0.009
_HAZE: Final[Color] = (0.93, 0.92, 0.90)  # where floor and sky meet
_SKY: Final[Color] = (0.72, 0.80, 0.88)


@dataclass(frozen=True)
class Figure:
    """One body of a scene.

    Attributes:
        subject: whose body.
        color: red, green, blue from 0 to 1.
        opacity: 1 for a solid body, less for a ghost.
        axes: whether axes are drawn where its trackers are mounted.
        looks: whether the model also holds the looks that are not capsules (`looks.py`).
        girth: how thick it is. Of two bodies in nearly the same place a slightly thinner one
            is seen only where they differ, instead of both flickering.
    """

    subject: Subject
    color: Color = BLUE
    opacity: float = 1.0
    axes: bool = False
    looks: bool = False
    girth: float = 1.0


@dataclass(frozen=True)
class Scene:
    """A compiled scene.

    Attributes:
        model: the whole scene; `qpos` is the poses of the figures one after the other.
        figures: the bodies in it.
        trackers: names of the measured trackers, drawn as axes, in order.
    """

    model: mujoco.MjModel
    figures: tuple[Figure, ...]
    trackers: tuple[str, ...]

    def place(
        self,
        data: mujoco.MjData,
        poses: Sequence[Float[ndarray, " 63"]],
        trackers: Mapping[str, tuple[Float[ndarray, " 3"], Float[ndarray, " 4"]]] | None = None,
    ) -> None:
        """Put bodies and trackers where they are at one instant.

        Args:
            data: of this scene's model; ready to be drawn afterwards.
            poses: one a figure.
            trackers: position [m] and quaternion w x y z of those that were measured;
                the others are hidden.
        """
        data.qpos[:] = np.concatenate([np.asarray(pose) for pose in poses])
        for index, name in enumerate(self.trackers):
            position, quaternion = (trackers or {}).get(name, _HIDDEN)
            data.mocap_pos[index], data.mocap_quat[index] = position, quaternion
        # The sun goes along with the bodies: its shadows reach only so far from it.
        seen = [figure.opacity > 0 for figure in self.figures]
        roots = data.qpos.reshape(-1, QPOS_SIZE)[seen if any(seen) else slice(None), :3]
        here = roots[roots[:, 2] > _OUT_OF_SIGHT]
        if len(here):
            data.mocap_pos[self._sun] = here.mean(axis=0)
        self._update(data)

    def turn_sun(self, data: mujoco.MjData, azimuth: float) -> None:
        """Let the sun stand behind the left shoulder of whoever looks that way.

        The sides that are seen are lit then, and shadows fall to where they can be seen.
        Against the light MuJoCo's shadow maps leave specks on the floor besides.

        Args:
            data: of this scene's model, after `place`.
            azimuth: direction of view about the vertical, 0 along world x [rad].
        """
        half = 0.5 * (azimuth - _SUN_ASIDE)
        data.mocap_quat[self._sun] = np.cos(half), 0.0, 0.0, np.sin(half)
        self._update(data)

    @property
    def _sun(self) -> int:
        return len(self.trackers)  # among the mocap bodies

    def _update(self, data: mujoco.MjData) -> None:
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_comPos(self.model, data)
        mujoco.mj_camlight(self.model, data)

    def tracker_poses(
        self, data: mujoco.MjData, figure: int = 0
    ) -> dict[str, tuple[Float[ndarray, " 3"], Float[ndarray, " 4"]]]:
        """Where the trackers that a figure wears are, after `place`."""
        poses = {}
        for tracker in self.figures[figure].subject.trackers:
            site = data.site(_prefix(figure) + tracker_site(tracker))
            quaternion = np.zeros(4)
            mujoco.mju_mat2Quat(quaternion, site.xmat)
            poses[tracker] = (site.xpos.copy(), quaternion)
        return poses


_HIDDEN: Final = (np.array([0.0, 0.0, -1000.0]), np.array([1.0, 0.0, 0.0, 0.0]))
_OUT_OF_SIGHT: Final = -500.0  # what lies deeper was put away
_SUN_ASIDE: Final = 0.75  # how far from straight behind the viewer the sun stands [rad]
_SUN_AZIMUTH: Final = 0.95  # where its light goes until somebody turns it [rad]


def build_scene(
    figures: Sequence[Figure], *, trackers: Sequence[str] = (), floor: float = 0.0
) -> Scene:
    """The scene of some bodies on a checkered floor under a pale sky.

    Args:
        figures: the bodies; at least one.
        trackers: names of measured trackers to be drawn apart from any body.
        floor: height of the floor [m].

    Raises:
        ValueError: there is no figure.
    """
    if not figures:
        raise ValueError("a scene needs a body")
    spec = mujoco.MjSpec()
    spec.modelname = "localreg scene"
    spec.option.gravity = [0.0, 0.0, 0.0]
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    _add_surroundings(spec, floor)
    for index, figure in enumerate(figures):
        frame = spec.worldbody.add_frame()
        spec.attach(_figure_spec(figure), prefix=_prefix(index), frame=frame)
    for name in trackers:
        body = spec.worldbody.add_body(name=f"measured:{name}", mocap=True)
        _add_axes(body, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    _add_sun(spec, floor)
    model = spec.compile()
    if model.nq != QPOS_SIZE * len(figures):
        raise ValueError(f"the scene has {model.nq} coordinates; a body has {QPOS_SIZE}")
    return Scene(model, tuple(figures), tuple(trackers))


def _prefix(figure: int) -> str:
    return f"figure{figure}/"


def _figure_spec(figure: Figure) -> mujoco.MjSpec:
    spec = build_spec(figure.subject)
    rgba = [*figure.color, figure.opacity]
    spec.add_material(name="skin", rgba=rgba, specular=0.25, shininess=0.35)
    for geom in spec.geoms:
        geom.material = "skin"
        geom.size[0] *= figure.girth
    if figure.looks:
        add_looks(spec, figure.subject, "skin", figure.girth)
    if figure.axes:
        for mount in figure.subject.mounts:
            body = spec.body(mount.bone)
            _add_axes(body, np.array(mount.position), np.array(mount.quaternion))
    return spec


def _add_axes(body: Any, position: Float[ndarray, " 3"], quaternion: Float[ndarray, " 4"]) -> None:
    """Three colored sticks, x red, y green, z blue, and a small case where they meet."""
    turn = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
    for axis, color in zip(turn.T, _AXIS_COLORS, strict=True):
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=[*position, *(position + _AXIS_LENGTH * axis)],
            size=[_AXIS_RADIUS, 0, 0],
            rgba=[*color, 1.0],
            contype=0,
            conaffinity=0,
        )
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=position,
        quat=quaternion,
        size=[0.018, 0.018, 0.018],
        rgba=[0.16, 0.17, 0.19, 1.0],
        contype=0,
        conaffinity=0,
    )


def _add_surroundings(spec: mujoco.MjSpec, floor: float) -> None:
    visual: Any = spec.visual  # its parts are structures whose fields the stubs do not know
    visual.global_.offwidth, visual.global_.offheight = 3840, 2160
    visual.quality.shadowsize, visual.quality.offsamples = 2048, 8
    # Roundness that the eye does not miss; without graphics hardware it is half the time.
    visual.quality.numslices, visual.quality.numstacks, visual.quality.numquads = 20, 10, 2
    visual.headlight.ambient = [0.50, 0.50, 0.51]
    visual.headlight.diffuse = [0.30, 0.30, 0.30]
    visual.headlight.specular = [0.0, 0.0, 0.0]
    visual.rgba.haze = [*_HAZE, 1.0]
    visual.rgba.fog = [*_HAZE, 1.0]
    visual.map.fogstart, visual.map.fogend = 2.5, 7.0
    visual.map.znear, visual.map.zfar, visual.map.shadowclip = 0.01, 40.0, 1.5
    # Distances above are in units of the extent: keep it a person's whatever the scene.
    spec.stat.extent = 2.0
    spec.stat.center = [0.0, 0.0, floor + 1.0]
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=_SKY,
        rgb2=_HAZE,
        width=256,
        height=256 * 6,
    )
    spec.add_texture(
        name="floor",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=[0.93, 0.915, 0.89],
        rgb2=[0.86, 0.845, 0.82],
        markrgb=[0.96, 0.95, 0.93],
        width=512,
        height=512,
    )
    material = spec.add_material(name="floor", texrepeat=[1.0, 1.0], texuniform=True, specular=0.0)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        pos=[0.0, 0.0, floor],
        size=[0.0, 0.0, 0.05],
        material="floor",
        contype=0,
        conaffinity=0,
    )


def _add_sun(spec: mujoco.MjSpec, floor: float) -> None:
    """A light that can be moved and turned, on a body of its own; the last mocap body."""
    half = 0.5 * _SUN_AZIMUTH
    sun = spec.worldbody.add_body(
        name="sun",
        mocap=True,
        pos=[0.0, 0.0, floor + 1.0],
        quat=[np.cos(half), 0.0, 0.0, np.sin(half)],
    )
    direction = np.array([0.43, 0.0, -1.0])
    sun.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=-4.0 * direction / np.linalg.norm(direction),
        dir=direction,
        diffuse=[0.40, 0.395, 0.38],
        specular=[0.25, 0.25, 0.25],
        castshadow=True,
    )
