"""A serial port or TCP line whose reads give what is there, at once, and can be woken."""

import os
import select
from pathlib import Path

import serial
from serial.tools import list_ports

from sensors.errors import ConnectionFailedError, LinkLostError

_READ_SIZE = 65536


def _why(url: str, error: Exception) -> str:
    if "://" not in url and not Path(url).exists():
        ports = ", ".join(sorted(p.device for p in list_ports.comports()))
        there = f"there are {ports}" if ports else "there are no serial ports at all"
        return f"cannot open {url}: there is no such port, {there}; check the name and the cable"
    return (
        f"cannot open {url}: {error}; check the name, the cable, the permissions (group dialout) "
        "and whether another program has it"
    )


class SerialLink:
    """An open line.

    Args:
        url: a device path such as `/dev/ttyUSB0`, or any URL of pyserial such as
            `socket://host:port`.
        baud: line rate [bit/s]; 8N1, no flow control.

    Raises:
        ConnectionFailedError: if it cannot be opened.
    """

    def __init__(self, url: str, baud: int) -> None:
        try:
            # Exclusive: two programs on one port each get half of the bytes.
            self._port = serial.serial_for_url(
                url, baudrate=baud, timeout=0, write_timeout=1.0, exclusive=True
            )
        except (serial.SerialException, OSError, ValueError, KeyError) as error:
            raise ConnectionFailedError(_why(url, error)) from error
        self._wake_read, self._wake_write = os.pipe()

    def read(self, timeout: float) -> bytes:
        """Wait for bytes, then take all there are.

        Waiting is for readiness, not for a number of bytes: the record that completes a
        frame must not wait for its successor.

        Args:
            timeout: longest wait [s].

        Returns:
            Bytes; empty after the timeout or `wake`.

        Raises:
            LinkLostError: if the line is gone.
        """
        try:
            ready, _, _ = select.select([self._port.fileno(), self._wake_read], [], [], timeout)
            if self._port.fileno() not in ready:
                return b""
            return bytes(self._port.read(_READ_SIZE))
        except (serial.SerialException, OSError, ValueError, TypeError) as error:
            raise LinkLostError(f"the line is lost: {error}") from error

    def write(self, data: bytes) -> None:
        """Send all bytes.

        Raises:
            LinkLostError: if the line is gone or takes nothing.
        """
        try:
            self._port.write(data)
        except (serial.SerialException, OSError, TypeError) as error:
            raise LinkLostError(f"the line takes no bytes: {error}") from error

    def wake(self) -> None:
        """Let `read` return at once, now and from now on; from any thread."""
        os.write(self._wake_write, b"\0")

    def close(self) -> None:
        """Close the line."""
        # pyserial forgets a TCP socket without closing it if the peer hung up first.
        leftover = getattr(self._port, "_socket", None)
        self._port.close()
        if leftover is not None:
            leftover.close()
        os.close(self._wake_read)
        os.close(self._wake_write)
