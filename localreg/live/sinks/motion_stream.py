"""Motion files that grow while the motion goes on: after a crash they hold all up to it.

Every frame is one write to the system, so that only a power failure can take more than the
frame in hand. Frames that never came repeat the pose before, so that the file keeps time.
"""

import os
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from localreg.body.subject import Subject
from localreg.errors import LocalregError
from localreg.live.sinks.base import LivePose, Sink
from localreg.motion.formats import asf_amc, bvh
from localreg.motion.formats.asf import format_asf
from localreg.motion.formats.axes import rotations_to_y_up
from localreg.motion.joint_angles import euler_zyx

GROWING: Final = (".bvh", ".amc")
"""Endings of motion files that can grow."""

_LONGEST_GAP: Final = 2400
"""Most frames repeated at once: a minute at 40 Hz; after a longer pause time is lost."""

_COUNT_WIDTH: Final = 12


class EulerTrail:
    """Euler angles that go on from those of the frame before, without jumps.

    Every rotation has two triples (z, y, x) with R = Rz Ry Rx, each up to whole turns; the
    one nearest to the last is taken.
    """

    def __init__(self) -> None:
        self._last: ndarray | None = None

    def follow(self, turns: Float[ndarray, "joints 3 3"]) -> Float[ndarray, "joints 3"]:
        """The angles about z, y, x of the next frame [rad]."""
        first = euler_zyx(turns)
        if self._last is None:
            self._last = first
            return first
        ways = np.stack([first, first * [1.0, -1.0, 1.0] + np.pi])
        change = (ways - self._last + np.pi) % (2.0 * np.pi) - np.pi
        way = np.abs(change).sum(axis=-1).argmin(axis=0)
        self._last = self._last + change[way, np.arange(len(first))]
        return self._last


class MotionStream(Sink):
    """Writes every pose at the end of a file.

    Args:
        path: the file; it must not exist.
        subject: whose body it is.
        rate: frames a second [Hz].

    Raises:
        LocalregError: the ending is of no kind that can grow, the file exists, or it
            cannot be made.
    """

    def __init__(self, path: Path, subject: Subject, rate: float) -> None:
        self.name = str(path)
        self._path = path
        self._subject = subject
        self._trail = EulerTrail()
        self._frames = 0
        self._last: int | None = None
        self._is_bvh = path.suffix.lower() == ".bvh"
        if path.suffix.lower() not in GROWING:
            raise LocalregError(
                f"cannot write {path} while the motion goes on; give a file ending in "
                f"{' or '.join(GROWING)}"
            )
        head = bvh.head(subject, rate, "0".rjust(_COUNT_WIDTH)) + "\n"
        self._count_at = head.index("Frames: ") + len("Frames: ")
        try:
            if not self._is_bvh:
                path.with_suffix(".asf").write_text(format_asf(subject), encoding="utf-8")
                head = asf_amc.HEAD
            self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        except FileExistsError:
            raise LocalregError(f"{path} exists; give another name or move it away") from None
        except OSError as error:
            raise LocalregError(
                f"cannot write {path}: {(error.strerror or str(error)).lower()}; choose another "
                "place"
            ) from error
        self._write(head)

    def publish(self, live: LivePose) -> None:
        """Write one pose.

        Raises:
            OSError: the disk is full, for example.
        """
        missed = 0 if self._last is None else live.instant - self._last - 1
        self._last = live.instant
        for _ in range(1 + min(max(missed, 0), _LONGEST_GAP)):
            self._append(live.pose.qpos)

    def close(self) -> None:
        """Close the file. Doing so twice is no error."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def _append(self, qpos: Float[ndarray, "63"]) -> None:
        number = self._frames + 1
        if self._is_bvh:
            turns = bvh.joint_turns(qpos[None], self._subject)[0]
            self._write(bvh.row(qpos[:3], self._trail.follow(turns)) + "\n")
            # Behind the row: a reader never finds fewer frames than are claimed.
            os.pwrite(self._fd, str(number).rjust(_COUNT_WIDTH).encode(), self._count_at)
        else:
            turn = rotations_to_y_up(qpos[None, 3:7]).as_matrix()
            self._write(asf_amc.frame_text(number, qpos, self._trail.follow(turn)[0]))
        self._frames = number

    def _write(self, text: str) -> None:
        data = text.encode()
        while data:
            data = data[os.write(self._fd, data) :]
