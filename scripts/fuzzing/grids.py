"""Grids: NavGrid files and NumPy archives of grids."""

from __future__ import annotations

import gzip
import json
from functools import cache
from pathlib import Path
from random import Random

import numpy as np

import navbake
from fuzzing import texts
from fuzzing.archives import array_bytes, mutate_archive, unpack
from fuzzing.kind import Input, attempt, is_one_in
from fuzzing.mutations import cut, dump_tree, gzip_bomb, mutate_bytes, mutate_tree
from navbake.formats.maps.grid_npz import encode_grid_npz, read_grid_npz
from navbake.formats.navgrid import dumps_navgrid
from navbake.navgrid.grid import NavGrid
from navbake.views.describe import describe, describe_column


def make_navgrid(rng: Random) -> Input:
    """A NavGrid file with changes in its JSON; some are gzipped, some of these broken."""
    data = dump_tree(mutate_tree(rng.choice(texts.GRIDS), rng), rng)
    chance = rng.random()
    if chance < 0.05:
        data = gzip.compress(data, compresslevel=1, mtime=0)
        data = mutate_bytes(data, rng) if rng.random() < 0.5 else data
        return Input(cut(data, rng), ".json.gz")
    if chance < 0.052:
        return Input(gzip_bomb(rng.choice((b"{", b"[", b'{"type":"')), rng), ".json.gz")
    if chance < 0.06:
        return Input(json.dumps(_claim(rng)).encode(), ".json")
    return Input(cut(data, rng), ".json")


def _claim(rng: Random) -> dict[str, object]:
    """A level of few bytes with as many cells as its runs say."""
    width, height = rng.choice((1, 1000, 4000, 10**6)), rng.choice((1, 1000, 4000))
    runs = {"encoding": "rle", "data": [rng.choice((1, None, 0)), width * height]}
    layers = {f"a{k}": {**runs, "datatype": "float32"} for k in range(rng.choice((0, 1, 5, 40)))}
    return {
        "type": "SceneGrid2D", "width": width, "height": height, "cellSize": 0.1, "min": [0, 0, 0],
        "weights": runs, "tileAttributes": layers,
    }  # fmt: skip


def check_grid(grid: NavGrid) -> None:
    """Describe, save, load again, change doors, look at cells, and plan."""
    if sum(level.width * level.height for level in grid.levels) > 1_000_000:
        _check_levels(grid)  # all else takes long
        return
    describe(grid)
    written = dumps_navgrid(grid)
    if dumps_navgrid(navbake.load(written)) != written:
        raise AssertionError("a grid is another one after it is written and read")
    for table in (grid.rooms, grid.doors, grid.links):
        _ = [entry.to_json() for entry in table if hasattr(entry, "to_json")]
    _check_levels(grid)
    x0, y0, x1, y1 = grid.levels[0].lattice.bounds
    middle = (x0 + x1) / 2, (y0 + y1) / 2
    describe_column(grid, *middle)
    for state in ("open", "closed", "removed", "modelled"):
        attempt(lambda state=state: dumps_navgrid(grid.with_doors(state)))
    if is_one_in(8, written):
        attempt(lambda: _plan(grid, middle, (x0, y0)))  # weights may be less than 0
        attempt(lambda: dumps_navgrid(grid.inflate(grid.levels[0].lattice.cell_size)))


def _plan(grid: NavGrid, middle: tuple[float, float], corner: tuple[float, float]) -> None:
    finder = navbake.PathFinder(grid)
    for goal in (middle, corner, *(f"room:{room.id}" for room in grid.rooms[:2])):
        attempt(lambda goal=goal: finder.find_path(middle, goal))
    attempt(lambda: finder.random_point(np.random.default_rng(0)))
    attempt(lambda: finder.snap(middle))


def _check_levels(grid: NavGrid) -> None:
    for level in grid.levels:
        _ = level.rooms, level.doors, dict(level.user_data)
        layers = level.free, level.floor_height, level.occupancy, level.room_index, level.weights
        if any(layer.shape != (level.height, level.width) for layer in layers):
            raise AssertionError("a layer has another shape than its level")


@cache
def _archives() -> tuple[dict[str, bytes], ...]:
    made = [navbake.load(json.dumps(tree).encode()) for tree in texts.GRIDS]
    files = [encode_grid_npz(grid, Path("a.npz")) for grid in made]
    return tuple(unpack(bytes(file[Path("a.npz")])) for file in files)  # type: ignore[arg-type]


def make_grid_npz(rng: Random) -> Input:
    """An archive of a grid with other JSON, arrays and bytes."""
    members = dict(rng.choice(_archives()))
    if rng.random() < 0.6:
        name = rng.choice([n for n in members if n == "grid.npy" or n.endswith("userData.npy")])
        tree = json.loads(members[name].partition(b"\n")[2] or b"{}")
        text = dump_tree(mutate_tree(tree, rng), rng)
        members[name] = array_bytes(np.frombuffer(text, dtype=np.uint8))
        if rng.random() < 0.5:
            return Input(mutate_archive(members, rng, changes=0), ".npz")
    return Input(mutate_archive(members, rng), ".npz")


def read_grid_archive(path: Path) -> NavGrid:
    """Read an archive, user data as well."""
    grid = read_grid_npz(path)
    for level in grid.levels:
        _ = dict(level.user_data)
    return grid
