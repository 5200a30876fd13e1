"""Who gets through to the page, by real requests on a real socket."""

import asyncio
import contextlib
import http.client
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
from mujoco.studio.web import web_server
from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.http11 import Response
from websockets.sync.client import ClientConnection, connect

from localreg.body.subject import canonical_subject
from localreg.errors import LocalregError
from localreg.view.process import ViewProcess
from localreg.view.web_guard import LOOPBACK, Guard, bind, guarded
from tests.localreg.view.sockets import listens_on, ports_beyond_loopback

PATIENCE = 30.0
EVERYWHERE = "0.0.0.0"  # noqa: S104  (its guard is tested; nothing is served)


class Page(NamedTuple):
    """A page that is being served by a process of its own."""

    port: int
    url: str
    pid: int


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    with ViewProcess(canonical_subject(), port=0) as process:
        url, is_open = process.wait()
        assert not is_open
        yield Page(int(url.rstrip("/").rpartition(":")[2]), url, process.pid)


class Answer(NamedTuple):
    """What came of a request."""

    status: int
    headers: http.client.HTTPMessage
    body: bytes


def get(page: Page, path: str, **headers: str) -> Answer:
    """One HTTP request."""
    connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=PATIENCE)
    with contextlib.closing(connection):
        connection.putrequest("GET", path, skip_host="Host" in headers)
        for name, value in headers.items():
            connection.putheader(name, value)
        connection.endheaders()
        response = connection.getresponse()
        return Answer(response.status, response.headers, response.read())


def opened(page: Page, path: str, origin: str | None) -> ClientConnection:
    """A WebSocket as a page of some origin opens it."""
    port = page.port
    return connect(f"ws://127.0.0.1:{port}{path}", origin=origin, open_timeout=PATIENCE)  # type: ignore[arg-type]


def until_closed(connection: ClientConnection) -> str:
    """Why the other side closed it."""
    try:
        while True:
            connection.recv(PATIENCE)
    except ConnectionClosed as closed:
        return str(closed)


def test_by_default_nothing_listens_beyond_loopback(page: Page):
    assert listens_on(page.pid, page.port)
    assert not ports_beyond_loopback(page.pid)
    assert not ports_beyond_loopback(os.getpid())


def test_the_page_and_what_it_needs_are_served(page: Page):
    assert b"web_client" in get(page, "/").body
    assert get(page, "/web_client.wasm").headers["Content-Type"] == "application/wasm"
    assert get(page, "/assets/ibl.ktx").status == 200
    assert len(get(page, "/model").body) > 100_000


@pytest.mark.parametrize(
    "path", ["/../web_server.py", "/..%2fweb_server.py", "//etc/passwd", "/%2e%2e/web_server.py",
             "/assets/../../launch_web.py", "/dist/../../viewer.py", "/web_server.py"],
)  # fmt: skip
def test_no_other_file_is_served(page: Page, path: str):
    response = get(page, path)
    assert response.status in (403, 404)
    assert len(response.body) < 100


@pytest.mark.parametrize("path", ["/state?sid=a", "/ui?sid=a"])
@pytest.mark.parametrize(
    "origin",
    [
        "http://example.org", "http://127.0.0.1:1", "http://localhost", "null", "file://", None,
        "http://127.0.0.1.example.org", "http://example.org@127.0.0.1",
    ],
)  # fmt: skip
def test_sockets_of_other_sites_are_refused(page: Page, path: str, origin: str | None):
    with pytest.raises(InvalidStatus) as refused:
        opened(page, path, origin)
    assert refused.value.response.status_code == 403


def test_sockets_of_the_page_itself_are_served(page: Page):
    with opened(page, "/state?sid=b", f"http://127.0.0.1:{page.port}") as state:
        assert "viewers=" in str(state.recv(PATIENCE))


@pytest.mark.parametrize("host", ["example.org", "example.org:{port}", "127.0.0.1", "{evil}", ""])
def test_names_that_others_own_are_refused(page: Page, host: str):
    host = host.format(port=page.port, evil=f"127.0.0.1:{page.port}@example.org")
    response = get(page, "/model", Host=host)
    assert response.status == 403
    assert b"not served" in response.body


def test_localhost_is_a_name_of_the_page(page: Page):
    assert get(page, "/", Host=f"localhost:{page.port}").status == 200


def test_other_sites_may_not_read_the_model(page: Page):
    assert get(page, "/model", Origin="http://example.org").status == 403
    response = get(page, "/model")
    assert response.headers["Access-Control-Allow-Origin"] is None
    assert response.headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert response.headers["X-Frame-Options"] == "DENY"


def test_dropped_models_are_refused(page: Page):
    origin = f"http://127.0.0.1:{page.port}"
    with pytest.raises(InvalidStatus) as refused:
        opened(page, "/drop?sid=c", origin)
    assert refused.value.response.status_code == 403
    assert get(page, "/drop").status == 403


def test_oversized_messages_end_the_connection(page: Page):
    with opened(page, "/state?sid=d", f"http://127.0.0.1:{page.port}") as state:
        state.send(bytes(2 << 20))
        assert until_closed(state)


