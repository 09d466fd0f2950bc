"""Tables fit the terminal, and no name is broken or sends escape codes."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from navbake.cli.printing import (
    lay_out,
    make_table,
    print_error,
    print_tables,
    room_table,
    without_empty_columns,
)
from navbake.navgrid.rooms import Room

LONG = "living_room/shelf_left/collision_mesh_17"
HEADINGS = ("id", "geom", "body", "why")


def test_a_wide_table_has_one_line_a_row():
    table = make_table(HEADINGS, [(1, "a", "b c", "it counts")], numbers=("id",))
    assert lay_out(table, 80) == ["id  geom  body  why", " 1  a     b c   it counts"]


def test_no_name_is_broken_in_80_columns():
    row = (7, LONG, "shelf", "excluded: its body matches the pattern of `scene.exclude.bodies`")
    lines = lay_out(make_table(HEADINGS, [row]), 80)
    assert max(map(len, lines)) <= 80
    assert any(LONG in line for line in lines)
    assert len(lines) > 2


def test_rows_become_blocks_where_names_leave_no_room():
    lines = lay_out(make_table(HEADINGS, [(7, LONG, LONG, "it counts")] * 2), 80)
    assert lines[:4] == ["id    7", f"geom  {LONG}", f"body  {LONG}", "why   it counts"]
    assert lines[4] == "" and lines[5:] == lines[:4]


@settings(suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(
    st.lists(st.lists(st.text("ab 語\x1b", max_size=30), min_size=3, max_size=3), max_size=4),
    st.integers(10, 90),
)
def test_every_word_stays_whole(rows, width):
    table = make_table(("one", "two", "three"), rows)
    printed = set(" ".join(lay_out(table, width)).split())
    for row in table.rows:
        assert printed >= {word for cell in row for word in cell.split()}


def test_what_a_row_is_called_stays_on_one_line_where_there_are_no_headings():
    lines = lay_out(make_table(("", ""), [("agent max slope", "some words to wrap")]), 24)
    assert lines[0] == "agent max slope  some"
    assert len(lines) == 3


def test_wide_characters_take_two_columns():
    lines = lay_out(make_table(("name", "n"), [("厨房", 1), ("hall", 2)]), 80)
    assert lines[1:] == ["厨房  1", "hall  2"]


def test_columns_without_anything_are_left_out():
    table = without_empty_columns(make_table(("a", "b", "c"), [(1, "", 2), (3, "", "")]))
    assert lay_out(table, 80) == ["a  c", "1  2", "3"]


def test_a_terminal_gets_what_fits_and_a_pipe_everything(monkeypatch, capsys):
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
    text = "\n".join(lay_out(make_table(("name", "n"), [(name, 1)]), 80))
    assert name not in text
    assert text.replace("\n", "").isprintable()


def room(number):
    return Room(
        id=f"0:{number}", name=None, level=0, index=number, area=12.0, centroid=(1.0, 2.0, 0.0),
        neighbours=[], source="auto", outdoors=False,
    )  # fmt: skip


def test_rooms_of_one_level_have_short_rows():
    lines = lay_out(room_table([room(n) for n in range(1, 51)], ["ground floor"]), 80)
    assert len(lines) == 51
    assert lines[0].split() == ["id", "m2", "centroid", "x", "y", "z", "m", "from"]
