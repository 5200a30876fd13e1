"""The native UDP stream of an IS-900."""

from collections.abc import Sequence
from typing import Any

from sensors import rotation
from sensors.emulators.beat import BeatEmulator, datagrams_of
from sensors.emulators.source import PoseSource, StationPose
from sensors.emulators.udp_sender import UdpSender
from sensors.protocols import is900_udp
from sensors.protocols.is900.axes import flip_position, flip_quaternion


class Is900UdpEmulator(BeatEmulator):
    """Sends 44-byte packets.

    Args:
        pose_at: world poses of the stations.
        host: where to.
        port: UDP port there.
        settings: as for `BeatEmulator`.
    """

    def __init__(
        self,
        pose_at: PoseSource,
        *,
        host: str = "127.0.0.1",
        port: int = is900_udp.DEFAULT_PORT,
        **settings: Any,
    ) -> None:
        super().__init__(pose_at, **settings)
        self._sender = UdpSender(host, port)
        self._sequences: dict[int, int] = {}

    @property
    def address(self) -> str:
        """Where it sends to."""
        return self._sender.address

    def _send_cycle(self, poses: Sequence[StationPose | None], t: float, now: float) -> None:
        for station, pose in enumerate(poses, start=1):
            if pose is None:
                continue
            p, q = flip_position(pose[0]), flip_quaternion(pose[1])
            sequence = self._sequences.get(station, 0)
            self._sequences[station] = (sequence + 1) % 256
            packet = is900_udp.Packet(sequence, station, 255, rotation.to_euler(q), p, now)
            data = packet.encode()
            for datagram in datagrams_of(data, self.faults.spoil(data, t)):
                self._sender.send(datagram)
            self.counters.records += 1

    def _close(self) -> None:
        self._sender.close()
