"""Pictures and videos without a display: who is on them, and how many there are."""

from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest

from localreg.body.skeleton import DOF_NAMES
from localreg.drawing import offscreen
from localreg.drawing.offscreen import ADVICE, working_backend
from localreg.drawing.scene import GREEN
from localreg.errors import LocalregError
from localreg.view.footage import Footage
from localreg.view.pictures import (
    Feature,
    Shot,
    Studio,
    video_rate,
    video_times,
    write_png,
    write_video,
)
from localreg.view.scene import Style
from tests.localreg.view.walking import walking

FOOTAGE = Footage(walking(1.0)).on_floor()
BARE = Style(measured=False, predicted=False, errors=False, trails=False)
SMALL = Shot(160, 120, "front", BARE, words=False)


@pytest.fixture(autouse=True)
def _graphics() -> None:
    if not working_backend():
        pytest.skip(ADVICE)


def share(picture: np.ndarray, channel: int) -> float:
    """Share of the pixels in which one color is well above the others."""
    others = np.delete(picture.astype(int), channel, axis=2).max(axis=2)
    return float((picture[..., channel].astype(int) - others > 25).mean())


def picture_of(footage: Footage, shot: Shot, time: float = 0.3) -> np.ndarray:
    with Studio([Feature(footage)], shot) as studio:
        return studio.picture(time)


def test_the_body_is_blue_and_looks_as_asked_for() -> None:
    pictures = {
        look: picture_of(FOOTAGE, replace(SMALL, style=replace(BARE, look=look)))
        for look in ("capsules", "sticks", "diamonds")
    }
    shares = {look: share(picture, 2) for look, picture in pictures.items()}
    assert 0.5 > shares["capsules"] > 1.5 * shares["diamonds"]
    assert shares["diamonds"] > shares["sticks"] > 0.005


def test_a_ghost_is_green_and_is_seen_where_it_differs() -> None:
    apart = FOOTAGE.motion.qpos.copy()
    apart[:, 7 + DOF_NAMES.index("lhumerusrz")] += 1.5
    ghost = replace(FOOTAGE.motion, qpos=apart)
    alone = share(picture_of(FOOTAGE, SMALL), 1)
    same = share(picture_of(replace(FOOTAGE, ghost=FOOTAGE.motion), SMALL), 1)
    other = share(picture_of(replace(FOOTAGE, ghost=ghost), SMALL), 1)
    assert other > 0.0015
    assert alone == same < 0.1 * other, "a ghost in the same place is not seen at all"


def test_two_bodies_stand_side_by_side() -> None:
    features = [Feature(FOOTAGE, GREEN, "truth"), Feature(FOOTAGE, caption="synthesis")]
    with Studio(features, SMALL) as studio:
        picture = studio.picture(0.2)
    assert picture.shape == (120, 160, 3)
    left, right = picture[:, :78], picture[:, 82:]
    assert np.all(picture[:, 78:82] == 255)
    assert share(left, 1) > 0.05 > share(left, 2)
    assert share(right, 2) > 0.05 > share(right, 1)


def test_trackers_trails_and_words_are_seen() -> None:
    plain = picture_of(FOOTAGE, SMALL, 0.5).astype(int)
    for shot in (
        replace(SMALL, style=replace(BARE, measured=True)),
        replace(SMALL, style=replace(BARE, trails=True)),
        replace(SMALL, style=replace(BARE, labels=True)),
        replace(SMALL, words=True),
    ):
        changed = np.abs(picture_of(FOOTAGE, shot, 0.5) - plain).max(axis=2) > 30
        assert changed.sum() > 8, shot


def test_the_camera_goes_along() -> None:
    # Walking at 3 m/s past a camera that stood still it would be out of the picture.
    fast = FOOTAGE.motion.qpos.copy()
    fast[:, 1] *= 3.0
    footage = replace(FOOTAGE, motion=replace(FOOTAGE.motion, qpos=fast))
    with Studio([Feature(footage)], replace(SMALL, camera="left")) as studio:
        for time in np.arange(0.0, 0.95, 0.1):
            picture = studio.picture(float(time)).astype(int)
            columns = np.nonzero(picture[..., 2] - picture[..., 0] > 25)[1]
            assert 0.2 * 160 < columns.mean() < 0.8 * 160


@pytest.mark.parametrize(
    ("rate", "expected"), [(120.0, 40.0), (100 / 3, 100 / 3), (40.0, 40.0), (60.0, 30.0)]
)
def test_videos_show_every_frame_or_every_nth(rate: float, expected: float) -> None:
    assert video_rate(Footage(walking(1.0, rate))) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("seconds", "rate", "count"),
    [(59.99166, 30.0, 1800), (1.0, 40.0, 41), (0.0, 40.0, 1), (0.3 - 1e-12, 10.0, 4)],
)
def test_videos_reach_from_the_first_frame_to_the_last(
    seconds: float, rate: float, count: int
) -> None:
    times = video_times(seconds, rate)
    assert len(times) == count
    assert times[0] == 0.0
    assert times[-1] <= seconds + 1e-6


def test_a_video_has_the_size_the_rate_and_the_pictures_that_it_should(tmp_path: Path) -> None:
    path, told = tmp_path / "new" / "walk.mp4", []
    with Studio([Feature(FOOTAGE)], SMALL) as studio:
        count = write_video(studio, path, 10.0, lambda *how: told.append(how))
        first = studio.picture(0.0)
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        assert (stream.codec_context.name, stream.average_rate) == ("h264", 10)
    assert count == len(pictures) == 10
    assert pictures[0].shape == (120, 160, 3)
    assert np.abs(pictures[0].astype(int) - first).mean() < 4.0
    assert np.abs(pictures[0].astype(int) - pictures[7]).mean() > 0.3, "it moves"
    assert [done for done, _, _ in told] == list(range(10))
    assert [file.name for file in path.parent.iterdir()] == ["walk.mp4"]


def test_what_cannot_be_is_said_in_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(LocalregError, match="give even numbers from 64 on"):
        Shot(321, 200)
    with pytest.raises(LocalregError, match="nobody to take a picture of"):
        Studio([])
    blocked = tmp_path / "file"
    blocked.write_text("")
    picture = np.zeros((4, 4, 3), dtype=np.uint8)
    with pytest.raises(LocalregError, match="cannot write"):
        write_png(picture, blocked / "a.png")
    with Studio([Feature(FOOTAGE)], SMALL) as studio:
        for wrong in (blocked / "a.mp4", tmp_path):
            with pytest.raises(LocalregError, match="cannot write"):
                write_video(studio, wrong, 1.0)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["file"]


def test_without_graphics_there_are_sticks_and_advice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(offscreen, "working_backend", lambda wanted="": "")
    shot = replace(SMALL, style=Style(labels=True), words=True)
    with Studio([Feature(replace(FOOTAGE, ghost=FOOTAGE.motion))], shot) as studio:
        picture = studio.picture(0.5)
        assert studio.drawing.backend == "matplotlib"
        assert "apt-get install libegl1" in studio.drawing.note
        assert "libosmesa6" in studio.drawing.note
    assert share(picture, 2) > 0.015
    orange = (picture[..., 0].astype(int) - picture[..., 2]) > 60
    assert orange.any(), "trails are drawn too"
