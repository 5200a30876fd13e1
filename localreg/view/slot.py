"""One message that is always the newest, between two processes that never wait.

The writer overwrites what the reader has not taken yet. Both see the same memory; a checksum
tells the reader whether it looked in the midst of a writing, and it looks again.
"""

import mmap
import os
import struct
import zlib
from typing import Final, Self

_HEAD: Final = struct.Struct("<QII")
_TRIES: Final = 8


class Slot:
    """Room for one message.

    Args:
        fd: of a file in memory that `create` made, open for reading and writing; it may be
            closed afterwards.
    """

    def __init__(self, fd: int) -> None:
        self._memory = mmap.mmap(fd, 0)
        self._number = 0

    @classmethod
    def create(cls, capacity: int) -> tuple[Self, int]:
        """A new slot, and the file descriptor by which another process finds it.

        Args:
            capacity: of the longest message [bytes].
        """
        fd = os.memfd_create("localreg-view")
        os.ftruncate(fd, _HEAD.size + capacity)
        return cls(fd), fd

    def write(self, message: bytes) -> None:
        """Put a message in place of the one before; at once.

        Raises:
            ValueError: it is too long, or the slot is closed.
        """
        if len(message) > len(self._memory) - _HEAD.size:
            raise ValueError(f"a message of {len(message)} bytes does not fit")
        self._number += 1
        number = self._number
        check = zlib.crc32(message, number & 0xFFFFFFFF)
        self._memory[_HEAD.size : _HEAD.size + len(message)] = message
        self._memory[: _HEAD.size] = _HEAD.pack(number, len(message), check)

    def read(self) -> bytes | None:
        """The newest message; None if there is none since the last call."""
        for _ in range(_TRIES):
            number, length, check = _HEAD.unpack_from(self._memory)
            if number == self._number or length > len(self._memory) - _HEAD.size:
                return None
            message = self._memory[_HEAD.size : _HEAD.size + length]
            if zlib.crc32(message, number & 0xFFFFFFFF) == check:
                self._number = number
                return message
        return None

    def close(self) -> None:
        """Let the memory go. Doing so twice is no error."""
        self._memory.close()
