"""The studio's window with the same plugin as the page; needs Python 3.12."""

import threading
from collections.abc import Callable

from mujoco.studio import launch_thread, messages, viewer_protocol

from localreg.errors import LocalregError
from localreg.view.native import check_window
from localreg.view.panels import Desk
from localreg.view.panels_plugin import BodyPlugin
from localreg.view.scene import build_stage
from localreg.view.source import Source


def show_studio(source: Source, ready: Callable[[], None], over: threading.Event) -> None:
    """Show until the window is closed, or until all is over.

    Args:
        source: what is shown; it is asked in this thread.
        ready: called once the window is there.
        over: set from another thread to end it.

    Raises:
        LocalregError: no window can be opened.
    """
    check_window()
    from mujoco.studio.native_viewer import NativeViewer

    stage = build_stage(source.subject, source.ghost)
    endpoint, control = launch_thread.make_thread_endpoints()
    try:
        viewer = NativeViewer(
            viewer_protocol.ViewerConfig(title="localreg", gfx="opengl_software"),
            endpoint,
            model=stage.model,
            plugins=[BodyPlugin(stage, Desk(source))],
        )
    except (RuntimeError, OSError) as error:
        raise LocalregError(
            f"no window can be opened: {str(error).lower()}; watch in a browser: --view web"
        ) from error

    def wait() -> None:
        over.wait()
        control.send_to_viewer(messages.ExitEvent())

    threading.Thread(target=wait, name="run-over", daemon=True).start()
    ready()
    viewer_protocol.run_viewer_loop(viewer)
