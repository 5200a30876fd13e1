"""A sender of OSC trackers, as VMC performers and VRChat companions send them."""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message_builder import OscMessageBuilder

from sensors.emulators.beat import BeatEmulator, datagrams_of
from sensors.emulators.source import PoseSource, StationPose
from sensors.emulators.udp_sender import UdpSender
from sensors.protocols import osc, unity

Dialect = Literal["vmc", "vrchat"]
PORTS: dict[Dialect, int] = {"vmc": osc.VMC_PORT, "vrchat": osc.VRCHAT_PORT}


class OscEmulator(BeatEmulator):
    """Sends OSC trackers.

    Args:
        pose_at: world poses of the stations.
        host: where to.
        port: UDP port there; 0 for the usual one of the dialect.
        dialect: `"vmc"`: one bundle a cycle with `/VMC/Ext/T` and a
            `/VMC/Ext/Tra/Pos` for each tracker, named `station1`, ...; `"vrchat"`: position
            and rotation of trackers `1` to `8` in messages of their own.
        settings: as for `BeatEmulator`.
    """

    def __init__(
        self,
        pose_at: PoseSource,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        dialect: Dialect = "vmc",
        **settings: Any,
    ) -> None:
        super().__init__(pose_at, **settings)
        self._dialect: Dialect = dialect
        self._sender = UdpSender(host, port or PORTS[dialect])

    @property
    def address(self) -> str:
        """Where it sends to."""
        return self._sender.address

    def _send_cycle(self, poses: Sequence[StationPose | None], t: float, now: float) -> None:
        if self._dialect == "vmc":
            self._send(self._vmc_bundle(poses, now), t)
        else:
            for station, pose in enumerate(poses, start=1):
                if pose is not None:
                    self._send_vrchat(station, pose, t)
        self.counters.records += sum(pose is not None for pose in poses)

    def _vmc_bundle(self, poses: Sequence[StationPose | None], now: float) -> bytes:
        bundle = OscBundleBuilder(IMMEDIATELY)
        messages = [_message("/VMC/Ext/OK", 1), _message("/VMC/Ext/T", now)]
        for station, pose in enumerate(poses, start=1):
            if pose is not None:
                p = unity.position_from_world(pose[0]).tolist()
                w, x, y, z = unity.quaternion_from_world(pose[1]).tolist()
                name = f"station{station}"
                messages.append(_message("/VMC/Ext/Tra/Pos", name, *p, x, y, z, w))
        for message in messages:
            bundle.add_content(message.build())
        return bundle.build().dgram

    def _send_vrchat(self, station: int, pose: StationPose, t: float) -> None:
        euler = unity.quaternion_to_euler(unity.quaternion_from_world(pose[1]))
        place = unity.position_from_world(pose[0]).tolist()
        base = f"/tracking/trackers/{station}/"
        self._send(_message(base + "position", *place).build().dgram, t)
        self._send(_message(base + "rotation", *np.degrees(euler).tolist()).build().dgram, t)

    def _send(self, data: bytes, t: float) -> None:
        for datagram in datagrams_of(data, self.faults.spoil(data, t)):
            self._sender.send(datagram)

    def _close(self) -> None:
        self._sender.close()


def _message(address: str, *arguments: float | int | str) -> OscMessageBuilder:
    builder = OscMessageBuilder(address)
    for a in arguments:
        builder.add_arg(a, "s" if isinstance(a, str) else "i" if isinstance(a, int) else "f")
    return builder
