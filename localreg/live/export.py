"""Writes poses that a run left in a folder to a motion file, in a process of its own.

Few imports, for it is started while the run goes on: `python -m localreg.live.export`.
"""

import os
import sys
from pathlib import Path

import numpy as np

from localreg.body.subject import read_subject
from localreg.errors import LocalregError
from localreg.motion.formats.registry import write_motion
from localreg.motion.motion import Motion, Provenance


def main(arguments: list[str]) -> int:
    """Write the motion that a run left in a folder."""
    os.nice(10)
    scratch, file, rate = Path(arguments[0]), Path(arguments[1]), float(arguments[2])
    qpos = np.load(scratch / "qpos.npy", allow_pickle=False)
    subject = read_subject(scratch / "subject.toml")
    try:
        write_motion(Motion(qpos, rate, subject, Provenance(file.stem)), file)
    except LocalregError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
