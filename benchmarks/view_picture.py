"""The picture `figures/side_by_side.png`: one instant of a walk that the database never saw.

    python -m benchmarks.view_picture

Truth, synthesis with its trackers (one of them masked), and both in one place.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from localreg.database import PoseDatabase
from localreg.drawing.scene import GREEN
from localreg.evaluation.trackers import Loss, TrackerQuality, simulate_trackers
from localreg.motion.sources import read_sources
from localreg.synthesis.methods import METHODS, build_synthesizer
from localreg.view.footage import Footage
from localreg.view.pictures import Feature, Shot, Studio, write_png
from localreg.view.scene import Style

FIGURE = Path(__file__).parent / "figures" / "side_by_side.png"
PANEL, HEIGHT, GAP = 460, 560, 4
MASKED = "rhand"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--clip", default="16_22")
    parser.add_argument("--time", type=float, default=0.85, help="the instant [s]")
    parser.add_argument("--out", type=Path, default=FIGURE)
    arguments = parser.parse_args()
    motions, _ = read_sources(["sample"])
    database = PoseDatabase.build(motions)
    truth = next(m for m in motions if m.provenance.name == arguments.clip).resampled(40.0)
    quality = TrackerQuality(losses=(Loss(MASKED, arguments.time - 0.3, 0.6),))
    trackers = simulate_trackers(truth, quality)
    allowed = database.exclude(clip=arguments.clip)
    estimator = build_synthesizer(METHODS["localreg"], truth.subject, database, allowed)
    state, poses = estimator.init(trackers.frame(0)), []
    for frame in trackers:
        state, pose = estimator.step(state, frame)
        poses.append(pose)
    synthesis = replace(truth, qpos=np.array([pose.qpos for pose in poses]))
    seen = Footage(
        synthesis,
        frames=list(trackers),
        ghost=truth,
        confidence=np.array([pose.confidence for pose in poses]),
    ).on_floor()
    true = Footage(truth).on_floor()
    bare = Style(measured=False, predicted=False, errors=False, trails=False)
    panels = (
        (Feature(true, GREEN, "truth"), bare),
        (Feature(replace(seen, ghost=None), caption="synthesis from six trackers"),
         Style(labels=True)),
        (Feature(seen, caption="synthesis, truth in green"), replace(bare, look="diamonds")),
    )  # fmt: skip
    pictures = []
    for feature, style in panels:
        # Twice the size, reduced: smoother than the graphics' own sampling.
        with Studio([feature], Shot(2 * PANEL, 2 * HEIGHT, style=style)) as studio:
            for time in np.arange(max(0.0, arguments.time - 1.0), arguments.time, 0.1):
                studio.picture(float(time))
            large = studio.picture(arguments.time)
        blocks = large.reshape(HEIGHT, 2, PANEL, 2, 3)
        pictures.append(blocks.mean(axis=(1, 3)).round().astype(np.uint8))
        pictures.append(np.full((HEIGHT, GAP, 3), 255, dtype=np.uint8))
    write_png(np.concatenate(pictures[:-1], axis=1), arguments.out)
    print(f"{arguments.out}: {arguments.out.stat().st_size / 1024:.0f} kB")


if __name__ == "__main__":
    main()
