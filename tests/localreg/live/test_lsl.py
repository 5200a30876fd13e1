"""The stream of the Lab Streaming Layer, received by the layer's own inlet."""

import os
import time

import numpy as np
import pytest

from localreg.body.skeleton import BODY_NAMES
from localreg.body.subject import canonical_subject
from localreg.live.body_frames import ForwardKinematics
from tests.localreg.live.poses import live_pose, random_qpos

pylsl = pytest.importorskip("pylsl")

SUBJECT = canonical_subject()


def test_an_inlet_receives_poses_and_what_they_mean():
    from localreg.live.sinks.lsl import Lsl

    name = f"MoCap test {os.getpid()}"
    sink = Lsl(SUBJECT, 40.0, name)
    try:
        found = pylsl.resolve_byprop("name", name, timeout=20.0)
        assert len(found) == 1
        inlet = pylsl.StreamInlet(found[0])
        info = inlet.info(timeout=20.0)
        assert (info.type(), info.channel_count(), info.nominal_srate()) == ("MoCap", 217, 40.0)
        channel = info.desc().child("channels").child("channel")
        kinds = []
        for _ in range(7):
            kinds.append((channel.child_value("type"), channel.child_value("unit")))
            assert channel.child_value("object") == "root"
            channel = channel.next_sibling()
        assert [kind for kind, _ in kinds] == [
            "PositionX", "PositionY", "PositionZ",
            "OrientationA", "OrientationB", "OrientationC", "OrientationD",
        ]  # fmt: skip
        assert [unit for _, unit in kinds] == ["meters"] * 3 + ["quaternion"] * 4
        inlet.open_stream(timeout=20.0)
        qpos = random_qpos(1)
        live = live_pose(SUBJECT, qpos)
        before = pylsl.local_clock()
        captured = time.monotonic() - 0.5
        sink.publish(live._replace(frame=live.frame._replace(time=captured)))
        sample, stamp = inlet.pull_sample(timeout=20.0)
        assert before - 0.6 < stamp < pylsl.local_clock() - 0.4
        frames = ForwardKinematics(SUBJECT)(qpos)
        expected = np.hstack([frames.positions, frames.quaternions])
        np.testing.assert_allclose(np.reshape(sample, (len(BODY_NAMES), 7)), expected, atol=1e-5)
        inlet.close_stream()
    finally:
        sink.close()
