"""Pictures without a display, with graphics and without."""

import os
import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest

from localreg.body.skeleton import QPOS_SIZE
from localreg.body.subject import canonical_subject
from localreg.drawing import offscreen
from localreg.drawing.offscreen import ADVICE, Camera, Canvas, Drawing, open_canvas, working_backend
from localreg.drawing.scene import Figure, Scene, build_scene
from localreg.drawing.sticks import StickCanvas

WIDTH, HEIGHT = 120, 200
AHEAD = Camera((0.0, 0.0, 0.9), azimuth=np.pi / 2, elevation=-0.1, distance=2.6)
AWAY = Camera((0.0, 0.0, 0.9), azimuth=np.pi / 2, elevation=-0.1, distance=0.5)
BLUE = (0.1, 0.2, 0.9)


def standing(x: float = 0.0, y: float = 0.0) -> np.ndarray:
    qpos = np.zeros(QPOS_SIZE)
    qpos[:7] = [x, y, 1.0, 0.5**0.5, 0.5**0.5, 0.0, 0.0]
    return qpos


def blueness(picture: np.ndarray) -> np.ndarray:
    return picture[..., 2].astype(int) - picture[..., 0]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return build_scene([Figure(canonical_subject(), BLUE)])


@pytest.fixture(params=["solid", "sticks"])
def canvas(request: pytest.FixtureRequest, scene: Scene) -> Iterator[Canvas]:
    if request.param == "sticks":
        canvas: Canvas = StickCanvas(scene, WIDTH, HEIGHT, Drawing("matplotlib", ADVICE))
    elif not working_backend():
        pytest.skip(ADVICE)
    else:
        canvas = open_canvas(scene, WIDTH, HEIGHT)
    with canvas:
        yield canvas


def test_the_body_is_in_the_middle_of_the_picture(canvas: Canvas) -> None:
    empty = canvas.draw([standing(x=500.0)], AHEAD)
    picture = canvas.draw([standing()], AHEAD)
    assert picture.shape == (HEIGHT, WIDTH, 3)
    assert picture.dtype == np.uint8
    changed = np.abs(picture.astype(int) - empty).max(axis=-1) > 40
    blue = changed & (blueness(picture) > 60)
    assert 0.03 < blue.mean() < 0.5
    rows, columns = np.nonzero(blue)
    assert abs(columns.mean() - WIDTH / 2) < 0.06 * WIDTH
    # Arms reach sideways in the rest pose; from head to foot it nearly fills the height.
    assert np.ptp(rows) > 0.6 * HEIGHT
    assert (blueness(empty) > 60).mean() < 0.01


def test_left_is_on_the_side_where_it_should_be(canvas: Canvas) -> None:
    """Looking along +y at a body moved to +x: it is on the right of the picture."""
    picture = canvas.draw([standing(x=0.35)], AHEAD)
    _, columns = np.nonzero(blueness(picture) > 60)
    assert columns.mean() > WIDTH / 2 + 10


def test_drawing_twice_gives_the_same(canvas: Canvas) -> None:
    first = canvas.draw([standing()], AHEAD)
    canvas.draw([standing(y=3.0)], AWAY)
    np.testing.assert_array_equal(canvas.draw([standing()], AHEAD), first)


def test_a_body_behind_the_camera_is_not_seen(canvas: Canvas) -> None:
    picture = canvas.draw([standing(y=-30.0)], AHEAD)
    assert (blueness(picture) > 60).mean() < 0.01


def test_both_ways_of_drawing_agree_on_perspective(scene: Scene) -> None:
    if not working_backend():
        pytest.skip(ADVICE)
    camera = Camera((0.1, -0.2, 1.0), azimuth=0.7, elevation=-0.3, distance=3.0)
    with open_canvas(scene, WIDTH, HEIGHT) as solid:
        one = blueness(solid.draw([standing()], camera)) > 60
    two = (
        blueness(
            StickCanvas(scene, WIDTH, HEIGHT, Drawing("matplotlib")).draw([standing()], camera)
        )
        > 60
    )
    assert (one & two).sum() > 0.8 * (one | two).sum() - 60


