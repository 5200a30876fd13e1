"""Words on pictures: names beside the things they name, never one over another."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray
from PIL import Image, ImageDraw, ImageFont

_INK: Final = (38, 41, 46)
_SOFT: Final = (92, 96, 104)
_PLATE: Final = (255, 255, 255, 205)
_SMALLEST: Final = 9  # smaller letters cannot be read [pixels]


@dataclass(frozen=True, slots=True)
class Box:
    """A rectangle of a picture [pixels]."""

    left: float
    top: float
    right: float
    bottom: float

    def overlaps(self, other: "Box") -> bool:
        """Whether the two share any pixel."""
        return (
            self.left < other.right
            and other.left < self.right
            and self.top < other.bottom
            and other.top < self.bottom
        )


def placed(
    anchors: Mapping[str, tuple[float, float]],
    sizes: Mapping[str, tuple[float, float]],
    width: float,
    height: float,
    taken: tuple[Box, ...] = (),
) -> dict[str, Box]:
    """Where labels go: beside their anchors, in the picture, none over another.

    Each goes to the side that is away from the middle of all; where that is taken, to the
    nearest free place above or below, else to the other side.

    Args:
        anchors: what is named, by label [pixels].
        sizes: width and height of each label [pixels].
        width: of the picture [pixels].
        height: of the picture [pixels].
        taken: where no label may be.

    Returns:
        A box for every label whose anchor is in the picture and for which there is room.
    """
    boxes: dict[str, Box] = {}
    if not anchors:
        return boxes
    middle = float(np.mean([x for x, _ in anchors.values()]))
    for name, (x, y) in sorted(anchors.items(), key=lambda item: item[1][1]):
        if not (0.0 <= x < width and 0.0 <= y < height):
            continue
        wide, high = sizes[name]
        gap = 1.6 * high
        left, right = x - gap - wide, x + gap
        for near, shift in _tries(left, right, first_left=x < middle, step=0.5 * high):
            top = y - 0.5 * high + shift
            box = Box(near, top, near + wide, top + high)
            inside = box.left >= 0 and box.top >= 0 and box.right <= width and box.bottom <= height
            if inside and not any(box.overlaps(other) for other in (*boxes.values(), *taken)):
                boxes[name] = box
                break
    return boxes


def write_names(
    picture: UInt8[ndarray, "height width 3"],
    anchors: Mapping[str, tuple[float, float]],
    *,
    title: str = "",
    subtitle: str = "",
    size: int | None = None,
) -> UInt8[ndarray, "height width 3"]:
    """A picture with words on it.

    Args:
        picture: is not changed.
        anchors: what is named, by name; a thin line leads there [pixels].
        title: in the upper left corner.
        subtitle: below it.
        size: of the names' letters; by default fitting the picture [pixels].
    """
    height, width = picture.shape[:2]
    letters = max(_SMALLEST, size if size is not None else round(height / 45))
    image = Image.fromarray(picture).convert("RGBA")
    plates = Image.new("RGBA", image.size, (0, 0, 0, 0))
    draw = ImageDraw.Draw(plates)
    font = ImageFont.load_default(letters)
    head = _write_head(draw, title, subtitle, letters)
    pad = 0.3 * letters
    sizes = {
        name: (draw.textlength(name, font=font) + 2 * pad, letters + 2 * pad) for name in anchors
    }
    taken = () if head is None else (head,)
    for name, box in placed(anchors, sizes, width, height, taken).items():
        x, y = anchors[name]
        edge = box.right if box.right < x else box.left
        draw.line([(x, y), (edge, 0.5 * (box.top + box.bottom))], fill=(*_SOFT, 150), width=1)
        corners = [box.left, box.top, box.right, box.bottom]
        draw.rounded_rectangle(corners, radius=pad, fill=_PLATE)
        middle = (0.5 * (box.left + box.right), 0.5 * (box.top + box.bottom))
        draw.text(middle, name, font=font, fill=_INK, anchor="mm")
    return np.asarray(Image.alpha_composite(image, plates).convert("RGB"))


def _write_head(draw: ImageDraw.ImageDraw, title: str, subtitle: str, letters: int) -> Box | None:
    if not title and not subtitle:
        return None
    large, small = ImageFont.load_default(1.5 * letters), ImageFont.load_default(letters)
    left, top = 1.4 * letters, 1.1 * letters
    draw.text((left, top), title, font=large, fill=_INK)
    below = top + (2.0 * letters if title else 0.0)
    draw.text((left, below), subtitle, font=small, fill=_SOFT)
    wide = max(draw.textlength(title, font=large), draw.textlength(subtitle, font=small))
    return Box(0.0, 0.0, left + wide, below + 1.6 * letters)


def _tries(
    left: float, right: float, *, first_left: bool, step: float
) -> list[tuple[float, float]]:
    """Places from the best to the worst: left edge, and shift downwards [pixels]."""
    sides = (left, right) if first_left else (right, left)
    shifts = [0.0]
    for n in range(1, 9):
        shifts += [n * step, -n * step]
    return [(side, shift) for side in sides for shift in shifts]
