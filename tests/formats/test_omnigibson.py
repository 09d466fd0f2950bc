"""OmniGibson's maps: its arithmetic, written out here, finds the cells and rooms of the grid."""

import json

import numpy as np
import pytest
from PIL import Image
from PIL.PngImagePlugin import PngInfo

import navbake
from command_line import run_command
from grid_maps import level_from
from map_grids import random_level, sample
from navbake.errors import FormatError


class Layout:
    """What OmniGibson makes of a folder, at the resolution of its images."""

    def __init__(self, folder, floor=0, name="floor_trav"):
        self.free = np.array(Image.open(folder / f"{name}_{floor}.png"))
        height, self.size = self.free.shape
        assert height == self.size
        self.free = np.where(self.free < 255, 0, self.free)

    def world_to_map(self, xy):
        return np.flip(np.asarray(xy) / 0.01 + self.size / 2.0, axis=-1).astype(int)

    def map_to_world(self, xy):
        return np.flip((np.asarray(xy) - self.size / 2.0) * 0.01, axis=-1)

    def is_free(self, xy):
        row, col = self.world_to_map(xy).T
        return self.free[row, col] == 255


class Rooms(Layout):
    """Its ``SegmentationMap``."""

    def __init__(self, folder, categories):
        super().__init__(folder, name="floor_insseg")
        self.ins = np.array(Image.open(folder / "floor_insseg_0.png"))
        self.sem = np.array(Image.open(folder / "floor_semseg_0.png"))
        assert self.ins.shape == self.sem.shape
        with open(categories) as lines:
            names = [line.rstrip() for line in lines.readlines()]
        ids = np.delete(np.unique(self.ins), 0)
        by_kind = {}
        for number in ids:
            x, y = np.where(self.ins == number)
            by_kind.setdefault(self.sem[x[0], y[0]], []).append(number)
        self.names = {
            number: f"{names[kind - 1]}_{i}"
            for kind, numbers in by_kind.items()
            for i, number in enumerate(numbers)
        }


def positions(level, num=200_000):
    rng = np.random.default_rng(7)
    x0, y0, x1, y1 = level.lattice.bounds
    return rng.uniform((x0, y0), (x1, y1), (num, 2))


@pytest.mark.parametrize("name", ["apartment", "house", "warehouse"])
def test_omnigibson_finds_the_free_cells_and_rooms(tmp_path, name):
    grid = sample(name)
    written = grid.convert(tmp_path / "floor_trav.png", "omnigibson", stairs="free")
    names = {"floor_insseg_0.png", "floor_semseg_0.png", "room_categories.txt"}
    floors = {f"floor_trav_{number}.png" for number in range(len(grid.levels))}
    assert {path.name for path in written} == names | floors
    for number, level in enumerate(grid.levels):
        layout, points = Layout(tmp_path, number), positions(level)
        free, rows, cols = layout.is_free(points), *level.lattice.rows_cols(points)
        expected = level.free[rows, cols]
        assert not (free & ~expected).any()  # never where the grid is blocked
        x, y = points.T
        edges = [
            (level.lattice.x_min - x) / level.cell_size,
            (level.lattice.y_max - y) / level.cell_size,
        ]
        inside = np.all([np.abs(e - np.round(e)) * level.cell_size > 0.01 for e in edges], axis=0)
        assert inside.mean() > 0.5
        np.testing.assert_array_equal(free[inside], expected[inside])
    rooms, level = Rooms(tmp_path, tmp_path / "room_categories.txt"), grid.levels[0]
    rows, cols = np.nonzero(level.room_index)
    at = rooms.world_to_map(level.lattice.positions(rows, cols))
    np.testing.assert_array_equal(rooms.ins[at[:, 0], at[:, 1]], level.room_index[rows, cols])
    for room in (room for room in grid.rooms if room.level == 0):
        kind = (room.name or "room").lower().replace(" ", "_").rstrip("_0123456789")
        assert rooms.names[room.index].rsplit("_", 1)[0] == kind


def test_cells_on_its_pixels_are_the_same_everywhere(tmp_path):
    level = random_level(0, shape=(31, 17), cell_size=0.05, corner=(-1.5, 2.25))
    level.convert(tmp_path / "a.png", "omnigibson")
    points = positions(level)
    rows, cols = level.lattice.rows_cols(points)
    found = Layout(tmp_path, name="a").is_free(points)
    np.testing.assert_array_equal(found, level.free[rows, cols])


