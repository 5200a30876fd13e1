"""A VRPN server that standard clients read: one device, one sensor for each station."""

import socket
import time
from collections.abc import Sequence
from typing import Any

from sensors.emulators.beat import BeatEmulator
from sensors.emulators.source import PoseSource, StationPose
from sensors.errors import ConnectionFailedError
from sensors.protocols import vrpn
from sensors.vrpn_clients import DEVICE, TYPES, VrpnClients


class VrpnEmulator(BeatEmulator):
    """A server on one port: TCP for connections, UDP for requests to connect back.

    Clients may be of either kind: those that connect by TCP, and the classic ones that ask
    by UDP and are called back. Reports go by UDP to clients that described a port, else by
    TCP.

    Args:
        pose_at: world poses of the stations; station n is sensor n - 1.
        host: address to listen on.
        port: port; 0 for any free one.
        device: name of the tracker, by which clients ask: `Tracker0@host`.
        settings: as for `BeatEmulator`.

    Raises:
        ConnectionFailedError: if the port cannot be had.
    """

    def __init__(
        self,
        pose_at: PoseSource,
        *,
        host: str = "127.0.0.1",
        port: int = vrpn.DEFAULT_PORT,
        device: str = "Tracker0",
        **settings: Any,
    ) -> None:
        super().__init__(pose_at, **settings)
        self._host = host
        # Wall time of the device's zero: VRPN time stamps are those of the calendar.
        self._epoch = time.time()
        try:
            self._clients = VrpnClients(host, port, device)
        except OSError as error:
            raise ConnectionFailedError(
                f"cannot listen on port {port} of {host}: {error.strerror}; choose another port"
            ) from error
        self.port = self._clients.port

    @property
    def address(self) -> str:
        """What a client connects to."""
        return f"{self._host}:{self.port}"

    def _sockets(self) -> list[socket.socket]:
        return self._clients.sockets

    def _receive(self, ready: list[socket.socket]) -> None:
        self.counters.command_bytes += self._clients.receive(ready)

    def _send_cycle(self, poses: Sequence[StationPose | None], t: float, now: float) -> None:
        for sensor, pose in enumerate(poses):
            if pose is None:
                continue
            report = vrpn.PoseReport(sensor, *pose).encode()
            message = vrpn.Message(TYPES.index(vrpn.POSE), DEVICE, self._epoch + now, report)
            data = message.encode()
            self.counters.records += 1
            for client in self._clients.present:
                if client.udp_port:
                    self._clients.send_datagram(client, self.faults.spoil(data, t))
                elif not self._clients.send(client, data):
                    self.counters.overruns += 1

    def _close(self) -> None:
        self._clients.close()
