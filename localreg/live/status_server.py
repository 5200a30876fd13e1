"""The state of a run over HTTP, on this machine only: `GET /` and `POST /recenter`.

A web page that the user happens to have open could reach a loopback port, too. So requests
that a browser sends on behalf of a page (they carry an Origin), and those that were led here
under another name (DNS rebinding), are refused.
"""

import http.server
import json
import threading
from collections.abc import Callable
from typing import Any, Final

from localreg.errors import LocalregError

ADDRESS: Final = "127.0.0.1"
"""The only address it listens on."""

_PATIENCE: Final = 2.0
"""Longest wait for a request, so that nobody holds a thread [s]."""


class StatusServer:
    """Takes its port at once and answers from `start` on, in threads of its own.

    Args:
        port: TCP port on 127.0.0.1, 0 for any free one.

    Attributes:
        port: the port it listens on.

    Raises:
        LocalregError: the port is taken.
    """

    def __init__(self, port: int) -> None:
        try:
            self._server = _Server((ADDRESS, port), _Handler)
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise LocalregError(
                f"cannot listen on {ADDRESS}:{port}: {reason}; give another --status-port"
            ) from error
        self.port = int(self._server.server_address[1])
        self._thread: threading.Thread | None = None

    def start(self, look: Callable[[], dict[str, Any]], recenter: Callable[[], None]) -> None:
        """Begin to answer.

        Args:
            look: gives the state.
            recenter: asks for a new origin and heading.
        """
        self._server.look, self._server.recenter = look, recenter
        serve = self._server.serve_forever
        self._thread = threading.Thread(
            target=serve, kwargs={"poll_interval": 0.2}, name="status", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Stop answering and give the port back. Doing so twice is no error."""
        if self._thread is not None:
            self._server.shutdown()
            self._thread.join()
            self._thread = None
        self._server.server_close()


class _Server(http.server.ThreadingHTTPServer):
    daemon_threads = True
    look: Callable[[], dict[str, Any]]
    recenter: Callable[[], None]


class _Handler(http.server.BaseHTTPRequestHandler):
    timeout = _PATIENCE
    server_version = "localreg"
    sys_version = ""

    @property
    def _run(self) -> _Server:
        assert isinstance(self.server, _Server)  # noqa: S101
        return self.server

    def do_GET(self) -> None:
        if self._is_foreign():
            self._answer(403, {"error": "only programs on this machine are answered"})
        elif self.path == "/":
            self._answer(200, self._run.look())
        else:
            self._answer(404, {"error": "there are GET / and POST /recenter"})

    def do_POST(self) -> None:
        if self._is_foreign():
            self._answer(403, {"error": "only programs on this machine are answered"})
        elif self.path == "/recenter":
            self._run.recenter()
            self._answer(202, {"recenter": "with the next frame"})
        else:
            self._answer(404, {"error": "there are GET / and POST /recenter"})

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002
        """Nothing: a request a second would fill the journal."""

    def _is_foreign(self) -> bool:
        host = self.headers.get("Host", "").rpartition(":")[0] or self.headers.get("Host", "")
        return "Origin" in self.headers or host not in (ADDRESS, "localhost")

    def _answer(self, status: int, document: dict[str, Any]) -> None:
        body = json.dumps(document, allow_nan=False).encode()
        self.send_response(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(body)
