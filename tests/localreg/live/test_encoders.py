"""What goes over the wire, read by other people's parsers."""

import json

import numpy as np
import pytest
from pythonosc.osc_bundle import OscBundle as ParsedBundle
from pythonosc.osc_message import OscMessage
from scipy.spatial.transform import Rotation

from localreg.body.skeleton import BODY_NAMES, DOF_NAMES
from localreg.body.subject import canonical_subject
from localreg.live.body_frames import ForwardKinematics
from localreg.live.sinks.osc_bundle import Message, OscBundle
from localreg.live.sinks.udp_json import JsonEncoder
from localreg.live.sinks.vmc import VmcEncoder
from localreg.live.sinks.vrchat import TRACKERS, VrchatEncoder
from localreg.live.unity import HUMAN_BONES, HUMAN_PARENTS
from tests.localreg.live.poses import live_pose, random_qpos

SUBJECT = canonical_subject()


def messages(datagram: bytes) -> list[OscMessage]:
    assert ParsedBundle.dgram_is_bundle(datagram)
    return list(ParsedBundle(datagram))


def test_a_bundle_holds_what_it_is_filled_with():
    bundle = OscBundle([Message("/a", ("name", 7), 2), Message("/b"), Message("/c/d", (), 3)])
    values = np.arange(5) / 4
    for _ in range(2):
        first, second, third = messages(bundle.fill(values))
        assert (first.address, first.params) == ("/a", ["name", 7, 0.0, 0.25])
        assert (second.address, second.params) == ("/b", [])
        assert (third.address, third.params) == ("/c/d", [0.5, 0.75, 1.0])
        values = values[::-1].copy()[::-1]


@pytest.mark.parametrize("count", [4, 6])
def test_a_bundle_refuses_another_number_of_floats(count: int):
    with pytest.raises(ValueError, match="5 floats"):
        OscBundle([Message("/a", (), 5)]).fill(np.zeros(count))


def test_vmc_frames_put_together_again_are_our_kinematics():
    qpos = random_qpos(3)
    encode = VmcEncoder(SUBJECT)
    encode(live_pose(SUBJECT, qpos, 0))
    datagrams = encode(live_pose(SUBJECT, qpos, 20))
    assert all(len(d) < 1400 for d in datagrams)
    every = [m for d in datagrams for m in messages(d)]
    assert [m.params for m in every if m.address == "/VMC/Ext/OK"] == [[1]]
    assert [m.params for m in every if m.address == "/VMC/Ext/T"] == [[0.5]]
    (root,) = [m.params for m in every if m.address == "/VMC/Ext/Root/Pos"]
    assert root == ["root", 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    bones = {m.params[0]: m.params[1:] for m in every if m.address == "/VMC/Ext/Bone/Pos"}
    assert set(bones) == set(HUMAN_BONES)
    frames = ForwardKinematics(SUBJECT)(qpos)
    places, turns = {}, {}
    for name in HUMAN_BONES:
        p, turn = np.array(bones[name][:3]), Rotation.from_quat(bones[name][3:])
        parent = HUMAN_PARENTS.get(name)
        places[name] = p if parent is None else places[parent] + turns[parent].apply(p)
        turns[name] = turn if parent is None else turns[parent] * turn
        x, y, z = frames.positions[BODY_NAMES.index(HUMAN_BONES[name])]
        np.testing.assert_allclose(places[name], [-y, z, x], atol=1e-5)


def test_vmc_sends_the_trackers_that_were_measured():
    live = live_pose(SUBJECT, random_qpos(4))
    mask = live.frame.orientation_mask.copy()
    mask[2] = False
    live = live._replace(frame=live.frame._replace(orientation_mask=mask))
    every = [m for d in VmcEncoder(SUBJECT)(live) for m in messages(d)]
    trackers = {m.params[0]: m.params[1:] for m in every if m.address == "/VMC/Ext/Tra/Pos"}
    assert list(trackers) == [n for n in SUBJECT.trackers if n != SUBJECT.trackers[2]]
    x, y, z = live.frame.positions[0]
    np.testing.assert_allclose(trackers[SUBJECT.trackers[0]][:3], [-y, z, x], atol=1e-6)
    # Their own axes are converted one by one as the world's are.
    turn = Rotation.from_quat(trackers[SUBJECT.trackers[0]][3:]).as_matrix()
    to_unity = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    ours = Rotation.from_quat(live.frame.quaternions[0], scalar_first=True).as_matrix()
    np.testing.assert_allclose(turn, to_unity @ ours @ to_unity.T, atol=1e-6)


def test_vrchat_trackers_are_bones_in_unity_axes():
    qpos = random_qpos(5)
    (datagram,) = VrchatEncoder(SUBJECT)(live_pose(SUBJECT, qpos))
    sent = {m.address: m.params for m in messages(datagram)}
    assert len(sent) == 2 * len(TRACKERS)
    frames = ForwardKinematics(SUBJECT)(qpos)
    for number, human in TRACKERS.items():
        x, y, z = frames.positions[BODY_NAMES.index(HUMAN_BONES[human])]
        position = sent[f"/tracking/trackers/{number}/position"]
        np.testing.assert_allclose(position, [-y, z, x], atol=1e-5)
        assert np.abs(sent[f"/tracking/trackers/{number}/rotation"]).max() <= 180.0
    turn = np.array(sent["/tracking/trackers/1/rotation"])
    hips = Rotation.from_euler("YXZ", turn[[1, 0, 2]], degrees=True).as_matrix()
    # Unity's right, up and forward: the body's own are those columns of the root's matrix.
    to_unity = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    root = Rotation.from_quat(qpos[3:7], scalar_first=True).as_matrix()
    own = np.stack([-root[:, 0], root[:, 1], root[:, 2]], axis=1)
    np.testing.assert_allclose(hips, to_unity @ own, atol=1e-5)


def test_json_has_every_joint_and_bone():
    qpos = random_qpos(6)
    (datagram,) = JsonEncoder(SUBJECT)(live_pose(SUBJECT, qpos, 7, held=True))
    document = json.loads(datagram)
    assert (document["schema"], document["instant"], document["held"]) == (1, 7, True)
    assert document["time"] == pytest.approx(100.175)
    np.testing.assert_allclose([document["joints"][n] for n in DOF_NAMES], qpos[7:], atol=6e-6)
    np.testing.assert_allclose(document["bones"]["root"], qpos[:7], atol=6e-6)
    assert list(document["bones"]) == list(BODY_NAMES)
    assert len(datagram) < 8000
