"""Names lie over no other name, and inside their rooms and the map."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from navbake.views.drawing import fonts
from navbake.views.drawing.fonts import FONT, UNKNOWN, Text, find_text
from navbake.views.drawing.label_boxes import POINTS, place_labels
from navbake.views.panel import Label

pytest.importorskip("matplotlib")
MAP = (4.0, 3.0)  # inches


def room(text, x, y, width, height, number=1):
    return Label(text, "0:1", x, y, width, height, number)


def place(*labels, scale=1.0):
    return place_labels(labels, (0.0, 0.0), scale, MAP)


def test_a_name_that_fits_is_large_and_in_the_middle():
    [name] = place(room("hall", 2.0, 1.5, 3.0, 2.0))
    assert (name.text.text, name.points, name.x, name.y) == ("hall", POINTS[0], 2.0, 1.5)
    assert name.number is None and name.name == ""


def test_a_name_is_smaller_then_broken_then_a_number_then_nothing():
    width, height = Text("living room").size(POINTS[0])
    [broken] = place(room("living room", 2.0, 1.5, width * 0.7, 1.0))
    assert (broken.text.text, broken.points) == ("living\nroom", POINTS[0])
    [small] = place(room("living room", 2.0, 1.5, width * 0.9, height))
    assert (small.text.text, small.points) == ("living room", POINTS[1])
    [number] = place(room("living room", 2.0, 1.5, width / 5, height, number=7))
    assert (number.text.text, number.number, number.name) == ("7", 7, "living room")
    assert place(room("living room", 2.0, 1.5, 0.01, height)) == []


def test_names_of_large_rooms_come_first_and_others_keep_clear():
    one = room("a large room", 2.0, 1.5, 3.0, 2.0, 1)
    other = room("another", 2.1, 1.52, 2.0, 1.0, 2)
    for labels in ((one, other), (other, one)):
        assert [name.text.text for name in place(*labels)] == ["a large room"]


def test_a_name_of_a_point_stands_beside_it_and_clear_of_other_points():
    doors = [Label(f"door {n} 0.9 m", "0.9 m", 1.0 + n * 0.3, 1.5, 0.0, 0.0, n) for n in range(4)]
    written = place(*doors)
    assert len(written) == 4
    for name in written:
        for door in doors:
            inside_x = name.box.left < door.x < name.box.right
            assert not (inside_x and name.box.bottom < door.y < name.box.top)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_boxes_are_apart_and_on_the_map(seed):
    rng = np.random.default_rng(seed)
    labels = []
    for number in range(int(rng.integers(1, 25))):
        x, y = rng.uniform(0, 4), rng.uniform(0, 3)
        size = (0.0, 0.0) if rng.random() < 0.3 else rng.uniform(0.02, 2, 2)
        labels.append(room("name " * int(rng.integers(1, 5)), x, y, *map(float, size), number))
    written = place(*labels)
    assert not any(a.box.meets(b.box) for a, b in combinations(written, 2))
    for name in written:
        assert 0 <= name.box.left < name.box.right <= MAP[0]
        assert 0 <= name.box.bottom < name.box.top <= MAP[1]
        width, height = name.text.size(name.points)
        assert width <= name.box.right - name.box.left + 1e-9
        assert height <= name.box.top - name.box.bottom + 1e-9


def test_a_text_is_as_large_as_it_is_drawn():
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 2), dpi=200)
    canvas = FigureCanvasAgg(figure)
    for text, points in (
        ("hall", 9.0),
        ("living_room", 7.0),
        ("two\nlines", 8.0),
        ("küche $x$", 9.0),
    ):
        drawn = figure.text(0.1, 0.5, text, **Text(text).style(points))
        box = drawn.get_window_extent(canvas.get_renderer())
        width, height = Text(text).size(points)
        assert width == pytest.approx(box.width / 200, abs=0.01)
        assert height == pytest.approx(box.height / 200, abs=0.03)


def test_a_text_is_cut_where_it_is_too_wide():
    text = Text("a rather long name of a scene")
    cut = text.cut(9.0, 0.8)
    assert cut.size(9.0)[0] <= 0.8
    assert cut.text.endswith("…") and text.text.startswith(cut.text[:-1].strip())
    assert (
        Text(cut.text[:-1] + text.text[len(cut.text) - 1 : len(cut.text) + 1] + "…").size(9.0)[0]
        > 0.8
    )
    assert text.cut(9.0, 10.0) == text


def test_letters_that_no_font_has(monkeypatch):
    assert find_text("кухня") == Text("кухня", FONT)
    assert find_text("a\x1bb").text == r"a\x1bb"  # what can't be printed is escaped
    monkeypatch.setattr(fonts, "_font_for", lambda letters: FONT if max(letters) < "z" else None)
    assert find_text("a客b", "0:3") == Text("0:3")
    assert find_text("a客b") == Text(f"a{UNKNOWN}b")
