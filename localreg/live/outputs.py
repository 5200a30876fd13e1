"""From the outputs of a configuration to sinks."""

from collections.abc import Sequence
from pathlib import Path

from localreg.body.subject import Subject
from localreg.live.config import (
    JsonOutput,
    LslOutput,
    OutputConfig,
    VmcOutput,
    VrchatOutput,
    VrpnOutput,
)
from localreg.live.sinks.background import Background
from localreg.live.sinks.base import Sink
from localreg.live.sinks.datagrams import DatagramSink

_FILE_QUEUE = 60.0
"""How long a disk may stand still before poses of a motion file are lost [s]."""


def open_outputs(
    outputs: Sequence[OutputConfig], subject: Subject, rate: float, host: str
) -> list[Sink]:
    """The sinks of a configuration, open: ports are taken, names are resolved.

    Args:
        outputs: what is wanted.
        subject: whose poses are published.
        rate: frames a second [Hz].
        host: address on which servers listen.

    Raises:
        LocalregError: one cannot be opened; those before it are closed.
    """
    sinks: list[Sink] = []
    try:
        for output in outputs:
            sinks.append(_open(output, subject, rate, host))
    except BaseException:
        for sink in sinks:
            sink.close()
        raise
    return sinks


def open_motion_file(path: Path, subject: Subject, rate: float) -> Sink:
    """A motion file that grows, written in the background.

    Raises:
        LocalregError: the file cannot be made.
    """
    from localreg.live.sinks.motion_stream import MotionStream

    return Background(MotionStream(path, subject, rate), round(_FILE_QUEUE * rate))


def _open(output: OutputConfig, subject: Subject, rate: float, host: str) -> Sink:
    if isinstance(output, VmcOutput):
        from localreg.live.sinks.vmc import VmcEncoder

        return DatagramSink("vmc", VmcEncoder(subject), output.host, output.port)
    if isinstance(output, VrchatOutput):
        from localreg.live.sinks.vrchat import VrchatEncoder

        return DatagramSink("vrchat", VrchatEncoder(subject), output.host, output.port)
    if isinstance(output, JsonOutput):
        from localreg.live.sinks.udp_json import JsonEncoder

        return DatagramSink("json", JsonEncoder(subject), output.host, output.port)
    if isinstance(output, VrpnOutput):
        from localreg.live.sinks.vrpn import VrpnServer

        return VrpnServer(subject, host, output.port, output.device)
    assert isinstance(output, LslOutput)  # noqa: S101
    from localreg.live.sinks.lsl import Lsl

    return Lsl(subject, rate, output.stream)
