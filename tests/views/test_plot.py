"""Pictures: the right cell in the right place, the same bytes each time."""

import io
import math
import re
import sys
from itertools import combinations

import numpy as np
import pytest

import navbake
from navbake.errors import MissingDependencyError, NavbakeError, QueryError
from navbake.navgrid.colors import (
    CLOSED,
    DOOR,
    FREE,
    MARKS,
    NO_FLOOR,
    OCCUPIED,
    ROUTE,
    STAND,
    TARGET,
)
from navbake.navgrid.grid import MultiLevelGrid, SceneGrid2D
from navbake.navgrid.rooms import to_runs
from navbake.runtime.paths import Path as Route
from navbake.views import plot
from navbake.views.layers import Label, make_panel, paint
from navbake.views.plot import Overlays, plot_grid, render_picture
from project_paths import GOLDEN

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


def make_house():
    return MultiLevelGrid(grids=[make_level(), make_level(ground=2.8)], cell_size=0.1)


@pytest.fixture
def house():
    return make_house()


@pytest.fixture(scope="module")
def picture():
    """The bytes of the picture of a house, drawn once for several tests."""
    return render_picture(make_house())


def pixels(png):
    from matplotlib.image import imread

    return (imread(io.BytesIO(png), format="png")[..., :3] * 255).round().astype(int)


def color(text):
    return np.array(list(bytes.fromhex(text.removeprefix("#"))))


