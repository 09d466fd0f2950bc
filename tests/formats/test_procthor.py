"""ProcTHORMap: MolmoSpaces' formulas, written out here, find the cells that the grid has."""

import json

import numpy as np
import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo

import navbake
from map_grids import SAMPLES, random_level, sample, small
from navbake.errors import FormatError


class Map:
    """What MolmoSpaces makes of a file: `ProcTHORMap.load` and its formulas."""

    def __init__(self, path):
        image = Image.open(path)
        pixels = np.array(image)
        self.occupancy, self.room_map = pixels[:, :, 0] > 0, pixels[:, :, 2]
        np.testing.assert_array_equal(pixels[:, :, 0], pixels[:, :, 1])
        self.world_to_map = np.array(json.loads(image.info["world_to_map"]))
        self.map_to_world = np.array(json.loads(image.info["map_to_world"]))
        self.px_per_m = int(np.ceil(json.loads(image.info["px_per_m"])))
        names = json.loads(image.info["room_ids_to_name"])
        self.names = {int(k): v for k, v in names.items()}

    def pos_m_to_px(self, p):
        return np.round(np.c_[p, np.ones(len(p))] @ self.world_to_map.T).astype(int)

    def pos_px_to_m(self, px):
        return np.c_[px, np.ones(len(px))] @ self.map_to_world.T


def check_agrees(grid, level, found, num=100_000):
    rng = np.random.default_rng(7)
    x0, y0, x1, y1 = level.lattice.bounds
    points = np.c_[rng.uniform((x0, y0), (x1, y1), (num, 2)), rng.uniform(-5, 5, num)]
    px = found.pos_m_to_px(points)
    rows, cols = level.lattice.rows_cols(points)
    np.testing.assert_array_equal(px, np.c_[rows, cols])
    np.testing.assert_array_equal(found.occupancy[px[:, 0], px[:, 1]], level.free[rows, cols])
    np.testing.assert_array_equal(found.room_map[px[:, 0], px[:, 1]], level.room_index[rows, cols])
    # and the middle of a pixel is that of the cell
    middles = found.pos_px_to_m(np.c_[rows, cols])
    np.testing.assert_allclose(middles[:, :2], level.lattice.positions(rows, cols), atol=1e-9)
    assert (middles[:, 2] == level.ground).all()
    np.testing.assert_array_equal(found.pos_m_to_px(middles), px)


@pytest.mark.parametrize("name", SAMPLES)
def test_molmospaces_finds_the_same_free_cells_and_rooms(tmp_path, name):
    grid = sample(name)
    written = grid.to_procthor(tmp_path / "map.png", stairs="free")
    assert len(written) == len(grid.levels)
    for number, (path, level) in enumerate(zip(written, grid.levels, strict=True)):
        found = Map(path)
        check_agrees(grid, level, found)
        rooms = {room.index: room for room in grid.rooms if room.level == number}
        assert found.names == {k: room.name or room.id for k, room in rooms.items()}
        assert found.px_per_m == round(1 / level.lattice.cell_size)


@pytest.mark.parametrize("seed", range(3))
def test_off_the_origin_and_not_square(tmp_path, seed):
    level = random_level(seed)
    rng = np.random.default_rng(seed)
    rooms = rng.integers(0, 256, level.shape).astype(np.uint16)
    level = level.with_layers(attributes={"roomIndex": rooms})
    (path,) = level.to_procthor(tmp_path / "map.png")
    check_agrees(level, level, Map(path))
    back = navbake.from_procthor(path)
    np.testing.assert_array_equal(back.free, level.free)
    np.testing.assert_array_equal(back.room_index, rooms)
    assert back.lattice == pytest.approx(level.lattice, abs=1e-9)
    assert back.ground == level.ground


def test_the_house_comes_back(tmp_path):
    house = sample("house")
    (path,) = house.to_procthor(tmp_path / "map.png", level=1, radius=0.3)
    back, level = navbake.from_procthor(path), house.inflate(0.3).levels[1]
    np.testing.assert_array_equal(back.free, level.free)
    names = {room.index: room.name or room.id for room in house.rooms if room.level == 1}
    assert {room.index: room.name for room in back.rooms} == names
    assert back.ground == 3.0 and (back.floor == 3.0).all()
    back.save(tmp_path / "a.json")
    assert navbake.load(tmp_path / "a.json").rooms == back.rooms


