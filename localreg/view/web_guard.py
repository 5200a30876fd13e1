"""Who may speak to the web view: bound to one address, the same origin only, no files.

`mujoco.studio` 4.0 serves every network, asks nobody where they come from, takes dropped
models and tells visitors why the program failed. It offers no settings for that, so its
parts are replaced here while a view runs: the function that binds the public socket, the
one that starts serving, and the banner. Where one of them is missing in another version,
nothing is served at all.

A page of another site cannot pass: browsers always say in `Origin` which page a WebSocket is
opened by, and in `Host` which name was looked up, so that a name that an attacker points at
this machine is refused as well.
"""

import asyncio
import contextlib
import ipaddress
import logging
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any, Final
from urllib.parse import urlsplit

from mujoco.studio import web_viewer
from mujoco.studio.web import web_server
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from localreg.errors import LocalregError

LOOPBACK: Final = "127.0.0.1"
"""Where views are served unless somebody says otherwise."""

FIRST_PORT: Final = 8080
"""The first port that is tried."""

_PORTS: Final = 20
_SOCKETS: Final = ("/ui", "/state")
_MOMENT: Final = 0.02
_LARGEST_MESSAGE: Final = 1 << 20  # input of one browser frame is a few kB


def bind(host: str, port: int | None = None) -> socket.socket:
    """The socket that a view is served on; connections wait until it is served.

    Args:
        host: a name or address of this machine.
        port: a port, 0 for any, None for the first free one from `FIRST_PORT` on.

    Raises:
        LocalregError: the address is not this machine's, or no port is free.
    """
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        raise LocalregError(
            f"there is no address {host!r}; give --host an address of this machine"
        ) from None
    family, _, _, _, address = found[0]
    ports = range(FIRST_PORT, FIRST_PORT + _PORTS) if port is None else (port,)
    reason = ""
    for candidate in (*ports, 0) if port is None else ports:
        sock = socket.socket(family, socket.SOCK_STREAM)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            sock.bind((address[0], candidate))
            sock.listen()  # now, or two views could have one port
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            sock.close()
        else:
            return sock
    raise LocalregError(
        f"cannot serve the view on {host}: {reason}; give --host an address of this machine, or "
        "free the port"
    )


class Guard:
    """Decides about every request to one view.

    Args:
        sock: what it is served on, bound.
        host: the name or address that was asked for.

    Attributes:
        sock: as given.
        is_open: whether other machines can reach it.
        serving: set once requests are answered.
        begun: set once visitors may be let in. Until then they wait: the viewer falls over one
            who is there before its panels have a font, as a page left open by the last run is.
    """

    def __init__(self, sock: socket.socket, host: str = LOOPBACK) -> None:
        self.sock = sock
        bound = ipaddress.ip_address(sock.getsockname()[0])
        self.is_open = not bound.is_loopback
        self._is_everywhere = bound.is_unspecified
        self._bound = bound
        self._names = {"localhost", host.lower()}
        if self.is_open:
            machine = socket.gethostname().lower()
            self._names |= {machine, f"{machine}.local"}
        self._port = int(sock.getsockname()[1])
        self.serving = threading.Event()
        self.begun = threading.Event()

    @property
    def port(self) -> int:
        """The port that is listened on."""
        return self._port

    @property
    def url(self) -> str:
        """Where a browser on this machine finds the page."""
        if self._is_everywhere:
            return f"http://{LOOPBACK}:{self._port}/"
        name = str(self._bound)
        return f"http://{f'[{name}]' if self._bound.version == 6 else name}:{self._port}/"

    def refusal(self, path: str, headers: Headers) -> str:
        """Why a request is refused; empty if it is served.

        Args:
            path: what is asked for, with the query.
            headers: of the request.
        """
        path = path.partition("?")[0]
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or not self._is_ours(hosts[0]):
            return "this name is not served here"
        if path == "/drop":
            return "models are not taken"
        if origins or path in _SOCKETS:
            pages = {f"http://{hosts[0]}".lower(), f"https://{hosts[0]}".lower()}
            if len(origins) != 1 or origins[0].lower() not in pages:
                return "pages of other sites are not served"
        return ""

    def _is_ours(self, host: str) -> bool:
        """Whether a `Host` is a name that this view is served under."""
        try:
            parts = urlsplit(f"//{host}")
            name, port = (parts.hostname or "").lower(), parts.port
        except ValueError:
            return False
        if parts.username is not None or parts.path or parts.query or parts.fragment:
            return False
        try:
            address = ipaddress.ip_address(name)
        except ValueError:
            return port == self._port and name in self._names
        if port != self._port:
            return False
        # An address cannot be pointed elsewhere by whoever owns a name.
        return self._is_everywhere or address == self._bound

    def serve(self, original: Callable[..., Any]) -> Callable[..., Any]:
        """The library's way of serving, with every request looked at first.

        Args:
            original: `websockets.asyncio.server.serve`.
        """

        def serve(handler: Any, **settings: Any) -> Any:
            answer, upgrade = settings.pop("process_request"), settings.pop("process_response")

            async def process_request(connection: Any, request: Request) -> Response | None:
                if reason := self.refusal(request.path, request.headers):
                    body = f"{reason}\n".encode()
                    head = Headers({"Content-Type": "text/plain"})
                    head["Content-Length"] = str(len(body))
                    return Response(403, "Forbidden", head, body)
                while not self.begun.is_set():
                    await asyncio.sleep(_MOMENT)
                response = answer(connection, request)
                return None if response is None else _private(response)

            def process_response(connection: Any, request: Request, response: Response) -> Response:
                return _private(upgrade(connection, request, response) or response)

            settings["max_size"] = _LARGEST_MESSAGE
            settings["server_header"] = None
            self.serving.set()
            return original(
                handler,
                process_request=process_request,
                process_response=process_response,
                **settings,
            )

        return serve


def _private(response: Response) -> Response:
    """The response without leave for other sites to read it."""
    headers = response.headers
    for name in ("Access-Control-Allow-Origin", "Cross-Origin-Resource-Policy"):
        if name in headers:
            del headers[name]
    headers["Cross-Origin-Resource-Policy"] = "same-origin"
    headers["X-Content-Type-Options"] = "nosniff"
    headers["X-Frame-Options"] = "DENY"
    headers["Referrer-Policy"] = "no-referrer"
    return response


@contextlib.contextmanager
def guarded(guard: Guard) -> Iterator[None]:
    """While this lasts every web view of the process is served through the guard.

    Raises:
        LocalregError: this version of `mujoco.studio` is made in another way.
    """
    logging.getLogger("WebServer").setLevel(logging.WARNING)
    with (
        _replaced(web_server, "bind_public_socket", lambda _: lambda host, port=0: guard.sock),
        _replaced(web_server, "serve", guard.serve),
        _replaced(web_viewer, "_print_url_banner", lambda _: lambda host, port: None),
    ):
        yield


@contextlib.contextmanager
def _replaced(module: Any, name: str, by: Callable[[Any], Any]) -> Iterator[None]:
    original = getattr(module, name, None)
    if original is None:
        raise LocalregError(
            f"the web view cannot be made safe: {module.__name__} has no {name}; install the "
            "version of mujoco that requirements.lock names"
        )
    setattr(module, name, by(original))
    try:
        yield
    finally:
        setattr(module, name, original)
