"""Tables before they are printed: the same rows for terminals, web pages and Markdown."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape

from rich.table import Table


@dataclass
class Grid:
    """A table of text.

    Attributes:
        title: its heading.
        columns: headings of the columns; line breaks are kept.
        left: how many columns, from the left, hold words rather than numbers.
        caption: a remark below.
        sections: groups of rows, set apart by lines.
    """

    title: str
    columns: Sequence[str]
    left: int = 1
    caption: str = ""
    sections: list[list[tuple[str, ...]]] = field(default_factory=lambda: [[]])

    def add_row(self, *cells: str) -> None:
        """Append a row to the last section."""
        self.sections[-1].append(cells)

    def add_section(self) -> None:
        """Begin another section."""
        if self.sections[-1]:
            self.sections.append([])

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """All rows."""
        return [row for section in self.sections for row in section]

    def to_rich(self) -> Table:
        """For a terminal."""
        table = Table(title=self.title, caption=self.caption or None)
        for index, column in enumerate(self.columns):
            table.add_column(column, justify="left" if index < self.left else "right")
        for section in self.sections:
            for row in section:
                table.add_row(*row)
            table.add_section()
        return table

    def to_html(self) -> str:
        """For a web page."""
        heads = "".join(
            f"<th{_side(i < self.left)}>{escape(column).replace(chr(10), '<br>')}</th>"
            for i, column in enumerate(self.columns)
        )
        bodies = "".join(
            "<tbody>"
            + "".join(
                "<tr>"
                + "".join(
                    f"<td{_side(i < self.left)}>{escape(cell)}</td>" for i, cell in enumerate(row)
                )
                + "</tr>"
                for row in section
            )
            + "</tbody>"
            for section in self.sections
            if section
        )
        remark = f"<p class='remark'>{escape(self.caption)}</p>" if self.caption else ""
        return (
            f"<h3>{escape(self.title)}</h3><div class='wide'><table><thead><tr>{heads}</tr>"
            f"</thead>{bodies}</table></div>{remark}"
        )

    def to_markdown(self) -> str:
        """For a document."""
        heads = [" ".join(column.split()) for column in self.columns]
        rule = ["---" if i < self.left else "---:" for i in range(len(heads))]
        return "\n".join("| " + " | ".join(row) + " |" for row in (heads, rule, *self.rows))


def _side(is_left: bool) -> str:
    return ' class="word"' if is_left else ""
