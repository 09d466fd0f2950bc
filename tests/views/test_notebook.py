"""What a notebook shows of a grid: every level, small, and no name that is HTML."""

from __future__ import annotations

import io
import re
from base64 import b64decode
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import navbake
from grid_maps import level_from
from level_maps import stairs
from navbake.navgrid.colors import FREE, NO_FLOOR, OCCUPIED, ROUTE, rgb_of
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.views.layers import make_panel
from navbake.views.notebook import (
    LEVEL_SIDE,
    MAX_LEVELS,
    PICTURE_SIDE,
    THUMBNAIL_COLORS,
    THUMBNAIL_SIDE,
    draw_levels,
    draw_path,
    draw_png,
    draw_thumbnail,
    render_html,
)
from project_paths import GOLDEN

PICTURE = re.compile(r'src="data:image/png;base64,([A-Za-z0-9+/=]+)"')


def read(png):
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def pictures_of(text):
    return [read(b64decode(found)) for found in PICTURE.findall(text)]


def plain(height, width, free=True, floor=0.0):
    shape = (height, width)
    return SceneGrid2D(
        width=width,
        height=height,
        cell_size=0.05,
        min_yup=(0.0, 0.0, 0.0),
        weights=np.full(shape, 1.0 if free else np.inf),
        attributes={"floorHeight": np.full(shape, floor, dtype=np.float32)},
    )


def test_a_cell_is_a_square_of_its_colour():
    level = level_from("..#\n...")
    level.attributes["floorHeight"] = np.array([[0, 0, 0], [np.nan, 0, 0]], dtype=np.float32)
    level.weights[1, 0] = np.inf
    side = PICTURE_SIDE // 3
    expected = make_panel(level, "rooms", 0).rgb.repeat(side, axis=0).repeat(side, axis=1)
    np.testing.assert_array_equal(read(draw_png(level)), expected)
    side = LEVEL_SIDE // 3
    [picture] = pictures_of(render_html(level))
    assert picture.shape == (2 * side, 3 * side, 3)
    corners = [picture[0, 0], picture[0, -1], picture[-1, 0]]
    assert [tuple(map(int, rgb)) for rgb in corners] == [
        rgb_of(FREE),
        rgb_of(OCCUPIED),
        rgb_of(NO_FLOOR),
    ]


@pytest.mark.parametrize("shape", [(4000, 4000), (1601, 3), (3, 801), (800, 800), (1, 1)])
def test_pictures_are_bounded(shape):
    level = plain(*shape)
    picture = read(draw_png(level))
    assert PICTURE_SIDE / 2 <= max(picture.shape[:2]) <= PICTURE_SIDE
    [small] = pictures_of(render_html(level))
    assert LEVEL_SIDE / 2 <= max(small.shape[:2]) <= LEVEL_SIDE
    assert (picture == rgb_of(FREE)).all()


def test_a_thin_wall_is_seen_in_a_large_grid():
    level = plain(4000, 4000)
    level.weights[:, 2001] = np.inf
    [picture] = pictures_of(render_html(level))
    column = picture[:, 2001 // 10]
    mean = np.round(0.9 * np.array(rgb_of(FREE)) + 0.1 * np.array(rgb_of(OCCUPIED)))
    np.testing.assert_allclose(column, np.broadcast_to(mean, column.shape), atol=1)


def test_every_level_is_shown_at_one_scale():
    grid = stairs("##00", "0000", "0000")
    pictures = pictures_of(render_html(grid))
    widths = [level.width for level in grid.levels]
    assert [p.shape[1] / w for p, w in zip(pictures, widths, strict=True)] == [
        LEVEL_SIDE // max(widths)
    ] * len(widths)
    assert max(read(draw_png(grid)).shape) <= PICTURE_SIDE


def test_many_levels_are_counted_and_some_are_shown():
    grid = MultiLevelGrid(grids=[plain(4, 4) for _ in range(MAX_LEVELS + 3)], cell_size=0.05)
    text = render_html(grid)
    assert len(pictures_of(text)) == MAX_LEVELS
    assert "19 levels" in text and "and 3 more" in text
    assert max(read(draw_png(grid)).shape) <= PICTURE_SIDE


def test_facts():
    level = level_from("..#\n...")
    level.metadata["sceneId"] = "den"
    text = render_html(level)
    assert "<b>den</b>: 1 level, cells of 0.1 m, 0 rooms, 0.1 m² free" in text
    assert "<b>level 0</b>: 3 × 2 cells, ground 0.00 m, 0 rooms, 0.1 m² free" in text


def test_names_are_escaped_and_cut():
    name = '"><script>alert(1)</script>\x1b[31m'
    level = level_from("...")
    level.metadata |= {"sceneId": name + "x" * 10_000, "navbake": {"levels": [{"name": name}]}}
    text = render_html(level)
    assert "<script" not in text and "\x1b" not in text
    assert "&lt;script&gt;" in text
    assert len(PICTURE.sub("", text)) < 2000


def test_methods_give_the_same_every_time():
    grid = level_from("..#\n...")
    # the names that notebooks ask for
    for name, draw in (("_repr_html_", render_html), ("_repr_png_", draw_png)):
        assert getattr(grid, name)() == draw(grid) == draw(level_from("..#\n..."))


def test_few_colours_stay_as_they_are():
    grid = stairs("##00", "0000", "0000")
    np.testing.assert_array_equal(
        read(draw_thumbnail(grid)), np.asarray(draw_levels(grid, THUMBNAIL_SIDE))
    )
    picture = read(draw_thumbnail(level_from("..#")))
    assert max(picture.shape) <= THUMBNAIL_SIDE
    assert tuple(map(int, picture[0, 0])) == rgb_of(FREE)
    assert tuple(map(int, picture[0, -1])) == rgb_of(OCCUPIED)


def test_a_large_grid_becomes_small_and_has_about_its_colours():
    grid = navbake.load(GOLDEN / "apartment.grid.json.gz")
    png = draw_thumbnail(grid)
    picture, true = read(png), np.asarray(draw_levels(grid, THUMBNAIL_SIDE)).astype(int)
    assert max(picture.shape) <= THUMBNAIL_SIDE and len(png) < 5000
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) <= THUMBNAIL_COLORS
    assert np.abs(picture - true).mean() < 3
    assert draw_thumbnail(grid) == png


def test_a_finder_shows_its_grid_and_a_path_its_way():
    house = navbake.load(GOLDEN / "house.grid.json.gz")
    finder = navbake.PathFinder(house)
    for name in ("_repr_html_", "_repr_png_"):  # by name, as a notebook does
        assert getattr(finder, name)() == getattr(house, name)()
    path = finder.find_path((0.0, -4.8, 0.0), "room:1:1")
    picture = read(getattr(path, "_repr_png_")())  # noqa: B009
    is_way = (picture == rgb_of(ROUTE)).all(axis=-1)
    half = picture.shape[1] // 2
    assert set(path.levels.tolist()) == {0, 1}
    assert is_way[:, :half].sum() > 50 and is_way[:, half:].sum() > 5  # of either storey
    assert not (read(draw_png(house)) == rgb_of(ROUTE)).all(axis=-1).any()
    assert draw_path(replace(path, grid=None)) is None
