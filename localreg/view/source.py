"""Where a view's moments come from, and what may be asked of that place."""

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Final, Literal, get_args

from localreg.body.subject import Subject
from localreg.view.moment import Moment
from localreg.view.transport import Deck

Command = Literal["record", "mark", "recenter", "export"]
"""What a button may ask of a live run."""

COMMANDS: Final[tuple[Command, ...]] = get_args(Command)
"""All commands."""


class Source(ABC):
    """Gives moments to one view, in the view's own thread.

    Attributes:
        subject: whose body is shown.
        ghost: whose body it is compared with, or None.
        commands: what may be asked of it.
        folder: where files go that somebody asks for; None for nowhere.
        transport: how it is played, if it is a file.
    """

    subject: Subject
    ghost: Subject | None = None
    commands: tuple[Command, ...] = ()
    folder: Path | None = None
    transport: Deck | None = None

    @abstractmethod
    def newest(self) -> Moment | None:
        """The newest moment; the same object as before if nothing happened since."""

    def command(self, name: Command) -> None:  # noqa: B027  (files take none)
        """Ask for something; what comes of it is in `note`."""

    @property
    def note(self) -> str:
        """The last thing to tell whoever looks on."""
        return ""

    @property
    def notice(self) -> str:
        """What stands above all else, such as that no pose is live yet; mostly empty."""
        return ""

    @property
    def is_recording(self) -> bool:
        """Whether a take is being recorded."""
        return False
