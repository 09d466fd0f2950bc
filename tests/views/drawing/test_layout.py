"""Panels lie apart from each other and inside the picture, whatever their shape."""

from itertools import combinations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from navbake.views.drawing.fonts import Text
from navbake.views.drawing.footer import BETWEEN, Entry, flow
from navbake.views.drawing.layout import MAX_HEIGHT, WIDTH, plan_layout


def overlap(one, other, size):
    apart = abs(one[0] - other[0]) >= size[0] - 1e-9 or abs(one[1] - other[1]) >= size[1] - 1e-9
    return not apart


@given(
    st.floats(0.01, 5000),
    st.floats(0.01, 5000),
    st.integers(1, 12),
    st.lists(st.booleans(), min_size=1, max_size=8),
)
def test_panels_are_apart_and_inside(width, height, levels, bars):
    layout = plan_layout((width, height), levels, bars, footer=0.4)
    assert len(layout.corners) == levels * len(bars) == len(layout.title_widths)
    assert layout.width <= WIDTH + 1e-9
    for one, other in combinations(layout.corners, 2):
        assert not overlap(one, other, layout.map_size)
    for left, bottom in layout.corners:
        assert left >= 0 and left + layout.map_size[0] <= layout.width + 1e-9
        assert bottom >= 0.4 and bottom + layout.map_size[1] <= layout.height + 1e-9
    # one scale for both axes, unless a side would vanish
    if min(layout.map_size) > 0.03:
        scales = layout.map_size[0] / width, layout.map_size[1] / height
        assert scales[0] == pytest.approx(scales[1])


def test_a_row_for_each_level_and_a_column_for_each_layer():
    corners = plan_layout((10, 10), 2, [False, True], footer=0.4).corners
    assert corners[0][1] == corners[1][1] > corners[2][1] == corners[3][1]
    assert corners[0][0] == corners[2][0] < corners[1][0] == corners[3][0]


def test_levels_of_one_layer_lie_beside_each_other():
    first, second = plan_layout((10, 10), 2, [False], footer=0.4).corners
    assert first[1] == second[1] and first[0] < second[0]


def test_corridors_lie_below_each_other():
    corners = plan_layout((100, 2.5), 1, [False, True, True], footer=0.4).corners
    assert len({left for left, _ in corners}) == 1
    assert [y for _, y in corners] == sorted((y for _, y in corners), reverse=True)


def test_towers_stay_within_what_can_be_drawn():
    assert plan_layout((10, 10), 150, [False, True], footer=0.4).height <= MAX_HEIGHT + 1e-6


def test_the_legend_breaks_into_lines():
    pytest.importorskip("matplotlib")
    entries = [Entry(Text(f"meaning {n}"), 0.2, None) for n in range(12)]
    entries.append(Entry(Text("a long meaning " * 20), 0.2, None))
    lines = flow(entries, 4.0)
    assert sum(map(len, lines)) == len(entries)
    for line in lines:
        assert sum(entry.width for entry in line) + BETWEEN * (len(line) - 1) <= 4.0 + 1e-9
