"""The state over HTTP: to programs of this machine, to nobody else."""

import contextlib
import http.client
import json
from collections.abc import Iterator

import pytest

from localreg.errors import LocalregError
from localreg.live.status_server import StatusServer


@pytest.fixture
def asked() -> list[str]:
    return []


@pytest.fixture
def server(asked: list[str]) -> Iterator[StatusServer]:
    server = StatusServer(0)
    server.start(lambda: {"state": "running"}, lambda: asked.append("recenter"))
    with contextlib.closing(server):
        yield server


def request(server: StatusServer, method: str, path: str, **headers: str) -> tuple[int, dict]:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=20.0)
    with contextlib.closing(connection):
        connection.request(method, path, headers=headers)
        response = connection.getresponse()
        return response.status, json.loads(response.read())


def test_the_state_is_json(server: StatusServer):
    assert request(server, "GET", "/") == (200, {"state": "running"})


def test_recentering_is_asked_for_by_post_only(server: StatusServer, asked: list[str]):
    assert request(server, "GET", "/recenter")[0] == 404
    assert asked == []
    assert request(server, "POST", "/recenter")[0] == 202
    assert asked == ["recenter"]


@pytest.mark.parametrize(
    "headers",
    [{"Origin": "https://example.org"}, {"Origin": "null"}, {"Host": "example.org"}, {"Host": ""}],
)
@pytest.mark.parametrize(("method", "path"), [("GET", "/"), ("POST", "/recenter")])
def test_web_pages_are_refused(
    headers: dict[str, str], method: str, path: str, server: StatusServer, asked: list[str]
):
    assert request(server, method, path, **headers)[0] == 403
    assert asked == []


@pytest.mark.parametrize("path", ["/etc/passwd", "/../", "/status", "/recenter/x"])
def test_there_is_nothing_else(path: str, server: StatusServer):
    assert request(server, "GET", path)[0] == 404
    assert request(server, "POST", path)[0] == 404


def test_a_taken_port_is_named(server: StatusServer):
    with pytest.raises(LocalregError, match=rf"127\.0\.0\.1:{server.port}.*in use.*--status-port"):
        StatusServer(server.port)


def test_the_port_is_free_again_after_closing(server: StatusServer):
    server.close()
    server.close()
    with contextlib.closing(StatusServer(server.port)):
        pass