def test_by_its_own_resolution_of_ten_pixels(tmp_path):
    """OpenCV's linear reduction by ten is the mean of the middle two by two pixels."""
    level = random_level(1, shape=(20, 20), cell_size=0.1, corner=(-1.0, 1.0))
    level.convert(tmp_path / "a.png", "omnigibson")
    pixels = np.array(Image.open(tmp_path / "a_0.png"))[1:-1, 1:-1].astype(float)
    blocks = pixels.reshape(20, 10, 20, 10)[:, 4:6, :, 4:6].mean(axis=(1, 3))
    np.testing.assert_array_equal(blocks[::-1] == 255, level.free)  # rows go up


@pytest.mark.parametrize("name", ["apartment", "house"])
def test_grids_come_back_cell_for_cell(tmp_path, name):
    grid = sample(name)
    grid.convert(tmp_path / "floor_trav.png", "omnigibson", stairs="free")
    for number, level in enumerate(grid.levels):
        back = navbake.from_omnigibson(tmp_path / f"floor_trav_{number}.png")
        assert (back.lattice, back.ground) == (level.lattice, pytest.approx(level.ground))
        np.testing.assert_array_equal(back.free, level.free)
        expected = level.room_index if number == 0 else np.zeros_like(level.room_index)
        np.testing.assert_array_equal(back.room_index, expected)
    names = [room.name for room in navbake.from_omnigibson(tmp_path / "floor_trav_0.png").rooms]
    assert all(name.endswith(("_0", "_1", "_2", "_3", "_4")) for name in names) and names


def save(path, pixels, **texts):
    notes = PngInfo()
    for key, text in texts.items():
        notes.add_text(key, text)
    Image.fromarray(np.asarray(pixels, dtype=np.uint8)).save(path, pnginfo=notes)


def test_a_map_of_others_is_read_where_it_says(tmp_path, capsys):
    """The pixel of row 3, column 0: x from -0.02, y from 0.01, by `map_to_world`."""
    pixels = np.zeros((4, 4))
    pixels[3, 0], pixels[0, 0], pixels[1, 2] = 255, 254, 255
    save(tmp_path / "floor_trav_0.png", pixels)
    save(tmp_path / "floor_insseg_0.png", [[0] * 4, [0, 0, 7, 0], [0] * 4, [9, 0, 0, 0]])
    save(tmp_path / "floor_semseg_0.png", [[0] * 4, [0, 0, 2, 0], [0] * 4, [2, 0, 0, 0]])
    (tmp_path / "room_categories.txt").write_text("bathroom\nbedroom\n")
    out = tmp_path / "out.grid.json"
    words = ("convert", tmp_path / "floor_trav_0.png", out, "--from", "omnigibson")
    assert run_command(capsys, *words)[0] == 0
    level = navbake.load(out)
    assert level.cell_size == 0.01 and level.free.sum() == 2
    for x, y, room in ((-0.015, 0.015, 9), (0.005, -0.005, 7)):
        cell = level.cell_at((x, y, 0.0))
        assert level.free[cell.row, cell.col] and level.room_index[cell.row, cell.col] == room
    assert {room.index: room.name for room in level.rooms} == {7: "bedroom_0", 9: "bedroom_1"}
    words = (*words[:1], words[1], tmp_path / "room_categories.txt", *words[3:], "--to", "npz")
    status, _, err = run_command(capsys, *words)  # a room map is an input, too
    assert status != 0 and "room_categories.txt" in err


def test_categories_are_those_of_the_data_set(tmp_path):
    grid = sample("apartment")
    names = sorted({room.name.lower().replace(" ", "_") for room in grid.rooms})
    listed = tmp_path / "theirs.txt"
    listed.write_text("\n".join(["garage", *names]) + "\n")
    grid.convert(tmp_path / "floor_trav.png", "omnigibson", categories=listed)
    assert not (tmp_path / "room_categories.txt").exists()
    found = Rooms(tmp_path, listed).names
    assert {name.rsplit("_", 1)[0] for name in found.values()} == {*names}
    listed.write_text("\n".join(names[1:]))
    with pytest.raises(FormatError, match=rf"is a '{names[0]}', which .*theirs.txt doesn't have"):
        grid.convert(tmp_path / "a.png", "omnigibson", categories=listed)


def test_room_maps_bear_the_name_of_their_map(tmp_path):
    rooms, bare = sample("apartment"), level_from("...\n.#.", 0.1, 0.0, 0.0)
    grids = {"house": rooms, "b_trav": rooms, "shed": bare, "floor_trav": bare}
    for name, grid in grids.items():
        grid.convert(tmp_path / f"{name}.png", "omnigibson")
    heads = ("house_", "b_", "shed_", "floor_")
    assert {path.name for path in tmp_path.iterdir()} == {
        *(f"{name}_0.png" for name in grids),
        *(f"{head}{kind}_0.png" for head in heads for kind in ("insseg", "semseg")),
        *(f"{head}room_categories.txt" for head in heads[:3]),
        "room_categories.txt",
    }
    for name, grid in grids.items():
        read = navbake.from_omnigibson(tmp_path / f"{name}_0.png")
        np.testing.assert_array_equal(read.room_index, grid.levels[0].room_index)
        assert bool(read.rooms) == (grid is rooms)