def test_visitors_see_nothing_of_the_machine(page: Page):
    told = b""
    for path in (
        "/",
        "/model",
        "/nothing",
        "/model?crc32=x",
        "/model?offset_bytes=-1&size_bytes=1",
    ):
        response = get(page, path)
        told += str(response.headers).encode() + response.body
    with opened(page, "/state?sid=e", f"http://127.0.0.1:{page.port}") as state:
        for _ in range(2):
            message = state.recv(PATIENCE)
            told += message if isinstance(message, bytes) else message.encode()
    here = (f"{Path.home()}/", str(Path.cwd()), socket.gethostname(), "websockets/", "Python/3")
    for secret in here:
        assert len(secret) < 3 or secret.encode() not in told, secret


_BREAKS = """
import sys, threading
from localreg.body.subject import canonical_subject
from localreg.view import web_host
from localreg.view.source import Source

class Empty(Source):
    subject = canonical_subject()
    def newest(self):
        return None

def fail(self, go=web_host._Viewer.prepare_next_frame):
    if is_broken.is_set():
        raise RuntimeError("cannot read " + sys.argv[1])
    return go(self)

is_broken = threading.Event()
web_host._Viewer.prepare_next_frame = fail
page = web_host.WebHost(Empty(), port=0)
threading.Thread(target=lambda: sys.stdin.readline() and is_broken.set(), daemon=True).start()
page.run(lambda: print(page.guard.port, flush=True))
"""


def test_why_it_ended_is_not_told_to_visitors():
    secret = "/home/anna/secret.toml"  # noqa: S105
    command = [sys.executable, "-c", _BREAKS, secret]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        port = int(process.stdout.readline())
        page = Page(port, f"http://127.0.0.1:{port}/", process.pid)
        origin = page.url.rstrip("/")
        with opened(page, "/state?sid=f", origin) as state:
            assert state.recv(PATIENCE)
            _, said = process.communicate("break\n", timeout=PATIENCE)
            told = until_closed(state)
    assert secret in said  # on the terminal of whoever serves it, and there alone
    assert "secret" not in told
    assert "Error" not in told


@pytest.mark.parametrize(
    ("bound", "asked", "host", "is_served"),
    [
        ("127.0.0.1", "127.0.0.1", "127.0.0.1:{port}", True),
        ("127.0.0.1", "127.0.0.1", "192.168.1.7:{port}", False),
        ("127.0.0.1", "127.0.0.1", "[::1]:{port}", False),
        (EVERYWHERE, EVERYWHERE, "192.168.1.7:{port}", True),
        (EVERYWHERE, EVERYWHERE, "localhost:{port}", True),
        (EVERYWHERE, EVERYWHERE, "{machine}:{port}", True),
        (EVERYWHERE, EVERYWHERE, "example.org:{port}", False),
        ("127.0.0.1", "127.0.0.1", "{machine}:{port}", False),
        (EVERYWHERE, EVERYWHERE, "192.168.1.7:1", False),
    ],
)  # fmt: skip
def test_which_names_are_served(bound: str, asked: str, host: str, is_served: bool):
    with bind(bound, 0) as sock:
        guard = Guard(sock, asked)
        machine = socket.gethostname()
        host = host.format(port=guard.port, machine=machine)
        refusal = guard.refusal("/", Headers({"Host": host}))
    assert (refusal == "") == is_served
    assert guard.is_open == (bound == EVERYWHERE)


def test_an_open_page_has_an_address_for_this_machine():
    with bind(EVERYWHERE, 0) as sock:
        guard = Guard(sock, EVERYWHERE)
    assert guard.url == f"http://127.0.0.1:{guard.port}/"


def test_addresses_of_other_machines_cannot_be_served():
    with pytest.raises(LocalregError, match="address of this machine"):
        bind("203.0.113.9", 0)
    with pytest.raises(LocalregError, match="address of this machine"):
        bind("no such name", 0)


def test_without_a_port_the_next_free_one_is_taken():
    with bind("127.0.0.1") as first, bind("127.0.0.1") as second:
        assert first.getsockname()[1] != second.getsockname()[1]


def test_another_version_of_the_viewer_is_not_served(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delattr(web_server, "serve")
    refused = pytest.raises(LocalregError, match="version of mujoco")
    with bind("127.0.0.1", 0) as sock, refused, guarded(Guard(sock)):
        pytest.fail("it was served")
    assert web_server.bind_public_socket.__module__ == web_server.__name__


def test_visitors_wait_until_the_viewer_can_bear_them():
    """As a page left open by the last run, which is there as soon as the port is."""
    guard = Guard(bind(LOOPBACK, 0))

    async def nothing(_: object) -> None:
        return

    def hello(connection: ServerConnection, _: object) -> Response:
        return connection.respond(200, "hello")

    page = Page(guard.port, guard.url, os.getpid())

    async def go() -> tuple[bool, int]:
        serving = guard.serve(serve)(
            nothing, sock=guard.sock, process_request=hello, process_response=lambda *_: None
        )
        async with serving:
            asked = asyncio.create_task(asyncio.to_thread(get, page, "/"))
            await asyncio.sleep(0.3)
            waits = not asked.done()
            guard.begun.set()
            return waits, (await asked).status

    assert asyncio.run(go()) == (True, 200)
