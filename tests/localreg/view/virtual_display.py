"""A display that nobody sees: Xvfb, its pixels as an array, and a keyboard for it."""

import ctypes
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy import ndarray

WIDTH, HEIGHT = 640, 480
MISSING = "install Xvfb (Debian: apt-get install xvfb libgl1) to test windows"

_KEY_PRESS, _KEY_RELEASE = 2, 3


def is_there() -> bool:
    """Whether this machine has it."""
    return shutil.which("Xvfb") is not None


class VirtualDisplay:
    """A running Xvfb.

    Attributes:
        name: for `DISPLAY`.
    """

    def __init__(self, name: str, folder: Path) -> None:
        self.name = name
        self._pixels = folder / "Xvfb_screen0"

    def picture(self) -> ndarray:
        """What is on the screen now: height x width x red, green, blue."""
        data = self._pixels.read_bytes()
        header = np.frombuffer(data[:100], dtype=">u4")  # of the X window dump format
        start = int(header[0]) + 12 * int(header[19])  # the header, then the colors
        rows = np.frombuffer(data[start:], dtype=np.uint8)[: HEIGHT * int(header[12])]
        return rows.reshape(HEIGHT, -1, 4)[:, :WIDTH, 2::-1]

    def press(self, key: int) -> None:
        """Press a key and let it go, in the window that is on the screen.

        Args:
            key: its X keysym, for letters and digits their character's code.
        """
        x = ctypes.CDLL("libX11.so.6")
        x.XOpenDisplay.restype = ctypes.c_void_p
        x.XDefaultRootWindow.restype = ctypes.c_ulong
        display = ctypes.c_void_p(x.XOpenDisplay(self.name.encode()))
        assert display.value, "the display is gone"
        try:
            window = self._window(x, display)
            code = x.XKeysymToKeycode(display, ctypes.c_ulong(key))
            root = x.XDefaultRootWindow(display)
            for kind in (_KEY_PRESS, _KEY_RELEASE):
                event = _KeyEvent(kind, 0, 1, display, window, root, 0, 0, 1, 1, 1, 1, 0, code, 1)
                x.XSendEvent(display, ctypes.c_ulong(window), 1, ctypes.c_long(3), event.padded())
            x.XSync(display, 0)
        finally:
            x.XCloseDisplay(display)

    def _window(self, x: ctypes.CDLL, display: ctypes.c_void_p) -> int:
        root, parent = ctypes.c_ulong(), ctypes.c_ulong()
        children, count = ctypes.POINTER(ctypes.c_ulong)(), ctypes.c_uint()
        x.XQueryTree(
            display, ctypes.c_ulong(x.XDefaultRootWindow(display)), ctypes.byref(root),
            ctypes.byref(parent), ctypes.byref(children), ctypes.byref(count),
        )  # fmt: skip
        found = [children[i] for i in range(count.value)]
        x.XFree(children)
        assert found, "there is no window"
        return found[-1]


class _KeyEvent(ctypes.Structure):
    _fields_ = (
        ("type", ctypes.c_int), ("serial", ctypes.c_ulong), ("send_event", ctypes.c_int),
        ("display", ctypes.c_void_p), ("window", ctypes.c_ulong), ("root", ctypes.c_ulong),
        ("subwindow", ctypes.c_ulong), ("time", ctypes.c_ulong), ("x", ctypes.c_int),
        ("y", ctypes.c_int), ("x_root", ctypes.c_int), ("y_root", ctypes.c_int),
        ("state", ctypes.c_uint), ("keycode", ctypes.c_uint), ("same_screen", ctypes.c_int),
    )  # fmt: skip

    def padded(self) -> ctypes.Array[ctypes.c_char]:
        """As large as any event."""
        return ctypes.create_string_buffer(bytes(self), 192)


@contextmanager
def virtual_display(folder: Path) -> Iterator[VirtualDisplay]:
    """A display of its own, as long as it is needed."""
    reads, writes = os.pipe()
    server = subprocess.Popen(
        [
            "Xvfb", "-displayfd", str(writes), "-screen", "0", f"{WIDTH}x{HEIGHT}x24",
            "-fbdir", str(folder), "-nolisten", "tcp", "-noreset",
        ],
        pass_fds=[writes], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    os.close(writes)
    try:
        with os.fdopen(reads) as pipe:
            number = pipe.readline().strip()
        assert number, "Xvfb ended at once"
        yield VirtualDisplay(f":{number}", folder)
    finally:
        server.terminate()
        server.wait(30)


def eventually(condition: object, patience: float = 120.0) -> bool:
    """Whether something becomes true before patience ends [s]."""
    assert callable(condition)
    until = time.monotonic() + patience
    while time.monotonic() < until:
        if condition():
            return True
        time.sleep(0.1)
    return False
