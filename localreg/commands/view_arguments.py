"""What commands that show a body can be told of it."""

from enum import StrEnum
from typing import Annotated

import typer


class View(StrEnum):
    """Where the body is to be seen live."""

    NONE = "none"
    WEB = "web"
    NATIVE = "native"


PageHost = Annotated[
    str,
    typer.Option(metavar="ADDRESS", help="Where the page is served; 0.0.0.0: on every network."),
]

PagePort = Annotated[
    int | None,
    typer.Option(
        min=0,
        max=65535,
        help="Port of the page; default: the first free one from 8080 on; 0: any.",
        show_default=False,
    ),
]
