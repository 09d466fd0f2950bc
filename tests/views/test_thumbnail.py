"""A thumbnail is a small picture of all levels."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

import navbake
from grid_maps import level_from
from level_maps import stairs
from navbake.navgrid.colors import FREE, OCCUPIED, rgb_of
from navbake.views.notebook import draw_levels
from navbake.views.thumbnail import COLORS, SIDE, draw_thumbnail
from project_paths import ROOT


def read(png):
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def test_few_colours_stay_as_they_are():
    grid = stairs("##00", "0000", "0000")
    np.testing.assert_array_equal(read(draw_thumbnail(grid)), np.asarray(draw_levels(grid, SIDE)))
    picture = read(draw_thumbnail(level_from("..#")))
    assert max(picture.shape) <= SIDE
    assert tuple(map(int, picture[0, 0])) == rgb_of(FREE)
    assert tuple(map(int, picture[0, -1])) == rgb_of(OCCUPIED)


def test_a_large_grid_becomes_small_and_has_about_its_colours():
    grid = navbake.bake(ROOT / "configs" / "apartment.yaml", grid={"cell_size": 0.03})
    png = draw_thumbnail(grid)
    picture, true = read(png), np.asarray(draw_levels(grid, SIDE)).astype(int)
    assert max(picture.shape) <= SIDE and len(png) < 5000
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) <= COLORS
    assert np.abs(picture - true).mean() < 3
    assert draw_thumbnail(grid) == png
