"""Tables that stand between marks in a Markdown file, so that a command can replace them."""

from pathlib import Path

from localreg.errors import LocalregError


def put_table(path: Path, text: str, mark: str) -> None:
    """Replace what stands between `<!-- mark -->` and `<!-- /mark -->`.

    Args:
        path: a Markdown file.
        text: the table.
        mark: its name.

    Raises:
        LocalregError: the file has no such marks.
    """
    begin, end = f"<!-- {mark} -->", f"<!-- /{mark} -->"
    before, _, rest = path.read_text(encoding="utf-8").partition(begin)
    if end not in rest:
        raise LocalregError(f"{path} has no {begin} ... {end}; write them where the table belongs")
    after = rest.partition(end)[2]
    path.write_text(f"{before}{begin}\n{text}\n{end}{after}", encoding="utf-8")
