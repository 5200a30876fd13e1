"""The conversation that brings an IS-900 from any state to a binary stream."""

import time
from collections.abc import Callable, Mapping
from typing import TypeVar

from sensors.devices.serial_link import SerialLink
from sensors.errors import ConnectionFailedError, MalformedRecordError
from sensors.protocols.is900 import commands
from sensors.protocols.is900.items import Item, parse_items
from sensors.protocols.is900.parser import Parser
from sensors.protocols.is900.responses import (
    Response,
    Status,
    parse_output_list,
    parse_station_flags,
    parse_status,
)

_Answer = TypeVar("_Answer")

# A line counts as quiet when nothing came for this long: two periods of the slowest usual
# stream.
_QUIET = 0.05
_MAX_DRAIN = 1.0


class Is900Setup:
    """Sets up a device on an open line.

    Args:
        link: the line.
        answer_timeout: how long one answer may take [s].
        reset_timeout: how long the device may be deaf after a reset [s]; the manual says 15
            to 20 s. It is asked all the time, so a quick one is not waited for.
        keep_waiting: asked now and then; False gives up.
    """

    def __init__(
        self,
        link: SerialLink,
        answer_timeout: float,
        reset_timeout: float,
        keep_waiting: Callable[[], bool],
    ) -> None:
        self._link = link
        self._answer_timeout = answer_timeout
        self._reset_timeout = reset_timeout
        self._keep_waiting = keep_waiting

    def run(
        self, stations: tuple[int, ...], items: tuple[int, ...], prediction_ms: int, reset: bool
    ) -> Mapping[int, tuple[int, ...]]:
        """Stop, configure and verify; the stream is not started yet.

        Args:
            stations: stations to switch on; all others that are on are switched off, for
                they would take a share of the line. None: those that are on.
            items: wanted output list.
            prediction_ms: prediction by the device [ms].
            reset: begin with a reset.

        Returns:
            The output list of each station as the device confirmed it. Firmware that lacks
            an item leaves it out, and the records follow what it says.

        Raises:
            ConnectionFailedError: if the device does not answer, or not as it must.
        """
        self._link.write(commands.RESUME + commands.STOP)
        self._drain()
        if reset:
            self._link.write(commands.RESET)
        self._wait_for_answer(self._reset_timeout if reset else 2.0 * self._answer_timeout)
        flags = self._ask(commands.ALL_STATIONS, parse_station_flags)
        if not stations:
            stations = tuple(n for n, on in enumerate((flags or ())[:12], start=1) if on)
        for n, on in enumerate(flags or (), start=1):
            if on and n not in stations and n <= 12:
                self._link.write(commands.station_on(n, False))
        lists = {n: self._configure(n, items, prediction_ms) for n in stations}
        self._link.write(commands.BINARY + commands.CENTIMETERS)
        self._link.write(commands.CLOCK_MILLISECONDS + commands.CLOCK_ZERO)
        status = self._ask(commands.STATUS, parse_status)
        if status is None or not (status.binary and status.metric):
            raise ConnectionFailedError(
                "the device did not switch to binary records in centimeters; switch it off and on"
            )
        return lists

    def _configure(
        self, station: int, items: tuple[int, ...], prediction_ms: int
    ) -> tuple[int, ...]:
        self._link.write(commands.station_on(station, True))
        self._link.write(commands.output_list(station, items))
        if prediction_ms:
            self._link.write(commands.prediction(station, prediction_ms))

        def confirmed(response: Response) -> tuple[int, ...]:
            if response.station != station:
                raise MalformedRecordError("the answer is about another station")
            return tuple(int(i) for i in parse_items(parse_output_list(response)))

        answer = self._ask(commands.output_list(station, ()), confirmed)
        if answer is None:
            return items
        if not has_pose(answer):
            raise ConnectionFailedError(
                f"station {station} kept the output list {','.join(map(str, answer))}, without "
                "position and orientation; choose items its firmware knows, such as 2,11,21,1"
            )
        return answer

    def _wait_for_answer(self, timeout: float) -> Status:
        give_up = time.monotonic() + timeout
        while self._keep_waiting():
            status = self._ask(commands.STATUS, parse_status)
            if status is not None:
                return status
            if time.monotonic() >= give_up:
                break
        raise ConnectionFailedError(
            f"no answer to a status request within {timeout:g} s; check power, cable and baud rate"
        )

    def _ask(self, command: bytes, read: Callable[[Response], _Answer]) -> _Answer | None:
        """Send a command and wait for the answer that `read` accepts."""
        self._link.write(command)
        answers = Parser({})
        give_up = time.monotonic() + self._answer_timeout
        while self._keep_waiting() and (left := give_up - time.monotonic()) > 0.0:
            for message in answers.feed(self._link.read(left)):
                if isinstance(message, Response):
                    try:
                        return read(message)
                    except MalformedRecordError:
                        continue
        return None

    def _drain(self) -> None:
        give_up = time.monotonic() + _MAX_DRAIN
        while self._link.read(_QUIET) and time.monotonic() < give_up:
            pass


def has_pose(items: tuple[int, ...]) -> bool:
    """Whether an output list tells position and orientation."""
    have = set(items)
    cosines = {Item.X_COSINES, Item.Y_COSINES, Item.Z_COSINES}
    return bool(have & {Item.POSITION, Item.POSITION_14BIT}) and (
        bool(have & {Item.QUATERNION, Item.QUATERNION_14BIT, Item.EULER, Item.EULER_14BIT})
        or cosines <= have
    )