def test_an_invisible_body_is_not_drawn() -> None:
    scene = build_scene(
        [Figure(canonical_subject(), BLUE), Figure(canonical_subject(), (1.0, 0.0, 0.0), 0.0)]
    )
    canvases = [StickCanvas(scene, WIDTH, HEIGHT, Drawing("matplotlib"))]
    if working_backend():
        canvases.append(open_canvas(scene, WIDTH, HEIGHT))
    for canvas in canvases:
        alone = canvas.draw([standing(), standing(x=800.0)], AHEAD)
        both = canvas.draw([standing(), standing(y=-0.5)], AHEAD)
        assert np.abs(alone.astype(int) - both).mean() < 0.5
        canvas.close()


def test_a_closed_canvas_says_so(scene: Scene) -> None:
    if not working_backend():
        pytest.skip(ADVICE)
    canvas = open_canvas(scene, WIDTH, HEIGHT)
    canvas.close()
    canvas.close()
    with pytest.raises(RuntimeError, match="was closed"):
        canvas.draw([standing()], AHEAD)


@pytest.mark.parametrize("off", ["disabled", "off", "0"])
def test_graphics_can_be_turned_off(
    scene: Scene, monkeypatch: pytest.MonkeyPatch, off: str
) -> None:
    monkeypatch.setenv("MUJOCO_GL", off)
    with open_canvas(scene, WIDTH, HEIGHT) as canvas:
        assert canvas.drawing == Drawing("matplotlib", ADVICE)
        assert (blueness(canvas.draw([standing()], AHEAD)) > 60).mean() > 0.03


def test_backends_are_tried_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[str] = []

    def works(backend: str) -> bool:
        tried.append(backend)
        return backend == "osmesa"

    choose = working_backend.__wrapped__
    monkeypatch.setattr(offscreen, "_works", works)
    monkeypatch.delenv("PYOPENGL_PLATFORM", raising=False)
    assert choose("") == "osmesa"
    assert tried == ["egl", "osmesa"]
    assert choose("glfw") == "osmesa"
    assert choose("egl") == ""
    assert choose("OSMesa ") == "osmesa"
    monkeypatch.setenv("PYOPENGL_PLATFORM", "egl")
    assert choose("") == "", "what the process has loaded cannot be exchanged"


def test_the_advice_names_the_packages_in_one_line() -> None:
    assert "libegl1" in ADVICE
    assert "libopengl0" in ADVICE
    assert "libgl1-mesa-dri" in ADVICE
    assert "libosmesa6" in ADVICE
    assert "\n" not in ADVICE


PICTURE_WITHOUT_GRAPHICS = """
import ctypes, ctypes.util, sys
# No library of graphics can be found or opened, here or in the process that probes.
import numpy as np
from localreg.body.subject import canonical_subject
from localreg.drawing.offscreen import Camera, open_canvas
from localreg.drawing.scene import Figure, build_scene
pose = np.zeros(63)
pose[2:4], pose[4] = (1.0, 0.5**0.5), 0.5**0.5
with open_canvas(build_scene([Figure(canonical_subject())]), 60, 100) as canvas:
    picture = canvas.draw([pose], Camera((0.0, 0.0, 0.9)))
print(canvas.drawing.backend, int(picture.std() > 5), canvas.drawing.note)
"""


def test_a_machine_without_graphics_still_gets_a_picture(tmp_path) -> None:
    """PyOpenGL finds no library: probing fails for EGL and OSMesa, sticks are drawn."""
    # Python runs sitecustomize at its start, in the probes too.
    (tmp_path / "sitecustomize.py").write_text(
        "import ctypes\n"
        "_load = ctypes.CDLL.__init__\n"
        "def _init(self, name, *args, **kwargs):\n"
        "    if name and any(x in str(name) for x in ('GL', 'OSMesa')):\n"
        "        raise OSError(f'{name}: cannot open shared object file')\n"
        "    _load(self, name, *args, **kwargs)\n"
        "ctypes.CDLL.__init__ = _init\n"
    )
    environment = {
        k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")
    }
    environment["PYTHONPATH"] = str(tmp_path)
    run = subprocess.run(
        [sys.executable, "-c", PICTURE_WITHOUT_GRAPHICS],
        env=environment, capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    assert run.stdout.strip() == f"matplotlib 1 {ADVICE}"