def test_a_grid_without_rooms_leaves_none_of_an_earlier_one(tmp_path):
    rooms, bare = sample("apartment"), level_from("...\n.#.", 0.1, 0.0, 0.0)
    for name in ("floor_trav", "house"):
        for grid, num_rooms in ((rooms, len(rooms.rooms)), (bare, 0)):
            grid.convert(tmp_path / f"{name}.png", "omnigibson")
            assert len(navbake.from_omnigibson(tmp_path / f"{name}_0.png").rooms) == num_rooms


def test_variants_of_a_map_share_the_rooms_of_the_scene(tmp_path):
    grid = sample("apartment")
    for name in ("floor_trav", "floor_trav_no_obj", "floor_trav_no_door"):
        grid.convert(tmp_path / f"{name}.png", "omnigibson")
        assert len(navbake.from_omnigibson(tmp_path / f"{name}_0.png").rooms) == len(grid.rooms)
    assert len(list(tmp_path.glob("*seg_0.png"))) == 2
    # navbake up to 0.3 gave the rooms of any map these names
    (tmp_path / "floor_trav_0.png").rename(tmp_path / "house_0.png")
    assert len(navbake.from_omnigibson(tmp_path / "house_0.png").rooms) == len(grid.rooms)


def test_a_map_without_objects_brings_no_rooms(tmp_path):
    written = sample("apartment").convert(tmp_path / "floor_trav_no_obj.png", "omnigibson")
    assert [path.name for path in written] == ["floor_trav_no_obj_0.png"]


def test_what_its_maps_cannot_hold(tmp_path):
    far = level_from("...\n.#.", 0.1, 60.0, 0.0)
    with pytest.raises(FormatError, match=r"level 0 ends 60\.3 m from it, expected 44\.7 m"):
        far.convert(tmp_path / "a.png", "omnigibson")
    with pytest.raises(FormatError, match=r"cells of 0\.01 m at least, got 0\.004 m"):
        level_from("...", 0.004, 0.0, 0.0).convert(tmp_path / "a.png", "omnigibson")
    level = level_from("...\n.#.", 0.1, 0.0, 0.0)
    many = level.with_layers(attributes={"roomIndex": np.full((2, 3), 300, dtype=np.uint16)})
    with pytest.raises(FormatError, match=r"up to 255, level 0 has 300"):
        many.convert(tmp_path / "a.png", "omnigibson")


GOOD = {"x_min": 0.0, "y_max": 0.02, "cell_size": 0.01, "width": 2, "height": 2, "ground": 0.0}


@pytest.mark.parametrize(
    ("pixels", "texts", "message"),
    [
        (np.zeros((4, 6)), {}, r"expected a square map in .*floor_trav_0\.png, got 6 × 4"),
        (np.zeros((4, 4, 3)), {}, r"a map of one channel in .*, got RGB"),
        (np.zeros((4, 4)), {"navbake": "{"}, r"cells of a map as `navbake` in .*floor_trav_0"),
        (np.zeros((4, 4)), {"navbake": json.dumps({**GOOD, "cell_size": 0.0})}, "out of range"),
        (np.zeros((4, 4)), {"navbake": json.dumps({**GOOD, "width": 9})}, "reach beyond its 4"),
        (np.zeros((4, 4)), {"navbake": json.dumps({**GOOD, "more": 9})}, "more"),
        (np.zeros((4, 4)), {"navbake": json.dumps([1])}, "cells of a map"),
    ],
)
def test_broken_maps_are_named(tmp_path, pixels, texts, message):
    save(tmp_path / "floor_trav_0.png", pixels, **texts)
    with pytest.raises(FormatError, match=message):
        navbake.from_omnigibson(tmp_path / "floor_trav_0.png")


def test_a_room_map_of_another_size_is_named(tmp_path):
    save(tmp_path / "floor_trav_0.png", np.zeros((4, 4)), navbake=json.dumps(GOOD))
    save(tmp_path / "floor_insseg_0.png", np.zeros((6, 6)))
    with pytest.raises(FormatError, match=r"bytes of 4 × 4 in .*floor_insseg_0\.png, got L of 6"):
        navbake.from_omnigibson(tmp_path / "floor_trav_0.png")
