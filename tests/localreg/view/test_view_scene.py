"""What is drawn of a moment, as geoms and as pixels."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from localreg.drawing.looks import LOOK_GROUPS, LOOKS
from localreg.view.moment import Moment, Observer
from localreg.view.scene import (
    Block,
    Mark,
    Rod,
    Style,
    build_stage,
    draw,
    geoms,
    marks,
    show_look,
)
from tests.localreg.view.walking import walking

MOTION = walking()
SUBJECT = MOTION.subject


def moment_with(off: float = 0.0, masked: tuple[int, ...] = ()) -> Moment:
    observer = Observer(SUBJECT)
    frame = observer.worn(0.0, MOTION.qpos[0])
    seen = np.array([i not in masked for i in range(len(SUBJECT.trackers))])
    frame = frame._replace(
        positions=frame.positions + np.array([off, 0.0, 0.0]),
        position_mask=seen,
        orientation_mask=seen,
    )
    return observer.observe(0.0, MOTION.qpos[0], frame)


def rods_from(found: list[Mark], start: np.ndarray) -> list[Rod]:
    return [mark for mark in found if isinstance(mark, Rod) and mark.start is start]


def test_each_tracker_has_measured_and_predicted_axes_and_its_error() -> None:
    moment = moment_with(off=0.05)
    found = marks(moment)
    for tracker in moment.trackers:
        case = [m for m in found if isinstance(m, Block) and m.position is tracker.position]
        assert len(case) == 1
        starts = rods_from(found, tracker.position)
        # Three measured axes and the error's line, which ends where the body has the tracker.
        assert len(starts) == 4
        assert sum(rod.end is tracker.predicted_position for rod in starts) == 1
        predicted = [
            m for m in found if isinstance(m, Rod) and m.start is tracker.predicted_position
        ]
        assert len(predicted) == 3
    assert len(marks(moment, Style(errors=False))) == len(found) - 6
    assert marks(moment, Style(measured=False, predicted=False, errors=False)) == []
    assert len(marks(moment_with(off=0.0))) == len(found) - 6, "no error, no line"


def test_masked_trackers_are_gray_and_stay_with_the_body() -> None:
    moment = moment_with(off=0.3, masked=(2,))
    tracker = moment.trackers[2]
    mine = [
        m
        for m in marks(moment)
        if isinstance(m, Block) and m.position is tracker.predicted_position
    ]
    assert len(mine) == 1
    colors = {mark.color for mark in marks(moment) if isinstance(mark, Rod)
              and mark.start is tracker.predicted_position}  # fmt: skip
    for red, green, blue, opacity in (*colors, mine[0].color):
        assert max(red, green, blue) - min(red, green, blue) < 0.05
        assert opacity < 1.0


def test_marks_become_the_same_geoms_in_a_scene_and_in_a_list() -> None:
    stage = build_stage(SUBJECT)
    found = marks(moment_with(off=0.05), Style(labels=True))
    scene = mujoco.MjvScene(stage.model, maxgeom=len(found))
    draw(scene, found)
    listed = geoms(found)
    assert scene.ngeom == len(listed) == len(found)
    for index, (mark, geom) in enumerate(zip(found, listed, strict=True)):
        other = scene.geoms[index]
        np.testing.assert_array_equal(geom.pos, other.pos)
        np.testing.assert_array_equal(geom.rgba, np.float32(mark.color))
        assert geom.type == other.type
        if isinstance(mark, Rod):
            ends = geom.pos + np.outer([-1, 1], geom.mat[:, 2]) * geom.size[2]
            np.testing.assert_allclose(ends, [mark.start, mark.end], atol=1e-6)
        else:
            np.testing.assert_allclose(geom.pos, mark.position, atol=1e-6)
            assert geom.label == mark.label
    draw(scene, found)
    assert scene.ngeom == len(found), "a full scene takes no more"


def test_every_look_has_shapes_of_its_own_that_weigh_nothing() -> None:
    model = build_stage(SUBJECT).model
    option = mujoco.MjvOption()
    seen: list[set[int]] = []
    for look in LOOKS:
        show_look(option, look)
        groups = {group for group in LOOK_GROUPS.values() if option.geomgroup[group]}
        assert groups == {LOOK_GROUPS[look]}
        seen.append(set(np.flatnonzero(model.geom_group == LOOK_GROUPS[look]).tolist()))
    assert all(len(geoms) >= 25 for geoms in seen)
    assert not (seen[0] & seen[1]) | (seen[1] & seen[2]) | (seen[0] & seen[2])
    alone = build_stage(SUBJECT).model.body_mass
    np.testing.assert_array_equal(model.body_mass, alone)


@pytest.mark.parametrize("index", range(0, 30, 7))
def test_a_diamond_reaches_from_one_end_of_its_bone_to_the_other(index: int) -> None:
    model = build_stage(SUBJECT).model
    name, offset = model.body(2 + index).name.removeprefix("figure0/"), SUBJECT.offsets[index]
    mesh = model.mesh(f"figure0/diamond:{name}")
    geom = int(np.flatnonzero(model.geom_dataid == mesh.id)[0])
    rotation = np.empty(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    first = int(mesh.vertadr[0])
    corners = model.mesh_vert[first : first + int(mesh.vertnum[0])]
    corners = corners @ rotation.reshape(3, 3).T + model.geom_pos[geom]
    for end in (np.zeros(3), offset):
        assert np.linalg.norm(corners - end, axis=1).min() < 1e-6
    along = corners @ offset / (offset @ offset)
    assert along.min() > -1e-6
    assert along.max() < 1.0 + 1e-6


def test_a_ghost_is_where_its_pose_is_or_nowhere() -> None:
    stage = build_stage(SUBJECT, SUBJECT)
    data = mujoco.MjData(stage.model)
    moment = replace(moment_with(), ghost=MOTION.qpos[20])
    stage.place(data, moment)
    np.testing.assert_allclose(data.body("figure1/root").xpos, MOTION.qpos[20, :3])
    np.testing.assert_allclose(data.body("figure0/root").xpos, MOTION.qpos[0, :3])
    for hidden, style in ((moment, Style(ghost=False)), (replace(moment, ghost=None), Style())):
        stage.place(data, hidden, style)
        assert data.body("figure1/root").xpos[2] < -500
        # The sun stays with the body that is seen.
        np.testing.assert_allclose(data.body("sun").xpos, MOTION.qpos[0, :3])
