"""The filmstrip: a PNG of the right size that shows both bodies and the errors."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from localreg.drawing.filmstrip import filmstrip
from localreg.drawing.offscreen import working_backend
from localreg.errors import LocalregError
from localreg.motion.motion import Motion
from tests.localreg.database.made_motion import make_motion


@pytest.fixture(scope="module")
def truth() -> Motion:
    return make_motion(1, 60, rate=40.0, amplitude=0.15)


@pytest.fixture(scope="module")
def synthesis(truth: Motion) -> Motion:
    qpos = truth.qpos.copy()
    qpos[:, 7:] += 0.05
    return replace(truth, qpos=qpos)


@pytest.fixture(params=["graphics", "no graphics"])
def backend(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    if request.param == "no graphics":
        monkeypatch.setenv("MUJOCO_GL", "disabled")
        return "matplotlib"
    return working_backend() or "matplotlib"


def errors(truth: Motion) -> np.ndarray:
    values = 0.01 + 0.005 * np.sin(np.arange(len(truth)) / 5.0)
    values[:5] = np.nan
    return values


def test_both_bodies_can_be_seen(
    truth: Motion, synthesis: Motion, tmp_path: Path, backend: str
) -> None:
    path = tmp_path / "new" / "strip.png"
    drawing = filmstrip(
        truth, synthesis, path,
        mpjpe=errors(truth), angle_error=3.0 * errors(truth), instants=4, width=700,
    )  # fmt: skip
    assert drawing.backend == backend
    assert bool(drawing.note) == (backend == "matplotlib")
    picture = imread(path)[:, :, :3]
    assert picture.shape[1] == 700
    assert 400 < picture.shape[0] < 900
    # Tiles begin below the title; green is the truth's color, blue the synthesis's.
    red, green, blue = picture[..., 0], picture[..., 1], picture[..., 2]
    top, left = round(84 * 700 / 1800), round(0.042 * 700)
    wide = (700 - 2 * left) // 4
    high = round(min(1.55 * wide, 0.3 * 700))
    for column in range(4):
        columns = slice(left + column * wide + 3, left + (column + 1) * wide - 3)
        upper = (slice(top, top + high), columns)
        lower = (slice(top + high + 4, top + 2 * high), columns)
        greens = (green - np.maximum(red, blue))[upper] > 0.08
        blues = (blue - red)[lower] > 0.2
        assert 0.02 < greens.mean() < 0.6
        assert 0.02 < blues.mean() < 0.6
        assert ((blue - red)[upper] > 0.2).mean() < 0.02
        assert ((green - np.maximum(red, blue))[lower] > 0.08).mean() < 0.02
    plot = picture[top + 2 * high + 60 :]
    assert (plot.max(axis=-1) < 0.99).mean() > 0.02


def test_pictures_can_do_without_angle_errors(truth: Motion, tmp_path: Path) -> None:
    path = tmp_path / "strip.png"
    filmstrip(truth, truth, path, mpjpe=np.full(60, np.nan), instants=2, width=400)
    assert imread(path).std() > 0.05


def test_short_motions_show_every_frame_once(truth: Motion, tmp_path: Path) -> None:
    two, path = truth.first(2), tmp_path / "strip.png"
    filmstrip(two, two, path, mpjpe=np.zeros(2), instants=8, width=400)
    assert path.exists()
    one = truth.first(1)
    filmstrip(one, one, path, mpjpe=np.zeros(1), instants=8, width=400)


def test_what_does_not_fit_is_refused(truth: Motion, tmp_path: Path) -> None:
    path, good = tmp_path / "strip.png", errors(truth)
    with pytest.raises(LocalregError, match="59 frames at 40 Hz, the truth 60"):
        filmstrip(truth, truth.first(59), path, mpjpe=good)
    with pytest.raises(LocalregError, match="60 frames at 30 Hz"):
        filmstrip(truth, replace(truth, rate=30.0), path, mpjpe=good)
    with pytest.raises(LocalregError, match="an error for each"):
        filmstrip(truth, truth, path, mpjpe=good[1:])
    with pytest.raises(LocalregError, match="at least one frame"):
        filmstrip(truth.first(0), truth.first(0), path, mpjpe=good[:0])
    (tmp_path / "file").write_text("")
    with pytest.raises(LocalregError, match="cannot write the picture"):
        filmstrip(truth, truth, tmp_path / "file" / "strip.png", mpjpe=good, instants=1, width=300)
    assert not path.exists()