def write_map(folder, level, turn, flips):
    """A map as MolmoSpaces might write it, with rows and columns along other axes."""
    cells = np.stack([level.free * 255, level.free * 255, level.room_index], axis=-1)
    lattice = level.lattice
    to_map = np.array(
        [
            [0, -1 / lattice.cell_size, 0, lattice.y_max / lattice.cell_size - 0.5],
            [1 / lattice.cell_size, 0, 0, -lattice.x_min / lattice.cell_size - 0.5],
        ]
    )
    if turn:
        cells, to_map = cells.transpose(1, 0, 2), to_map[::-1].copy()
    for axis, is_flipped in enumerate(flips):
        if is_flipped:
            cells = np.flip(cells, axis)
            to_map[axis] *= -1
            to_map[axis, 3] += cells.shape[axis] - 1
    whole = np.vstack([to_map[:, [0, 1, 3]], [0, 0, 1]])
    to_world = np.linalg.inv(whole)
    to_world[2] = (0, 0, 0)
    texts = PngInfo()
    texts.add_text("world_to_map", json.dumps(to_map.tolist()))
    texts.add_text("map_to_world", json.dumps(to_world.tolist()))
    texts.add_text("px_per_m", json.dumps(20))
    texts.add_text("room_ids_to_name", json.dumps({"1": "room_1"}))
    path = folder / "map.png"
    Image.fromarray(np.ascontiguousarray(cells).astype(np.uint8)).save(path, pnginfo=texts)
    return path


@pytest.mark.parametrize("turn", [False, True])
@pytest.mark.parametrize("flips", [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_rows_and_columns_may_run_along_any_axis(tmp_path, turn, flips):
    level = random_level(5)
    rooms = (level.free * 1).astype(np.uint16)
    level = level.with_layers(attributes={"roomIndex": rooms})
    path = write_map(tmp_path, level, turn, flips)
    found, back = Map(path), navbake.from_procthor(path)
    np.testing.assert_array_equal(back.free, level.free)
    np.testing.assert_array_equal(back.room_index, rooms)
    assert back.lattice == pytest.approx(level.lattice, abs=1e-9)
    assert [room.name for room in back.rooms] == ["room_1"]
    points = np.random.default_rng(2).uniform((-12, 30.2, 0), (-11, 31, 1), size=(1000, 3))
    px, (rows, cols) = found.pos_m_to_px(points), back.lattice.rows_cols(points)
    np.testing.assert_array_equal(found.occupancy[px[:, 0], px[:, 1]], back.free[rows, cols])


def test_more_rooms_than_a_byte_numbers_are_refused(tmp_path):
    level = small().with_layers(attributes={"roomIndex": np.full((3, 5), 256, np.uint16)})
    with pytest.raises(FormatError, match="numbers rooms up to 255, level 0 has 256"):
        level.to_procthor(tmp_path / "map.png")


@pytest.mark.parametrize(
    ("key", "text", "culprit"),
    [
        ("world_to_map", None, "has no text `world_to_map`"),
        ("world_to_map", "[[1", "expected JSON as text `world_to_map`"),
        ("world_to_map", "[[1, 0, 0, 0]]", "a 2 × 4 matrix of numbers as `world_to_map`"),
        ("world_to_map", '[[0, 1, 0, "x"], [1, 0, 0, 0]]', "matrix of numbers as `world_to_map`"),
        ("world_to_map", "[[1, 1, 0, 0], [1, -1, 0, 0]]", "turns by no quarter"),
        ("world_to_map", "[[0, 2, 0, 0], [1, 0, 0, 0]]", "or stretches"),
        ("world_to_map", "[[0, 0, 0, 0], [0, 0, 0, 0]]", "turns by no quarter"),
        ("world_to_map", "[[0, 1, 0, 1e30], [1, 0, 0, 0]]", "of the origin"),
        ("world_to_map", "[[0, 1e-30, 0, 0], [1e-30, 0, 0, 0]]", "of the origin"),
        ("map_to_world", "[[0, 1, 0], [-1, 0, 0], [0, 0, 1e300]]", "of the origin"),
        ("map_to_world", None, "`map_to_world`"),
        ("room_ids_to_name", "[]", "names by number"),
    ],
)
def test_a_broken_map_is_refused_in_a_line(tmp_path, key, text, culprit):
    path = write_map(tmp_path, small(), False, (0, 0))
    image = Image.open(path)
    texts = PngInfo()
    for name, old in {**image.info, key: text}.items():
        if old is not None:
            texts.add_text(name, old)
    image.save(path, pnginfo=texts)
    with pytest.raises(FormatError, match=culprit) as caught:
        navbake.from_procthor(path)
    assert "\n" not in str(caught.value)


def test_what_is_no_png_is_refused(tmp_path):
    (tmp_path / "a.png").write_bytes(b"GIF89a")
    with pytest.raises(FormatError, match=r"a PNG image, got .*a\.png"):
        navbake.from_procthor(tmp_path / "a.png")
