"""The first start on a machine: half of a frame's code is compiled in a process beside.

That process, `python -m localreg.live.compiling`, compiles what a frame runs on its own
(`localreg.synthesis.stand_in`), while the one that starts it compiles what it needs to learn
from the database. What either has compiled the other finds on the disk.
"""

import gc
import os
import subprocess
import sys
import time
from typing import Final, Self

from localreg.compile_cache import (
    count_compiled,
    keep_numba_code,
    note_compiled,
    wants_compiling,
    write_in_turn,
)

_FUNCTIONS: Final = 50  # about so many are compiled
_LONGEST: Final = 600.0  # after which what is missing is compiled here [s]


class Compiling:
    """Begins at once, if anything is to be compiled; enter before numba's code is imported.

    Attributes:
        is_first: whether this is the first start.
    """

    def __init__(self) -> None:
        self.is_first = wants_compiling()
        self._begun, self._before = time.monotonic(), count_compiled()
        self._process: subprocess.Popen[bytes] | None = None
        if self.is_first and _processors() > 1:
            write_in_turn()
            self._process = subprocess.Popen(
                [sys.executable, "-m", "localreg.live.compiling"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,  # what it could not do is done, and told, here
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def wait(self) -> None:
        """Until the other process has compiled its half; there is something left to do here."""
        if self._process is not None:
            from localreg.synthesis.stand_in import look_ahead_once

            look_ahead_once()
            try:
                self._process.wait(_LONGEST)
            except subprocess.TimeoutExpired:
                self.close()

    def finish(self) -> None:
        """Everything has been compiled; the next start need not."""
        if self.is_first:
            note_compiled()

    def progress(self) -> str:
        """How far it is, in a few words."""
        functions = count_compiled() - self._before
        seconds = time.monotonic() - self._begun
        return (
            f"compiling once for this machine: {functions} of some {_FUNCTIONS} functions, "
            f"{seconds:.0f} s"
        )

    def close(self) -> None:
        """End the other process. Doing so twice is no error."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


def _processors() -> int:
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def main() -> None:
    """Compile what a frame runs without a database."""
    gc.disable()  # of 31 s it would take 2, and all is gone in the end anyway
    keep_numba_code()
    write_in_turn()
    from localreg.live.warm_up import warm_up
    from localreg.synthesis.stand_in import stand_in

    warm_up(stand_in())


if __name__ == "__main__":
    main()
