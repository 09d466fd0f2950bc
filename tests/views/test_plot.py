"""Pictures: the right cell in the right place, the same bytes each time."""

import io
import sys

import numpy as np
import pytest

from navbake.errors import MissingDependencyError, NavbakeError, QueryError
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.views.colors import FREE, MARKS, NO_FLOOR, OCCUPIED
from navbake.views.plot import Mark, plot_grid, render_png

pytest.importorskip("matplotlib")


def make_level(width=30, height=20, x_min=-1.0, y_max=2.0, ground=0.0, name="sceneId"):
    """Free, but for the top left quarter (no floor) and the bottom right one (occupied)."""
    free = np.ones((height, width), dtype=bool)
    floor = np.full((height, width), ground, dtype=np.float32)
    free[: height // 2, : width // 2] = False
    floor[: height // 2, : width // 2] = np.nan
    free[height // 2 :, width // 2 :] = False
    return SceneGrid2D(
        width=width,
        height=height,
        cell_size=0.1,
        min_yup=(x_min, ground, -y_max),
        weights=np.where(free, 1.0, np.inf),
        attributes={"floorHeight": floor},
        metadata={"sceneId": name},
    )


@pytest.fixture
def house():
    return MultiLevelGrid(grids=[make_level(), make_level(ground=2.8)], cell_size=0.1)


def pixels(png):
    from matplotlib.image import imread

    return (imread(io.BytesIO(png), format="png")[..., :3] * 255).round().astype(int)


def color(text):
    return np.array(list(bytes.fromhex(text.removeprefix("#"))))


def test_row_0_is_at_the_top_and_column_0_at_the_left():
    image = pixels(render_png(make_level()))
    # the occupancy panel: where its three colours are, left half of the picture
    left = image[:, : image.shape[1] // 2]
    middle = {}
    for kind in (FREE, OCCUPIED, NO_FLOOR):
        rows, cols = np.nonzero((left == color(kind)).all(axis=2))
        panel = rows < image.shape[0] * 0.85  # not the legend
        middle[kind] = rows[panel].mean(), cols[panel].mean()
    assert middle[NO_FLOOR][0] < middle[FREE][0] < middle[OCCUPIED][0]
    assert middle[NO_FLOOR][1] < middle[FREE][1] < middle[OCCUPIED][1]


def test_same_grid_same_bytes(house):
    assert render_png(house) == render_png(house)
    assert b"matplotlib" not in render_png(house).lower()


def test_a_row_for_each_level(house):
    both, one = pixels(render_png(house)), pixels(render_png(house, level=1))
    assert both.shape[0] > 1.6 * one.shape[0]
    assert both.shape[1] == one.shape[1]


@pytest.mark.parametrize("level", [-1, 2])
def test_refuses_a_level_that_there_is_not(house, level):
    with pytest.raises(QueryError, match=f"no level {level}: expected 0 to 1"):
        render_png(house, level=level)


def test_names_are_no_markup():
    assert render_png(make_level(name="$x_{ [b]$")).startswith(b"\x89PNG")


@pytest.mark.parametrize("shape", [(1, 1), (400, 1), (1, 400)])
def test_any_shape(shape):
    grid = make_level(*shape)
    assert pixels(render_png(grid)).shape[2] == 3


def test_writes_the_file_whole_or_not_at_all(tmp_path, house):
    path = tmp_path / "house.png"
    path.write_bytes(b"before")
    assert plot_grid(house, path) == path
    assert path.read_bytes() == render_png(house)
    assert [p.name for p in tmp_path.iterdir()] == ["house.png"]
    with pytest.raises(NavbakeError, match=r"cannot write .*none.*house\.png"):
        plot_grid(house, tmp_path / "none" / "house.png")


def test_uses_no_global_state(house):
    render_png(house)
    if "matplotlib.pyplot" in sys.modules:
        from matplotlib import pyplot

        assert pyplot.get_fignums() == []


def test_tells_how_to_get_matplotlib(monkeypatch, house):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingDependencyError, match=r'pip install "navbake\[plot\]"'):
        render_png(house)


def test_marks_are_drawn_on_their_level_or_on_all(house):
    plain = pixels(render_png(house, layers=("occupancy",)))
    colored = []
    for level in (0, 1, -1):
        marks = [Mark(level, 0.5, 1.0, "floor off"), Mark(level, 1.5, 0.5, "path touches")]
        drawn = pixels(render_png(house, layers=("occupancy",), marks=marks))
        assert drawn.shape == plain.shape
        is_mark = [np.abs(drawn - color(c)).max(axis=-1) < 8 for c in MARKS[:2]]
        half = len(drawn) // 2
        colored.append([(mark[:half].sum(), mark[half:].sum()) for mark in is_mark])
    for first, second, both in zip(*colored, strict=True):
        assert first[0] > second[0] and second[1] > first[1]
        assert both == (first[0], second[1])
