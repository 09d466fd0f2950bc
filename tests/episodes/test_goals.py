"""What the goals of episodes are called."""

from __future__ import annotations

import time

import pytest

from navbake.navgrid.user_data import find_category


@pytest.mark.parametrize(
    ("name", "category"),
    [
        ("chair_1", "chair"),
        ("Chair 12", "chair"),
        ("chair", "chair"),
        ("chair_", "chair_"),
        ("chair_1_2", "chair"),
        ("chair_1_b", "chair_1_b"),
        ("12", "12"),
        ("", ""),
    ],
)
def test_a_category_is_a_name_without_its_number(name, category):
    assert find_category(name) == category


@pytest.mark.parametrize("piece", ["_", "1", "_1", " "])
def test_time_is_linear_in_the_length(piece):
    begin = time.process_time()
    assert find_category(f"{piece * 100_000}x") == f"{piece * 100_000}x"
    assert time.process_time() - begin < 1
