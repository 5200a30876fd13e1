"""The body as a VRPN tracker, read back by this project's own VRPN client and by hand."""

import contextlib
import socket
import time

import numpy as np
import pytest

from localreg.body.skeleton import BODY_NAMES
from localreg.body.subject import canonical_subject
from localreg.errors import LocalregError
from localreg.live.body_frames import ForwardKinematics
from localreg.live.sinks.vrpn import VrpnServer
from sensors.protocols import vrpn
from tests.localreg.live.poses import live_pose, random_qpos

SUBJECT = canonical_subject()
PATIENCE = 20.0


class Client:
    """Just enough of a client."""

    def __init__(self, tcp: socket.socket) -> None:
        self.tcp = tcp
        self.tcp.settimeout(PATIENCE)
        self.tcp.sendall(vrpn.COOKIE)
        self.reader = vrpn.MessageReader(with_cookie=True)
        self.names = vrpn.NameTable()
        self.messages: list[vrpn.Message] = []

    def next(self, name: str) -> vrpn.Message:
        """The next message of a type."""
        while True:
            while self.messages:
                message = self.messages.pop(0)
                if not self.names.learn(message) and self.names.types[message.kind] == name:
                    return message
            data = self.tcp.recv(65536)
            assert data, "hung up"
            self.messages += self.reader.feed(data)


@pytest.fixture
def server():
    server = VrpnServer(SUBJECT, port=0)
    with contextlib.closing(server):
        yield server


def publish_until(server: VrpnServer, receive):
    """Publish a pose until a receiver that takes its time to connect has something."""
    qpos = random_qpos(3)
    live = live_pose(SUBJECT, qpos)
    give_up = time.monotonic() + PATIENCE
    while time.monotonic() < give_up:
        server.publish(live._replace(frame=live.frame._replace(time=time.monotonic())))
        if (received := receive()) is not None:
            return qpos, received
    pytest.fail("nothing came")


def poses_of(messages: list[vrpn.Message]) -> dict[int, vrpn.PoseReport]:
    reports = [vrpn.decode_pose(message.payload) for message in messages]
    return {report.sensor: report for report in reports}


def assert_body(reports: dict[int, vrpn.PoseReport], qpos: np.ndarray) -> None:
    frames = ForwardKinematics(SUBJECT)(qpos)
    for sensor in range(len(BODY_NAMES)):
        np.testing.assert_allclose(reports[sensor].position, frames.positions[sensor], atol=1e-12)
        cosine = abs(float(reports[sensor].quaternion @ frames.quaternions[sensor]))
        assert cosine == pytest.approx(1.0, abs=1e-12)


def test_a_client_receives_every_bone_by_tcp(server: VrpnServer):
    client = Client(socket.create_connection(("127.0.0.1", server.port), PATIENCE))
    with contextlib.closing(client.tcp):
        client.tcp.setblocking(False)
        messages: list[vrpn.Message] = []

        def receive():
            time.sleep(0.01)
            with contextlib.suppress(BlockingIOError):
                for message in client.reader.feed(client.tcp.recv(65536)):
                    if not client.names.learn(message):
                        messages.append(message)
            return messages if len(messages) >= 2 * len(BODY_NAMES) else None

        qpos, received = publish_until(server, receive)
        assert client.names.senders[received[0].sender] == "Body0"
        assert {client.names.types[m.kind] for m in received} == {vrpn.POSE}
        assert abs(received[-1].time - time.time()) < PATIENCE
        assert_body(poses_of(received), qpos)


def test_a_classic_client_is_called_back_and_served_by_udp(server: VrpnServer):
    with (
        socket.create_server(("127.0.0.1", 0)) as door,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear,
    ):
        door.settimeout(PATIENCE)
        ear.bind(("127.0.0.1", 0))
        ear.settimeout(0.2)
        request = vrpn.connection_request("127.0.0.1", door.getsockname()[1])
        ear.sendto(request, ("127.0.0.1", server.port))
        client = Client(door.accept()[0])
        with contextlib.closing(client.tcp):
            client.tcp.sendall(vrpn.udp_description("127.0.0.1", ear.getsockname()[1]).encode())
            messages: list[vrpn.Message] = []

            def receive():
                with contextlib.suppress(TimeoutError):
                    datagram = ear.recv(65536)
                    assert len(datagram) <= 1472
                    messages.extend(vrpn.read_datagram(datagram))
                return messages if len(messages) > 2 * len(BODY_NAMES) else None

            qpos, received = publish_until(server, receive)
            assert_body(poses_of(received), qpos)


def test_pings_are_answered(server: VrpnServer):
    client = Client(socket.create_connection(("127.0.0.1", server.port), PATIENCE))
    with contextlib.closing(client.tcp):
        out = vrpn.description(vrpn.SENDER_DESCRIPTION, 4, "Body0").encode()
        out += vrpn.description(vrpn.TYPE_DESCRIPTION, 9, vrpn.PING).encode()
        client.tcp.sendall(out + vrpn.Message(9, 4).encode())
        pong = client.next(vrpn.PONG)
        assert client.names.senders[pong.sender] == "Body0"


def test_nobody_else_is_called(server: VrpnServer):
    with (
        socket.create_server(("127.0.0.2", 0)) as door,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as forger,
    ):
        door.settimeout(0.3)
        forger.bind(("127.0.0.1", 0))
        request = vrpn.connection_request("127.0.0.2", door.getsockname()[1])
        forger.sendto(request, ("127.0.0.1", server.port))
        with pytest.raises(TimeoutError):
            door.accept()


@pytest.mark.parametrize("rubbish", [b"GET / HTTP/1.0\r\n\r\n" * 4, b"\xff" * 100])
def test_rubbish_is_hung_up_on_and_others_are_served(rubbish: bytes, server: VrpnServer):
    with socket.create_connection(("127.0.0.1", server.port), PATIENCE) as stranger:
        stranger.settimeout(PATIENCE)
        stranger.sendall(rubbish)
        with contextlib.suppress(ConnectionResetError):
            while stranger.recv(65536):
                pass
    test_pings_are_answered(server)


def test_a_client_that_does_not_read_is_dropped_and_holds_nobody_up(server: VrpnServer):
    lazy = Client(socket.create_connection(("127.0.0.1", server.port), PATIENCE))
    with contextlib.closing(lazy.tcp):
        live = live_pose(SUBJECT, random_qpos(0))
        longest = 0.0
        for _ in range(200):
            begun = time.monotonic()
            server.publish(live)
            longest = max(longest, time.monotonic() - begun)
        assert longest < 5.0
    test_pings_are_answered(server)


def test_a_taken_port_is_named(server: VrpnServer):
    with pytest.raises(LocalregError, match=rf"127\.0\.0\.1:{server.port} for VRPN.*in use"):
        VrpnServer(SUBJECT, port=server.port)


def test_closing_gives_the_port_back(server: VrpnServer):
    server.close()
    server.close()
    VrpnServer(SUBJECT, port=server.port).close()