def test_row_0_is_at_the_top_and_column_0_at_the_left():
    image = pixels(render_picture(make_level()))
    # the occupancy panel: where its three colours are, left half of the picture
    left = image[:, : image.shape[1] // 2]
    middle = {}
    for kind in (FREE, OCCUPIED, NO_FLOOR):
        rows, cols = np.nonzero((left == color(kind)).all(axis=2))
        panel = rows < image.shape[0] * 0.85  # not the legend
        middle[kind] = rows[panel].mean(), cols[panel].mean()
    assert middle[NO_FLOOR][0] < middle[FREE][0] < middle[OCCUPIED][0]
    assert middle[NO_FLOOR][1] < middle[FREE][1] < middle[OCCUPIED][1]


def test_same_grid_same_bytes(house, picture):
    assert render_picture(house) == picture
    assert b"matplotlib" not in picture.lower()


@pytest.mark.parametrize("setting", ["figure.autolayout", "figure.constrained_layout.use"])
def test_a_users_settings_of_the_layout_change_nothing(house, picture, setting):
    from matplotlib import rc_context

    with rc_context({setting: True}):
        assert render_picture(house) == picture


def test_a_row_for_each_level(house, picture):
    both, one = pixels(picture), pixels(render_picture(house, level=1))
    assert both.shape[0] > 1.6 * one.shape[0]
    assert both.shape[1] == one.shape[1]


@pytest.mark.parametrize("level", [-1, 2])
def test_refuses_a_level_that_there_is_not(house, level):
    with pytest.raises(QueryError, match=f"no level {level}: expected 0 to 1"):
        render_picture(house, level=level)


@pytest.mark.parametrize("shape", [(1, 1), (400, 1), (1, 400)])
def test_any_shape(shape):
    grid = make_level(*shape)
    assert pixels(render_picture(grid)).shape[2] == 3


def test_writes_the_file_whole_or_not_at_all(tmp_path, house, picture):
    path = tmp_path / "house.png"
    path.write_bytes(b"before")
    assert plot_grid(house, path) == path
    assert path.read_bytes() == picture
    assert [p.name for p in tmp_path.iterdir()] == ["house.png"]
    with pytest.raises(NavbakeError, match=r"cannot write .*none.*house\.png"):
        plot_grid(house, tmp_path / "none" / "house.png")


@pytest.mark.parametrize("name", ["house.bmp", "house.jpg", "house", "house.png.tmp"])
def test_a_picture_of_another_kind_is_refused_not_written_as_png(tmp_path, house, name):
    expected = r"expected a picture that ends in \.png, \.svg, \.pdf, got .*"
    with pytest.raises(QueryError, match=expected + re.escape(name)):
        house.plot(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_tells_how_to_get_matplotlib(monkeypatch, house):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(MissingDependencyError, match=r'pip install "navbake\[plot\]"'):
        render_picture(house)


def test_marks_are_drawn_on_their_level_or_on_all(house):
    plain = pixels(render_picture(house, layers=("occupancy",)))
    colored = []
    for level in (0, 1, -1):
        marks = [(level, 0.5, 1.0, "floor off"), (level, 1.5, 0.5, "path touches")]
        drawn = pixels(render_picture(house, layers=("occupancy",), overlays=Overlays(marks=marks)))
        assert drawn.shape[1] == plain.shape[1]
        is_mark = [np.abs(drawn - color(c)).max(axis=-1) < 8 for c in MARKS[:2]]
        # levels of one layer lie beside each other; the legend is below them
        above, half = drawn.shape[0] * 3 // 4, drawn.shape[1] // 2
        maps = [mark[:above] for mark in is_mark]
        colored.append([(mark[:, :half].sum(), mark[:, half:].sum()) for mark in maps])
    for first, second, both in zip(*colored, strict=True):
        assert first[0] > second[0] == 0 and second[1] > first[1] == 0
        assert both == (first[0], second[1])


def find(image, text, rows=slice(None)):
    """Rows and columns of a colour's pixels."""
    return np.nonzero((np.abs(image[rows] - color(text)) < 8).all(axis=2))


def test_every_cell_is_drawn_where_it_is():
    """Each cell's middle, found by the corners of the map, has the cell's colour."""
    level = make_level(width=12, height=8)
    rng = np.random.default_rng(0)
    level.weights[:] = np.where(rng.random(level.shape) < 0.5, 1.0, np.inf)
    level.weights[[0, 0, -1, -1], [0, -1, 0, -1]] = np.inf
    level.attributes["floorHeight"][:] = 0
    image = pixels(render_picture(level, layers=["occupancy"]))
    rows, cols = find(image, OCCUPIED, slice(0, image.shape[0] - 60))
    edges = rows.min(), rows.max() + 1, cols.min(), cols.max() + 1
    middle_rows = (edges[0] + (np.arange(8) + 0.5) / 8 * (edges[1] - edges[0])).astype(int)
    middle_cols = (edges[2] + (np.arange(12) + 0.5) / 12 * (edges[3] - edges[2])).astype(int)
    shown = image[np.ix_(middle_rows, middle_cols)]
    np.testing.assert_array_equal(shown, paint(make_panel(level, "occupancy", 0)))


@pytest.mark.parametrize("layers", [["occupancy"], ["occupancy", "floor"], ["rooms"] * 5])
def test_letters_are_readable_in_a_readme(layers):
    """830 pixels of a README show at most 8.3 inches, so 7.5 points are at least 10 pixels."""
    image = pixels(render_picture(make_level(), layers=layers))
    assert 150 * 4 < image.shape[1] <= 150 * 8.3 + 1


def test_the_background_is_light(picture):
    image = pixels(picture)
    edges = np.concatenate([image[:2].reshape(-1, 3), image[:, :2].reshape(-1, 3)])
    assert (edges == 255).all()


def test_svg_is_the_same_every_time_and_has_no_date(house, tmp_path):
    svg = render_picture(house, "svg")
    assert svg.startswith(b"<?xml") and b"<svg" in svg
    assert b"date" not in svg.lower() and b"Matplotlib v" not in svg
    assert plot_grid(house, tmp_path / "house.SVG").read_bytes() == svg


def test_svg_leaves_settings_as_they_are(house):
    from matplotlib import rcParams

    before = dict(rcParams)
    render_picture(house, "svg")
    assert dict(rcParams) == before


@pytest.mark.parametrize(
    "name", ['<b>&amp;"x"</b>', "$a_b$", "客厅", "a" * 500, "\x1b[31m", "שלום"]
)
def test_any_name_is_a_title(name, recwarn):
    from xml.etree import ElementTree

    grid = make_level(name=name)
    ElementTree.fromstring(render_picture(grid, "svg", layers=["occupancy"]))
    assert render_picture(grid, layers=["occupancy"]).startswith(b"\x89PNG")
    assert [str(warning.message) for warning in recwarn] == []


def test_a_path_is_blue_over_white_and_on_its_level(house):
    def route(level):
        ends = np.array([[-0.5, 0.3, 0.0], [1.5, 1.8, 0.0]])
        cells = np.array([[level, 16, 5], [level, 1, 24]])
        return Route(
            ends,
            np.full(2, level),
            cells,
            2.5,
            2.5,
            [],
            [],
            [],
            2.5,
            "cost",
            np.empty((0, 2), np.int64),
        )

    for level in (0, 1):
        image = pixels(
            render_picture(house, layers=["occupancy"], overlays=Overlays(route=route(level)))
        )
        above, half = image.shape[0] * 3 // 4, image.shape[1] // 2
        _, cols = find(image, ROUTE, slice(0, above))
        assert len(cols) > 200
        assert (cols // half == level).all()
        rows, _ = find(image, ROUTE, slice(above, None))
        assert len(rows) > 20  # the legend has it


def test_poses_and_the_cells_where_a_base_can_stand_are_drawn_on_their_level():
    house = navbake.load(GOLDEN / "house.grid.json.gz")
    finder = navbake.PathFinder(house)
    poses = finder.stand_poses("object:bed_1", count=4)
    level = finder.cell_at(poses.positions[0]).level
    region = finder.stand_region("object:bed_1")
    image = pixels(render_picture(house, layers=["occupancy"], overlays=Overlays(poses=poses)))
    shaded = pixels(
        render_picture(house, layers=["occupancy"], overlays=Overlays(poses=poses, region=region))
    )
    half = image.shape[1] // 2
    for what in (STAND, TARGET):
        _, cols = find(image, what, slice(0, image.shape[0] * 3 // 4))
        assert len(cols) > 40 and (cols // half == level).all()
    is_shaded = (image != shaded).any(axis=2)
    assert is_shaded.sum() > 1000 and (np.nonzero(is_shaded)[1] // half == level).all()


@pytest.mark.parametrize("seed", range(3))
def test_a_pose_has_the_outline_of_its_base(seed):
    house = navbake.load(GOLDEN / "house.grid.json.gz").levels[0]
    outline = [(0.4, 0.1), (-0.4, 0.1), (-0.4, -0.1), (0.4, -0.1)]  # longer than the arrow
    poses = navbake.PathFinder(house).stand_poses(
        "object:sofa", count=1, footprint=outline, reach=(0.4, 1.2), seed=seed
    )
    picture = render_picture(house, layers=["occupancy"], overlays=Overlays(poses=poses))
    image = pixels(picture)
    rows, cols = find(image, STAND, slice(0, image.shape[0] * 3 // 4))
    (heading,) = poses.headings
    high = 0.8 * abs(math.sin(heading)) + 0.2 * abs(math.cos(heading))
    wide = 0.8 * abs(math.cos(heading)) + 0.2 * abs(math.sin(heading))
    assert math.isclose(np.ptp(rows) / np.ptp(cols), high / wide, rel_tol=0.1)


@pytest.mark.parametrize("state", ["closed", "open"])
def test_doors_are_full_or_hollow_lines(state):
    level = make_level()
    cells = {"closed": [[0, to_runs(np.arange(5 * 30 + 18, 5 * 30 + 27))]], "open": []}
    door = {"id": "d", "state": state, "cells": cells, "solid": cells}
    level.metadata["navbake"] = {"doors": [door]}
    image = pixels(render_picture(level, layers=["occupancy"]))
    rows, cols = find(image, DOOR, slice(0, image.shape[0] * 8 // 10))
    column = image[rows.min() - 12 : rows.max() + 13, int(cols.mean())]
    is_door = np.abs(column - color(DOOR)).max(axis=1) < 90
    assert np.count_nonzero(np.diff(is_door, prepend=False, append=False)) == (
        2 if state == "closed" else 4  # one line, or the two edges of a hollow one
    )
    # nine cells of thirty: as long as the doorway is wide
    _, free_cols = find(image, FREE, slice(0, image.shape[0] * 8 // 10))
    cell = (free_cols.max() + 1 - free_cols.min()) / 30
    assert np.ptp(cols) + 1 == pytest.approx(9 * cell, abs=3)


def test_large_grids_are_drawn_in_bounded_detail():
    level = make_level(width=2500, height=1900)
    level.weights[:, 1200] = np.inf  # a thin wall is still seen
    level.attributes["floorHeight"][:] = 0
    level.weights[:950] = 1.0
    level.weights[:, 1200] = np.inf
    content = render_picture(level, layers=["occupancy"])
    image = pixels(content)
    assert len(content) < 300_000
    rows, cols = find(image, FREE, slice(0, image.shape[0] // 2))
    line = image[rows.min() + 40, cols.min() : cols.max() + 1]
    assert line.sum(axis=1).min() < color(FREE).sum() - 30


MAP = (4.0, 3.0)  # inches, and metres


def written(*labels, keep_clear=()):
    """What is written on a map of 4 by 3 m: each text, its box [m], and the key."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=MAP, dpi=plot.DPI)
    FigureCanvasAgg(figure)
    ax = figure.add_axes([0, 0, 1, 1], xlim=(0, MAP[0]), ylim=(0, MAP[1]))
    key = list(plot.write_names(ax, labels, keep_clear))
    # a box is the letters', without that of a point's name around them
    boxes = [text.get_window_extent().transformed(ax.transData.inverted()) for text in ax.texts]
    return [text.get_text() for text in ax.texts], boxes, key


def room(text, x, y, width, height, number=1):
    return Label(text, "0:1", x, y, width, height, number)


def test_a_name_stands_in_the_middle_of_its_room():
    [text], [box], key = written(room("hall", 2.0, 1.5, 3.0, 2.0))
    assert (text, key) == ("hall", [])
    assert ((box.p0 + box.p1) / 2).tolist() == pytest.approx([2.0, 1.5], abs=0.03)


def test_a_name_is_broken_then_a_number_then_nothing():
    [text], [box], _ = written(room("living room", 2.0, 1.5, 3.0, 2.0))
    width, height = box.width, box.height
    assert written(room("living room", 2.0, 1.5, width * 0.7, 1.0))[0] == ["living\nroom"]
    [text], [smaller], _ = written(room("living room", 2.0, 1.5, width * 0.9, height * 1.1))
    assert text == "living room" and smaller.width < width
    texts, _, key = written(room("living room", 2.0, 1.5, width / 5, height, number=7))
    assert (texts, key) == (["7"], ["7: living room"])
    assert written(room("living room", 2.0, 1.5, 0.01, height))[0] == []


def test_names_of_large_rooms_come_first_and_others_keep_clear():
    one = room("a large room", 2.0, 1.5, 3.0, 2.0, 1)
    other = room("another", 2.1, 1.52, 2.0, 1.0, 2)
    for labels in ((one, other), (other, one)):
        assert written(*labels)[0] == ["a large room"]


@pytest.mark.parametrize("seed", range(6))
def test_names_lie_over_no_other_and_on_the_map(seed):
    rng = np.random.default_rng(seed)
    labels = []
    for number in range(20):
        x, y = rng.uniform(0, 4), rng.uniform(0, 3)
        size = (0.0, 0.0) if rng.random() < 0.3 else rng.uniform(0.02, 2, 2)
        labels.append(room("name " * int(rng.integers(1, 5)), x, y, *map(float, size), number))
    texts, boxes, _ = written(*labels)
    assert texts
    for one, other in combinations(boxes, 2):
        assert not one.overlaps(other)
    for box in boxes:
        assert (box.p0 >= 0).all() and (box.p1 <= MAP).all()
        for label in labels:
            if not label.width:  # a point stays in sight
                assert not box.contains(label.x, label.y)


@pytest.mark.parametrize(("width", "levels", "layers"), [(400, 1, 3), (2, 150, 1), (30, 4, 5)])
def test_maps_are_apart_and_in_the_picture(width, levels, layers):
    from matplotlib.figure import Figure

    figure, panel = Figure(), make_panel(make_level(), "floor", 0)
    axes = plot.add_axes(figure, (0, 0, width, 10), [panel] * (levels * layers), layers)
    assert figure.get_figwidth() <= plot.MAX_WIDTH and figure.get_figheight() <= plot.MAX_HEIGHT + 1
    boxes = [ax.get_position() for ax in axes]
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    assert all((box.p0 >= 0).all() and (box.p1 <= 1).all() for box in boxes)


def test_long_titles_wrap_and_end_somewhere():
    text = plot.wrap_text("the storey between the ground and the gallery " * 9, 3.0)
    lines = text.split("\n")
    assert len(lines) == 3 and text.endswith("…")
    assert all(len(line) <= 3 * plot.LETTERS_PER_INCH for line in lines)
    long, short = (
        pixels(render_picture(MultiLevelGrid(grids=[make_level()] * 2, cell_size=0.1, metadata=m)))
        for m in ({"navbake": {"levels": [{"name": "a storey " * 9}] * 2}}, {})
    )
    assert long.shape[1] == short.shape[1]


@pytest.mark.parametrize("space", ["\u00a0", "\u202f", "\u3000", "\u2009"])
def test_spaces_of_all_kinds_are_drawn_as_they_are(space):
    text = plot.wrap_text(f"1:{space}hall   2:{space}Salle{space}de{space}bain", 9.0)
    assert text == f"1:{space}hall   2:{space}Salle{space}de{space}bain"
    assert plot.wrap_text("a\u200b\x07b", 9.0) == r"a\u200b\x07b"


def test_letters_that_no_font_has_are_known():
    families, missing = plot.choose_fonts("\u043a\u0443\u0445\u043d\u044f a\U000e0fff")
    assert families == [plot.FONT]
    assert missing <= {"\U000e0fff", "\\"}


def test_an_inflated_grid_names_its_radius_and_shows_what_it_closed():
    level = make_level()
    level.attributes["floorHeight"][:] = 0
    plain = pixels(render_picture(level, layers=["occupancy"]))
    inflated = level.inflate(0.2)
    inflated.metadata["sceneId"] = "house"
    image = pixels(render_picture(inflated, layers=["occupancy"]))
    above = image.shape[0] * 8 // 10
    assert len(find(image, CLOSED, slice(0, above))[0]) > 1000
    assert len(find(image, CLOSED, slice(above, None))[0]) > 50  # the legend has it
    assert not len(find(plain, CLOSED)[0])
    # the heading: the first dark rows, wider by the radius
    thin = pixels(render_picture(level.inflate(0.0), layers=["occupancy"]))
    plain_width, width, thin_width = (
        (pixels[:60] < 100).all(axis=2).any(axis=0).sum() for pixels in (plain, image, thin)
    )
    assert width > 2 * plain_width and thin_width > 2 * plain_width


def size_of(image):
    return image.shape[1], image.shape[0]


def test_bounds_show_a_part(house):
    level = make_level()
    part = pixels(render_picture(level, layers=["occupancy"], bounds=(-1.0, 0.2, 0.4, 0.9)))
    whole = pixels(render_picture(level, layers=["occupancy"]))
    assert not len(find(part, NO_FLOOR)[0]) and not len(find(part, OCCUPIED)[0])  # legend included
    assert len(find(part, FREE)[0]) > 20_000
    assert part.shape != whole.shape
    for bounds in [(1, 0, 0, 1), (5, 5, 6, 6), (0, 0, 1), (0, 0, np.nan, 1)]:
        with pytest.raises(QueryError, match=r"expected bounds x_min, y_min, x_max, y_max within"):
            render_picture(level, bounds=bounds)


def test_dpi_scales_the_picture_alone(house, picture):
    low, high = (size_of(pixels(render_picture(make_level(), dpi=dpi))) for dpi in (100, 300))
    assert high == pytest.approx((low[0] * 3, low[1] * 3), abs=3)
    assert render_picture(house, dpi=150) == picture
    with pytest.raises(QueryError, match="expected 30 to 1200 as dpi, got 5"):
        render_picture(make_level(), dpi=5)


def test_pdf_is_the_same_every_time_and_embeds_its_fonts(house, tmp_path):
    pdf = render_picture(house, "pdf", layers=["rooms"])
    assert pdf.startswith(b"%PDF") and b"/Type3" not in pdf and b"CreationDate" not in pdf
    assert plot_grid(house, tmp_path / "house.PDF", layers=["rooms"]).read_bytes() == pdf


def test_without_titles_the_map_begins_at_the_top():
    level = make_level()
    with_titles = pixels(render_picture(level, layers=["occupancy"]))
    without = pixels(render_picture(level, layers=["occupancy"], titles=False))
    first_rows = [
        int(np.flatnonzero((image < 250).any(axis=(1, 2)))[0]) for image in (with_titles, without)
    ]
    assert without.shape[0] < with_titles.shape[0] - 60
    map_rows = [find(image, NO_FLOOR)[0].min() for image in (with_titles, without)]
    assert map_rows[1] < 40 < map_rows[0] and first_rows[1] < 40


@pytest.mark.parametrize(("width", "layers"), [(12, 3), (12, 2), (60, 3), (200, 3)])
def test_titles_end_before_the_next_one(monkeypatch, width, layers):
    """The boxes of the letters of all titles, as they are drawn."""
    from matplotlib.figure import Figure
    from matplotlib.text import Text

    boxes = []
    draw = Figure.savefig

    def savefig(figure, *arguments, **options):
        renderer = figure.canvas.get_renderer()
        titles = [
            text
            for text in figure.findobj(Text)
            if text.get_text().startswith(("MEZZANINE", "the first", "grid"))
        ]
        boxes.extend(text.get_window_extent(renderer) for text in titles)
        assert max(box.x1 for box in boxes) <= figure.get_window_extent().width
        return draw(figure, *arguments, **options)

    monkeypatch.setattr(Figure, "savefig", savefig)
    levels = [make_level(width=width, height=80), make_level(width=width, height=80, ground=2.8)]
    names = [{"name": "MEZZANINE WWWWWWWWWWWW"}, {"name": "the first floor of the house"}]
    grid = MultiLevelGrid(grids=levels, cell_size=0.1, metadata={"navbake": {"levels": names}})
    render_picture(grid, layers=("occupancy", "floor", "clearance")[:layers])
    assert len(boxes) == 2 * layers + 1
    for one, other in combinations(boxes, 2):
        assert not one.overlaps(other)


def test_names_of_points_stay_off_the_leaves():
    label = Label("door_kitchen 0.9 m", "0.9 m", 2.0, 1.5, 0.0, 0.0, 1)
    keep_clear = [(2.2, 1.3, 3.5, 1.7), (0.5, 1.3, 1.8, 1.7)]
    [text], [box], _ = written(label, keep_clear=keep_clear)
    assert text == "door_kitchen 0.9 m"
    for x_min, y_min, x_max, y_max in keep_clear:
        assert box.x1 <= x_min or box.x0 >= x_max or box.y1 <= y_min or box.y0 >= y_max


def test_names_of_places_outside_of_the_map_are_left_out():
    assert written(room("hall", 9.0, 1.5, 3.0, 2.0))[0] == []


def test_a_key_says_what_a_number_stands_for():
    label = room("7: 3.25 m²", 2.0, 1.5, 0.15, 2.0, number=7)._replace(key_text="3.25 m²")
    assert written(label)[2] == ["7: 3.25 m²"]
