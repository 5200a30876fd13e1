"""The body in a browser: MuJoCo's web viewer, guarded, showing one source.

The viewer is an ordinary one of `mujoco.studio` with our plugin alone: without the studio
application there is no console, no file dialog and no model to reload, so that visitors see
the body, the panels, and nothing of this machine.
"""

import threading
import time
from collections.abc import Callable
from typing import Any, Final

from mujoco.studio import launch_thread, messages, viewer_protocol, web_viewer

from localreg.errors import LocalregError
from localreg.view.panels import Desk
from localreg.view.panels_plugin import BodyPlugin
from localreg.view.scene import build_stage, light_for_studio
from localreg.view.source import Source
from localreg.view.web_guard import LOOPBACK, Guard, bind, guarded

MOST_FRAMES: Final = 30.0
"""Pictures a second that are made at most, whatever browsers ask for [Hz]."""

_FIRST_TURNS: Final = 3  # of the loop, after which the panels have a font
_BEGIN: Final = 10.0  # how long serving may take to begin [s]


class WebHost:
    """One page.

    `run` blocks until `close` is called from another thread.

    Args:
        source: what is shown; it is asked in the thread of `run`.
        host: name or address of this machine to be served on.
        port: None for the first free one from 8080 on, 0 for any.

    Attributes:
        guard: who may speak to it.
        desk: what is shown, and how at first.

    Raises:
        LocalregError: the address cannot be had.
    """

    def __init__(self, source: Source, host: str = LOOPBACK, port: int | None = None) -> None:
        self.guard = Guard(bind(host, port), host)
        self.desk = Desk(source)
        self._endpoint, self._control = launch_thread.make_thread_endpoints()

    @property
    def url(self) -> str:
        """Where a browser on this machine finds the page."""
        return self.guard.url

    def run(self, ready: Callable[[], None] = lambda: None) -> None:
        """Serve until closed.

        Args:
            ready: called when the page can be opened.

        Raises:
            LocalregError: this version of the viewer cannot be served safely.
        """
        stage = build_stage(self.desk.source.subject, self.desk.source.ghost)
        light_for_studio(stage.model)
        config = viewer_protocol.ViewerConfig(title="localreg", http_port=self.guard.port)
        with guarded(self.guard):
            viewer = _Viewer(
                self.guard,
                config,
                self._endpoint,
                model=stage.model,
                plugins=[BodyPlugin(stage, self.desk)],
            )
            try:
                viewer.check()
                ready()
            except BaseException:
                viewer.close()
                raise
            viewer_protocol.run_viewer_loop(viewer)

    def close(self) -> None:
        """End `run`; from any thread."""
        self._control.send_to_viewer(messages.ExitEvent())


class _Viewer(web_viewer.WebViewer):
    """MuJoCo's, without dropped models, and silent on why it ended."""

    def __init__(self, guard: Guard, *args: Any, **settings: Any) -> None:
        self._guard, self._next, self._turns = guard, 0.0, 0
        super().__init__(*args, **settings)

    def check(self) -> None:
        """See that requests are answered, and go through the guard.

        Raises:
            LocalregError: they do not.
        """
        if self._http_sock is not self._guard.sock or not self._guard.serving.wait(_BEGIN):
            raise LocalregError(
                "the web view does not begin to serve as it should; install the version of "
                "mujoco that requirements.lock names"
            )

    def prepare_next_frame(self) -> bool:
        # Browsers ask for 60 pictures a second, which nobody needs to see people walk.
        pause = self._next - time.monotonic()
        if pause > 0.0:
            time.sleep(pause)
        self._next = time.monotonic() + 1.0 / MOST_FRAMES
        is_seen = super().prepare_next_frame()
        self._turns += 1
        if self._turns == _FIRST_TURNS:
            self._guard.begun.set()
        return is_seen

    def get_drop_file(self) -> str:
        return ""

    def _stop_server(self) -> None:
        # The reason would be told to every visitor, and may name files.
        self.exit_reason = ""
        super()._stop_server()


def serve_in_thread(host: WebHost) -> threading.Thread:
    """Run a host in a thread of this process, for sources that cost little.

    Returns when the page can be opened.

    Raises:
        LocalregError: it cannot be served.
    """
    is_ready, failure = threading.Event(), []

    def run() -> None:
        try:
            host.run(is_ready.set)
        except LocalregError as error:
            failure.append(error)
        finally:
            is_ready.set()

    thread = threading.Thread(target=run, name="web-view", daemon=True)
    thread.start()
    is_ready.wait()
    if failure:
        raise failure[0]
    return thread
