"""The line an emulator answers on: a pseudo terminal, or a TCP port."""

import contextlib
import os
import socket
import tty
from abc import ABC, abstractmethod
from pathlib import Path

from sensors.errors import ConnectionFailedError

_READ_SIZE = 4096


class Endpoint(ABC):
    """The device's end of a line. Never blocks: what the host does not take is refused."""

    address: str
    """What a host opens: a path, or `socket://host:port`."""

    @abstractmethod
    def readable(self) -> list[int]:
        """File descriptors to wait on for `read`."""

    @abstractmethod
    def read(self) -> bytes:
        """Bytes from the host, empty if there are none."""

    @abstractmethod
    def write(self, data: bytes) -> int:
        """Send; returns how many bytes went. All of them, if nobody listens."""

    @abstractmethod
    def close(self) -> None:
        """Take the line away from the host. Doing so twice is no error."""


class PtyEndpoint(Endpoint):
    """A pseudo terminal; hosts open its slave like any serial port.

    Args:
        link: also make this symbolic link to it, so that the host's settings can name a
            fixed path. An existing link is replaced, an existing file is not.

    Raises:
        ConnectionFailedError: if the link cannot be made.
    """

    def __init__(self, link: Path | None = None) -> None:
        self._master, self._slave = os.openpty()
        # Raw before anybody opens it: no echo, no CR translation, no line editing. The slave
        # stays open here, else the master reads errors whenever no host has it open.
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._link = link
        self.address = os.ttyname(self._slave)
        if link is not None:
            try:
                if link.is_symlink():
                    link.unlink()
                link.symlink_to(self.address)
            except OSError as error:
                self._link = None
                self.close()
                raise ConnectionFailedError(
                    f"cannot make the link {link}: {error.strerror}; choose another path"
                ) from error
            self.address = str(link)

    def readable(self) -> list[int]:
        """The master's descriptor."""
        return [self._master]

    def read(self) -> bytes:
        """Bytes from the host."""
        try:
            return os.read(self._master, _READ_SIZE)
        except OSError:
            return b""

    def write(self, data: bytes) -> int:
        """Send what fits into the terminal's buffer."""
        try:
            return os.write(self._master, data)
        except OSError:
            return 0

    def close(self) -> None:
        """Close both sides: the host's next read fails, as when a cable is pulled."""
        for fd in (self._master, self._slave):
            if fd >= 0:
                os.close(fd)
        self._master = self._slave = -1
        if self._link is not None:
            with contextlib.suppress(OSError):
                self._link.unlink()
            self._link = None


class TcpEndpoint(Endpoint):
    """A listening TCP port that serves one host at a time; a newer host replaces it.

    Args:
        host: address to listen on.
        port: port, 0 for any free one.

    Raises:
        ConnectionFailedError: if the port cannot be had.
    """

    def __init__(self, host: str = "127.0.0.1", port: int = 0) -> None:
        try:
            self._server = socket.create_server((host, port))
        except OSError as error:
            raise ConnectionFailedError(
                f"cannot listen on {host}:{port}: {error.strerror}; choose another port"
            ) from error
        self._server.setblocking(False)
        self._host: socket.socket | None = None
        self.address = f"socket://{host}:{self._server.getsockname()[1]}"

    def readable(self) -> list[int]:
        """Server and connection."""
        sockets = [self._server] if self._host is None else [self._server, self._host]
        return [s.fileno() for s in sockets]

    def read(self) -> bytes:
        """Bytes from the host; accepts a new host first."""
        with contextlib.suppress(OSError):
            host, _ = self._server.accept()
            self._hang_up()
            host.setblocking(False)
            # 37-byte records must not wait for their successors.
            host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._host = host
        if self._host is None:
            return b""
        try:
            data = self._host.recv(_READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._hang_up()
        return data

    def write(self, data: bytes) -> int:
        """Send what fits into the socket's buffer."""
        if self._host is None:
            return len(data)
        try:
            return self._host.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self._hang_up()
            return len(data)

    def _hang_up(self) -> None:
        if self._host is not None:
            self._host.close()
            self._host = None

    def close(self) -> None:
        """Close the connection and the port."""
        self._hang_up()
        self._server.close()
