"""Texts that say the same of different things are one group."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from navbake.batch.page.reasons import Grouping, fold


@pytest.mark.parametrize(
    ("text", "folded"),
    [
        ("no scene file at scenes/a b.xml", "no scene file at … …"),
        (
            "broken XML in x/b.xml: no element: line 1, column 19",
            "broken XML in …: no element: line #, column #",
        ),
        (
            "MuJoCo cannot load a.mjb: Element 'gemo', line 3",
            "MuJoCo cannot load …: Element …, line #",
        ),
        ('got "5cm" at `grid.cell_size` in house.yaml', "got … at `grid.cell_size` in …"),
        ("a grid of 3.24e+10 cells: 18,000 x 18000 m", "a grid of # cells: # x # m"),
        ("it took more than 1.5 s", "it took more than # s"),
        ("0.5 m² of 30% at -3, +4.", "# m² of # at #, #."),
        ("geom12 and geom_7 can't meet", "… and … can't meet"),
        ("doesn't and isn't stay", "doesn't and isn't stay"),
        ("its process ended by SIGSEGV", "its process ended by SIGSEGV"),
        (r"cannot read C:\scenes\a.xml", "cannot read C:…"),
        ("expected <mujoco> or <robot> in model.xml", "expected <mujoco> or <robot> in …"),
        ("", ""),
    ],
)
def test_names_and_numbers_are_folded_and_settings_stay(text, folded):
    assert fold(text) == folded


@given(st.text(max_size=200))
def test_any_text_is_folded_once(text):
    assert fold(fold(text)) == fold(text)


def test_texts_are_numbered_once_and_grouped_with_how_they_failed():
    grouping = Grouping()
    given = [("line 1", "a"), ("line 2", "a"), ("line 1", "a"), ("line 1", "b")]
    assert [grouping.number(text, how) for text, how in given] == [0, 1, 0, 2]
    assert grouping.reasons == (
        [("a", "line 1"), ("a", "line 2"), ("b", "line 1")],
        [0, 0, 1],
        [("a", "line #"), ("b", "line 1")],
    )
    assert grouping.numbers(["line 9", "line 9"]) == [3, 3]
