"""A VRPN server whose one tracker is the body: sensor n is the start of bone n.

Sensors are the root and the 30 bones in the order of `BODY_NAMES`, with world positions in
metres and quaternions that turn bone axes into world axes, z up. Clients may connect by TCP,
or ask by UDP and be called back; reports go by UDP to those that described a port.

Sockets are served by a thread of its own that always sends the newest pose; a client that
does not read is dropped, as VRPN's own servers do, for half a message cannot be mended.
"""

import contextlib
import os
import select
import threading
import time
from typing import Final

from localreg.body.subject import Subject
from localreg.errors import LocalregError
from localreg.live.body_frames import ForwardKinematics
from localreg.live.sinks.base import LivePose, Sink
from sensors.protocols import vrpn
from sensors.vrpn_clients import DEVICE, TYPES, VrpnClients

_REPORTS_IN_A_DATAGRAM: Final = 16


class VrpnEncoder:
    """One subject's poses as VRPN messages; pure.

    Args:
        subject: whose body.
    """

    def __init__(self, subject: Subject) -> None:
        self._kinematics = ForwardKinematics(subject)

    def __call__(self, live: LivePose, calendar_time: float) -> list[bytes]:
        """One message for each sensor.

        Args:
            live: the pose.
            calendar_time: of its instant, in seconds since 1970.
        """
        frames = self._kinematics(live.pose.qpos)
        kind = TYPES.index(vrpn.POSE)
        return [
            vrpn.Message(
                kind, DEVICE, calendar_time, vrpn.PoseReport(sensor, p, q).encode()
            ).encode()
            for sensor, (p, q) in enumerate(zip(*frames, strict=True))
        ]


class VrpnServer(Sink):
    """Serves every pose to whoever connects.

    Args:
        subject: whose body.
        host: address to listen on.
        port: port for TCP and UDP, 0 for any.
        device: name of the tracker, by which clients ask: `Body0@host`.

    Attributes:
        port: the port it listens on.

    Raises:
        LocalregError: the port is taken.
    """

    def __init__(
        self,
        subject: Subject,
        host: str = "127.0.0.1",
        port: int = vrpn.DEFAULT_PORT,
        device: str = "Body0",
    ) -> None:
        self._encode = VrpnEncoder(subject)
        try:
            self._clients = VrpnClients(host, port, device)
        except OSError as error:
            reason = (error.strerror or str(error)).lower()
            raise LocalregError(
                f"cannot listen on {host}:{port} for VRPN: {reason}; give the output another port"
            ) from error
        self.port = self._clients.port
        self.name = f"vrpn {device}@{host}:{self.port}"
        self._newest: LivePose | None = None
        self._handing = threading.Lock()
        self._lost = 0
        self._is_ending = False
        self._wake_read, self._wake_write = os.pipe()
        os.set_blocking(self._wake_write, False)
        self._thread = threading.Thread(target=self._run, name="vrpn", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Poses that a newer one overtook before they were sent."""
        return self._lost

    def publish(self, live: LivePose) -> None:
        """Have one pose sent."""
        if self._is_ending:
            return
        with self._handing:
            if self._newest is not None:
                self._lost += 1
            self._newest = live
        self._wake()

    def close(self) -> None:
        """Hang up and give the port back. Doing so twice is no error."""
        if not self._is_ending:
            self._is_ending = True
            self._wake()
            self._thread.join()
            for fd in (self._wake_read, self._wake_write):
                os.close(fd)

    def _wake(self) -> None:
        # A pipe that is full wakes as well.
        with contextlib.suppress(BlockingIOError):
            os.write(self._wake_write, b"\0")

    def _run(self) -> None:
        while not self._is_ending:
            ready, _, _ = select.select([self._wake_read, *self._clients.sockets], [], [])
            if self._wake_read in ready:
                os.read(self._wake_read, 4096)
            self._clients.receive(ready)
            with self._handing:
                live, self._newest = self._newest, None
            if live is not None and self._clients.present:
                self._send(live)
        self._clients.close()

    def _send(self, live: LivePose) -> None:
        instant = time.time() - (time.monotonic() - live.frame.time)
        reports = self._encode(live, instant)
        whole = b"".join(reports)
        for client in self._clients.present:
            if not client.reader.has_cookie:
                continue
            if not client.udp_port:
                self._clients.send(client, whole)
                continue
            for first in range(0, len(reports), _REPORTS_IN_A_DATAGRAM):
                datagram = b"".join(reports[first : first + _REPORTS_IN_A_DATAGRAM])
                self._clients.send_datagram(client, datagram)
