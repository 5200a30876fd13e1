"""Cameras: every preset sees the side of the body that it is named for."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from localreg.view.cameras import PRESETS, Preset, followed, heading, look_from
from localreg.view.moment import Observer
from tests.localreg.view.walking import walking

STANDING = walking().qpos[0]


def turned(qpos: np.ndarray, yaw: float) -> np.ndarray:
    qpos = qpos.copy()
    turn = Rotation.from_euler("z", yaw) * Rotation.from_quat(qpos[3:7], scalar_first=True)
    qpos[3:7] = turn.as_quat(scalar_first=True)
    return qpos


@pytest.mark.parametrize("yaw", [0.0, 0.7, math.pi, -2.2])
def test_a_body_faces_where_it_was_turned(yaw: float) -> None:
    found = heading(turned(STANDING, yaw))
    assert found is not None
    # Unturned it faces world -y.
    assert math.remainder(found - (yaw - math.pi / 2), math.tau) == pytest.approx(0.0, abs=1e-9)


def test_who_lies_faces_nowhere() -> None:
    lying = STANDING.copy()
    lying[3:7] = 1.0, 0.0, 0.0, 0.0  # y up in the root's frame is now horizontal, z is up
    assert heading(lying) is None
    assert look_from("front", lying, facing=1.0).azimuth == pytest.approx(1.0 + math.pi)


@pytest.mark.parametrize("yaw", [0.0, 1.9])
@pytest.mark.parametrize("preset", PRESETS)
def test_presets_see_the_side_that_they_are_named_for(preset: Preset, yaw: float) -> None:
    qpos = turned(STANDING, yaw)
    observer = Observer(walking().subject)
    trackers = dict(zip(observer.subject.trackers, observer.worn(0.0, qpos).positions, strict=True))
    camera = look_from(preset, qpos)
    names = ("lhand", "rhand", "head", "lankle")
    pixels, depth = camera.project(np.array([trackers[name] for name in names]), 1280, 720)
    left, right, head, ankle = pixels
    assert np.all((pixels > 0) & (pixels < [1280, 720])), "all of it is in the picture"
    if preset in ("front", "follow"):
        assert left[0] > right[0]
    elif preset == "back":
        assert left[0] < right[0]
    elif preset == "left":
        assert depth[0] < depth[1]
    elif preset == "right":
        assert depth[0] > depth[1]
    if preset == "top":
        assert depth[2] < depth[3]
    else:
        assert head[1] < ankle[1]


def test_projection_is_mujocos() -> None:
    camera = look_from("follow", STANDING)
    pixels, depth = camera.project(np.array([camera.target]), 640, 480)
    np.testing.assert_allclose(pixels, [[320, 240]])
    np.testing.assert_allclose(depth, camera.distance)
    # Half the height away at 45 degrees of view is the upper edge.
    above = np.array(camera.target)
    up = np.array([
        -math.sin(camera.elevation) * math.cos(camera.azimuth),
        -math.sin(camera.elevation) * math.sin(camera.azimuth),
        math.cos(camera.elevation),
    ])  # fmt: skip
    above += camera.distance * math.tan(math.radians(22.5)) * up
    np.testing.assert_allclose(camera.project(above[None], 640, 480)[0], [[320, 0]], atol=1e-9)


def test_a_camera_comes_along_softly_and_arrives() -> None:
    camera = look_from("follow", STANDING)
    gone = turned(STANDING, 1.0)
    gone[:2] += 2.0
    assert followed(camera, gone, 0.0, turning=True) == camera
    soon = followed(camera, gone, 0.1, turning=True)
    assert 0.0 < soon.target[0] - camera.target[0] < 2.0
    assert 0.0 < soon.azimuth - camera.azimuth < 1.0
    for _ in range(200):
        camera = followed(camera, gone, 0.1, turning=True)
    wanted = look_from("follow", gone)
    np.testing.assert_allclose(camera.target, wanted.target, atol=1e-6)
    assert math.remainder(camera.azimuth - wanted.azimuth, math.tau) == pytest.approx(0, abs=1e-6)
    assert followed(camera, STANDING, 9.0, turning=False).azimuth == camera.azimuth


def test_narrow_pictures_are_taken_from_farther_away() -> None:
    wide, narrow = (look_from("front", STANDING, aspect=aspect) for aspect in (2.0, 0.5))
    assert narrow.distance > 1.3 * wide.distance
