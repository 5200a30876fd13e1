"""Whether a file that came over the network is what its name promises, and all of it."""

import zipfile
from pathlib import Path
from typing import Final

from localreg.motion.download import Check


def _check_asf(path: Path) -> str:
    data = path.read_bytes()
    if problem := _not_text(data):
        return problem
    whole = b":bonedata" in data and b":hierarchy" in data and data.rstrip().endswith(b"end")
    return "" if whole else "what came is not a whole ASF file"


def _check_amc(path: Path) -> str:
    data = path.read_bytes()
    if problem := _not_text(data):
        return problem
    lines = [line.split() for line in data.splitlines()]
    starts = [i for i, words in enumerate(lines) if len(words) == 1 and words[0].isdigit()]
    if not starts:
        return "what came is not an AMC file"
    end = starts[1] if len(starts) > 1 else len(lines)
    first = [(words[0], len(words)) for words in lines[starts[0] + 1 : end] if words]
    last = [(words[0], len(words)) for words in lines[starts[-1] + 1 :] if words]
    is_whole = first == last and data.endswith((b"\n", b"\r"))
    return "" if first and is_whole else "what came is not a whole AMC file"


def _check_zip(path: Path) -> str:
    return "" if zipfile.is_zipfile(path) else "what came is not a whole archive"


def _not_text(data: bytes) -> str:
    if data[:200].lstrip()[:1] == b"<":
        return "the server sent a web page instead of the file"
    return "what came is not a text" if b"\0" in data else ""


CHECKS: Final[dict[str, Check]] = {".asf": _check_asf, ".amc": _check_amc, ".zip": _check_zip}
"""What is wrong with a complete file, by the ending of its name; empty if nothing."""
