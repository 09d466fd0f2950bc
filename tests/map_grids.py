"""Grids to write as maps: the samples, small ones that are asymmetric, and random ones."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import navbake
from grid_maps import level_from
from project_paths import GOLDEN

SAMPLES = ("apartment", "clutter", "house", "terrain", "warehouse")
SMALL = """
..#.+
.+ ..
#...#
"""


def sample(name):
    return navbake.load(GOLDEN / f"{name}.grid.json.gz")


def small(**fields):
    """5 × 3 cells with one of each kind, off the origin."""
    return level_from(SMALL, **{"cell_size": 0.1, "x": -3.7, "y_max": 12.4, **fields})


def random_level(seed, shape=(23, 37), cell_size=0.05, corner=(-12.5, 31.25)):
    """A level of cells that know nothing of each other, neither square nor at the origin."""
    rng = np.random.default_rng(seed)
    text = "\n".join("".join(row) for row in rng.choice(list("...##+ "), size=shape))
    text = "\n".join(f"{row[:-1]}." for row in text.split("\n"))  # `level_from` strips lines
    return level_from("." + text[1:], cell_size, *corner, ground=0.4)


CELLS = arrays(
    np.int8, st.tuples(st.integers(1, 9), st.integers(1, 9)), elements=st.sampled_from([-1, 0, 100])
)
"""Values of a map: unknown, free, occupied."""
