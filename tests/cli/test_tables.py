"""Tables fit the terminal, and no name is broken or sends escape codes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from navbake.auditor.facts import Remark
from navbake.cli.printing import VERBOSITY, lay_out_table, print_error, print_tables
from navbake.lengths import format_length, format_position
from navbake.navgrid.rooms import Room
from navbake.views.tables import make_level_table, make_room_table, make_table

LONG = "living_room/shelf_left/collision_mesh_17"
HEADINGS = ("id", "geom", "body", "why")


def test_a_wide_table_has_one_line_a_row():
    table = make_table(HEADINGS, [(1, "a", "b c", "it counts")], numbers=("id",))
    assert lay_out_table(table, 80) == ["id  geom  body  why", " 1  a     b c   it counts"]


def test_cells_are_wrapped_where_a_row_is_wider_than_the_terminal():
    row = (7, LONG, "shelf", "excluded: its body matches the pattern of `scene.exclude.bodies`")
    lines = lay_out_table(make_table(HEADINGS, [row], numbers=("id",)), 80)
    assert max(map(len, lines)) <= 80 < len(lay_out_table(make_table(HEADINGS, [row]))[1])
    assert len(lines) > 2


@given(
    st.lists(st.lists(st.text("ac 語\r", max_size=30), min_size=3, max_size=3), max_size=4),
    st.one_of(st.integers(20, 90), st.none()),
)
def test_every_character_is_printed(rows, width):
    table = make_table(("1", "2", "3"), rows)
    printed = "".join(lay_out_table(table, width))
    for letter in "ac語":
        assert printed.count(letter) == sum(cell.count(letter) for row in rows for cell in row)


def test_wide_characters_take_two_columns():
    lines = lay_out_table(make_table(("name", "n"), [("厨房", 1), ("hall", 2)]), 80)
    assert lines[1:] == ["厨房  1", "hall  2"]


def test_columns_without_anything_are_left_out():
    table = make_table(("a", "b", "c"), [(1, "", 2), (3, "", "")]).without_empty_columns()
    assert lay_out_table(table, 80) == ["a  c", "1  2", "3"]


def test_a_terminal_gets_what_fits_and_a_pipe_everything(monkeypatch, capsys):
    monkeypatch.setattr(VERBOSITY, "as_json", False)  # a command that ran before leaves its own
    table = make_table(HEADINGS, [(7, LONG, "shelf", "some words to wrap " * 5)])
    print_tables(table)
    assert len(capsys.readouterr().out.splitlines()) == 2
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    monkeypatch.setenv("COLUMNS", "80")
    print_tables(table)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80 and len(lines) > 2


def test_tables_may_be_printed_where_stdout_is_closed(monkeypatch):
    monkeypatch.setattr("sys.stdout", None)
    print_tables(make_table(("name", "n"), [("hall", 2)]))


def test_errors_are_not_printed_on_stdout_where_stderr_is_closed(monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr", None)
    print_error("no such file")
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("name", ["\x1b[2Jroom", "room\x9b31m", "a\nb", "\u202eroom"])
def test_control_characters_are_shown(name):
    text = "\n".join(lay_out_table(make_table(("name", "n"), [(name, 1)]), 80))
    assert name not in text
    assert text.replace("\n", "").isprintable()


def room(number):
    return Room(
        id=f"0:{number}", name=None, level=0, index=number, area=12.0, centroid=(1.0, 2.0, 0.0),
        neighbours=[], source="auto", outdoors=False,
    )  # fmt: skip


def test_rooms_of_one_level_have_short_rows():
    lines = lay_out_table(make_room_table([room(n) for n in range(1, 51)], ["ground floor"]), 80)
    assert len(lines) == 51
    assert lines[0].split() == ["id", "m2", "centroid", "x", "y", "z", "m", "from"]


def test_positions_have_six_digits_and_no_minus_zero():
    assert format_position(np.array([-0.0, -1e-9, 1234.5678, 1e-5])) == "0, 0, 1234.57, 1e-05"
    assert format_position((1, -2.5)) == "1, -2.5"
    assert format_position((448262.254, -5411932.2, 1e9)) == "448262.25, -5411932.2, 1000000000"


def test_no_length_is_minus_zero():
    assert format_length(-0.004) == "0.00" and format_length(-0.006) == "-0.01"
    assert format_length(np.float32(-0.0004), 3) == "0.000"
    assert str(Remark("", "error", 0, (-0.001, 2.0, -0.0), "odd")) == (
        "error: level 0 (0.00, 2.00, 0.00): odd"
    )
    level = dict.fromkeys(("floor_area", "free_area", "largest_island_area"), 1.0)
    level |= dict.fromkeys(("ground", "floor_min", "floor_max"), -0.0004)
    level |= {"name": "a", "width": 1, "height": 1, "num_islands": 1, "num_rooms": 0}
    (row,) = make_level_table({"levels": [level]}).rows
    assert row[3:5] == ["0.000", "0.000 to 0.000"]
