"""Names on pictures: readable, that is none over another and all in the picture."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from localreg.view.labels import Box, placed, write_names

WIDTH, HEIGHT = 400.0, 300.0


@given(
    points=st.lists(
        st.tuples(st.floats(-50.0, 450.0), st.floats(-50.0, 350.0)), min_size=0, max_size=9
    ),
    wide=st.floats(20.0, 70.0),
)
def test_no_label_covers_another_or_leaves_the_picture(
    points: list[tuple[float, float]], wide: float
) -> None:
    anchors = {f"t{i}": point for i, point in enumerate(points)}
    taken = (Box(0.0, 0.0, 120.0, 60.0),)
    sizes = dict.fromkeys(anchors, (wide, 14.0))
    boxes = placed(anchors, sizes, WIDTH, HEIGHT, taken)
    found = [*boxes.values(), *taken]
    for i, box in enumerate(found):
        assert not any(box.overlaps(other) for other in found[i + 1 :])
        assert box.left >= 0.0
        assert box.top >= 0.0
        assert box.right <= WIDTH
        assert box.bottom <= HEIGHT
    for name, box in boxes.items():
        x, y = anchors[name]
        assert 0.0 <= x < WIDTH
        assert 0.0 <= y < HEIGHT
        assert not (box.left < x < box.right and box.top < y < box.bottom), "beside, not over"


def test_six_labels_in_one_place_are_all_there() -> None:
    anchors = {f"t{i}": (200.0, 150.0 + 0.1 * i) for i in range(6)}
    assert len(placed(anchors, dict.fromkeys(anchors, (50.0, 14.0)), WIDTH, HEIGHT)) == 6


def test_words_change_the_picture_where_they_stand_and_nowhere_else() -> None:
    picture = np.full((300, 400, 3), 120, dtype=np.uint8)
    named = write_names(picture, {"head": (300.0, 200.0)})
    assert np.all(picture == 120), "the picture itself is left alone"
    rows, columns = np.nonzero(np.any(named != 120, axis=2))
    assert 280 < columns.min() < columns.max() < 380
    assert 185 < rows.min() < rows.max() < 215
    titled = write_names(picture, {}, title="walk", subtitle="1.00 s")
    rows, columns = np.nonzero(np.any(titled != 120, axis=2))
    assert rows.max() < 60
    assert columns.max() < 80
    assert np.array_equal(write_names(picture, {"gone": (-5.0, 10.0)}), picture)
