"""CMU's list of motions, a page of its site, as an index that `localreg.motion.index` reads.

The page is a table: a line for each subject (`Subject #2 (...)`), then a row for each trial
with its number, its description, links to its files and the rate at which it was recorded.
"""

import csv
import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from typing import Final

from localreg.errors import MotionError

PAGE: Final = "search.php?subjectnumber=%25&motion=%25"
"""The page that lists all motions, on CMU's site."""

_AMC: Final = re.compile(r"subjects/(\d+)/\1_(\d+)\.amc", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Trial:
    """A recording of CMU's database.

    Attributes:
        subject: number of the person, of two digits or more.
        number: of the recording among the person's, likewise.
        description: what is done; empty if the index does not say.
        rate: frames a second; None if the index does not say [Hz].
    """

    subject: str
    number: str
    description: str = ""
    rate: float | None = None

    @property
    def name(self) -> str:
        """Its name, for example `02_01`."""
        return f"{self.subject}_{self.number}"


def read_index(text: str) -> list[Trial]:
    """The trials that an index lists, in its order: CMU's page, or a table of ours.

    Raises:
        MotionError: the text lists no trials.
    """
    trials = _of_page(text) if "<" in text[:2000] else _of_table(text)
    if not trials:
        raise MotionError(
            "the index lists no motions; name one by --index, tab separated with the columns "
            "subject, trial, description"
        )
    return list({trial.name: trial for trial in trials}.values())


def write_index(trials: list[Trial], path: Path) -> None:
    """Write an index as a table: subject, trial, description, rate."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, delimiter="\t", lineterminator="\n", quoting=csv.QUOTE_NONE,
                            quotechar=None, escapechar="\\")  # fmt: skip
        writer.writerow(("subject", "trial", "description", "rate"))
        for trial in trials:
            rate = "" if trial.rate is None else f"{trial.rate:g}"
            writer.writerow(
                (trial.subject, trial.number, " ".join(trial.description.split()), rate)
            )


def choose(
    trials: Sequence[Trial], subjects: Iterable[str] = (), activities: Iterable[str] = ()
) -> list[Trial]:
    """The trials of some people in which something is done.

    Args:
        trials: all there are.
        subjects: numbers (`2`, `02`), ranges (`1-5`) and trials (`02_01`); all if none.
        activities: words of descriptions, of which one must occur; any if none.

    Raises:
        MotionError: a number is none, or nothing is left.
    """
    wanted, ranges, single = _numbers(subjects)
    words = [word.lower() for word in activities]
    known = {int(trial.subject) for trial in trials}
    if missing := sorted(wanted - known):
        raise MotionError(
            f"the index has no subject {', '.join(map(str, missing))}; it has "
            f"{min(known)} to {max(known)}, with gaps"
        )
    is_anyone = not (wanted or ranges or single)
    wanted |= ranges & known  # numbers have gaps
    if unknown := sorted(single - {trial.name for trial in trials}):
        raise MotionError(f"the index has no trial {', '.join(unknown)}; list them by --list")
    chosen = [
        trial
        for trial in trials
        if (is_anyone or int(trial.subject) in wanted or trial.name in single)
        and (not words or any(word in trial.description.lower() for word in words))
    ]
    if not chosen:
        raise MotionError(
            f"no motion described by {' or '.join(words) or 'anything'} is among those; other "
            "words may find some, --list shows what there is"
        )
    return chosen


class _Rows(HTMLParser):
    """Collects the cells and links of every row, whether tags are closed or not."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[tuple[list[str], list[str]]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "tr":
            self.rows.append(([], []))
        elif tag in ("td", "th") and self.rows:
            self.rows[-1][0].append("")
        elif tag == "a" and self.rows:
            self.rows[-1][1].extend(value for key, value in attrs if key == "href" and value)

    def handle_data(self, data: str) -> None:
        if self.rows and self.rows[-1][0]:
            self.rows[-1][0][-1] += data


def _of_page(text: str) -> list[Trial]:
    page = _Rows()
    page.feed(text)
    trials = []
    for cells, links in page.rows:
        match = next((found for link in links if (found := _AMC.search(link))), None)
        if match is None:
            continue
        words = [" ".join(cell.split()) for cell in cells]
        numbers = [index for index, word in enumerate(words) if word.isdigit()]
        first = numbers[0] if numbers else -1
        description = words[first + 1] if 0 <= first < len(words) - 1 else ""
        last = float(words[numbers[-1]]) if len(numbers) > 1 else 0.0
        trials.append(
            Trial(_two(match[1]), _two(match[2]), description, last if last >= 10.0 else None)
        )
    return trials


def _of_table(text: str) -> list[Trial]:
    rows = list(csv.reader(io.StringIO(text), delimiter="\t", quoting=csv.QUOTE_NONE))
    if not rows or rows[0][:3] != ["subject", "trial", "description"]:
        return []
    trials = []
    for row in rows[1:]:
        if len(row) < 2 or not (row[0].isdigit() and row[1].isdigit()):
            continue
        rate = row[3].strip() if len(row) > 3 else ""
        known = re.fullmatch(r"\d+(\.\d+)?", rate) and float(rate) > 0.0
        trials.append(
            Trial(
                _two(row[0]),
                _two(row[1]),
                row[2].strip() if len(row) > 2 else "",
                float(rate) if known else None,
            )
        )
    return trials


def _two(number: str) -> str:
    return f"{int(number):02d}"


def _numbers(subjects: Iterable[str]) -> tuple[set[int], set[int], set[str]]:
    """Numbers of people, all numbers in ranges, and names of trials of what a user wrote."""
    wanted, ranges, single = set(), set(), set()
    for word in subjects:
        low, dash, high = word.partition("-")
        person, bar, trial = word.partition("_")
        if bar and person.isdigit() and trial.isdigit():
            single.add(f"{int(person):02d}_{int(trial):02d}")
        elif word.isdigit():
            wanted.add(int(word))
        elif dash and low.isdigit() and high.isdigit() and int(low) <= int(high) <= 999:
            ranges.update(range(int(low), int(high) + 1))
        else:
            raise MotionError(f"{word!r} is no subject; write numbers (02), ranges (1-5) or 02_01")
    return wanted, ranges, single
