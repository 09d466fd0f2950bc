"""Verification names each fault that is planted into a grid."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh

import navbake
from box_worlds import box, world
from navbake.errors import FormatError
from navbake.navgrid.grid import MultiLevelGrid
from navbake.testing import assert_true
from navbake.verifier import report as kinds
from navbake.verifier.cells import MAX_MEASURED_FINDINGS
from verified_scenes import copy_of, kinds_at, mesh_room, walls, write


def test_names_cells_that_were_flipped(room):
    grid, config = room
    rng, wrong = np.random.default_rng(3), copy_of(grid)
    level = wrong.levels[0]
    planted = set()
    for mask, kind in (
        (grid.occupancy == 1, kinds.FREE_TOUCHES),
        (grid.inflate(0.15).free, kinds.BLOCKED_APART),  # beside a wall, either is right
    ):
        for row, col in rng.permutation(np.argwhere(mask))[:20].tolist():
            planted.add((kind, 0, (row, col)))
            is_free = kind == kinds.FREE_TOUCHES
            level.weights[row, col] = 1.0 if is_free else np.inf
            level.attributes["occupancy"][row, col] = 0 if is_free else 1
    report = navbake.verify(wrong, config)
    assert kinds_at(report) == planted
    for found in report.of_kind(kinds.FREE_TOUCHES):
        assert found.geom in found.text and found.size > 0
    counts = report.levels[0]
    assert (counts.free_touches, counts.blocked_apart) == (20, 20)
    assert not report.ok


def test_names_a_floor_that_moved(room):
    grid, config = room
    wrong = copy_of(grid)
    row, col = np.argwhere(grid.free)[50].tolist()
    wrong.levels[0].attributes["floorHeight"][row, col] += np.float32(0.02)
    (found,) = navbake.verify(wrong, config).findings
    assert (found.kind, found.cell) == (kinds.FLOOR_OFF, (row, col))
    assert found.size == pytest.approx(0.02, abs=1e-6) and "0.0200 m off" in found.text


def test_names_a_floor_that_is_missing(room):
    grid, config = room
    wrong = copy_of(grid)
    row, col = np.argwhere(grid.free)[50].tolist()
    wrong.levels[0].attributes["floorHeight"][row, col] = np.nan
    assert (kinds.NO_FLOOR, 0, (row, col)) in kinds_at(navbake.verify(wrong, config))
    wrong.levels[0].weights[row, col] = np.inf
    assert kinds_at(navbake.verify(wrong, config)) == {(kinds.PLACE_LOST, 0, (row, col))}


@pytest.mark.parametrize("missing", [0, 1])
def test_names_a_level_that_was_removed(house, missing):
    grid, config = house
    own = {**grid.navbake, "links": []}
    left = [level for k, level in enumerate(grid.levels) if k != missing]
    levels = [level.with_layers(metadata={}) for level in left]
    wrong = MultiLevelGrid(
        grids=levels, metadata={**grid.metadata, "navbake": own}, cell_size=grid.cell_size
    )
    report = navbake.verify(wrong, config)
    lost = list(report.of_kind(kinds.PLACE_LOST))
    assert lost and all("steps lead there" in found.text for found in lost)
    # each place counts that a cell of the other level looks at, but some beside walls
    there, gone = left[0].lattice, grid.levels[missing]
    rows, cols = there.rows_cols(gone.lattice.positions(*np.nonzero(gone.free)))
    is_seen = (rows >= 0) & (cols >= 0) & (rows < there.height) & (cols < there.width)
    assert report.total.lost > 0.9 * np.count_nonzero(is_seen)
    # a sample finds it, too
    assert any(navbake.verify(wrong, config, sample=400).of_kind(kinds.PLACE_LOST))


def test_names_a_storey_without_stairs_that_was_removed(tmp_path):
    parts = [box("lower", 0, 0, -0.2, 5, 4, 0), box("upper", 0, 0, 2.52, 5, 4, 2.72)]
    for z in (0.0, 2.72):
        parts += [box(f"wall {z} {k}", *sides) for k, sides in enumerate(walls(z))]
    config = {"scene": {"path": str(write(tmp_path, world("".join(parts))))}}
    with pytest.warns(navbake.BakeWarning, match="no step"):
        grid = navbake.bake(config)
    assert_true(grid, config)
    alone = grid.levels[0].with_layers(metadata=grid.metadata)
    alone.navbake["links"] = []
    (found,) = navbake.verify(alone, config).findings
    assert found.kind == kinds.PLACE_LOST and "walls all round" in found.text
    assert found.geom == "upper" and found.position[2] == pytest.approx(2.72)


def test_names_paths_that_touch(room):
    grid, config = room
    wrong = copy_of(grid)
    level = wrong.levels[0]
    table = (grid.lattice.center_x() > 0.2) & (grid.lattice.center_x() < 1.4)
    rows = (grid.lattice.center_y() > -0.6) & (grid.lattice.center_y() < 0.3)
    window = np.ix_(rows, table)
    level.attributes["occupancy"][window], level.weights[window] = 0, 1.0
    report = navbake.verify(wrong, config, paths=30, radius=0.1)
    touching = list(report.of_kind(kinds.PATH_TOUCHES))
    assert {found.geom for found in touching} == {"table"}
    assert len(touching) == report.sweeps.touching > 0
    # the cylinder touches the table where the finding is, and comes from beside it
    x, y = np.array([found.position[:2] for found in touching]).T
    outside_x = np.maximum(np.maximum(0.3 - x, x - 1.3), 0.0)
    outside_y = np.maximum(np.maximum(-0.5 - y, y - 0.2), 0.0)
    distances = np.hypot(outside_x, outside_y)
    assert (distances < 0.1005).all()
    assert (distances > 0.0985).sum() > len(touching) / 2  # others start or turn beside the table
    assert all("touches 'table' from this place on" in found.text for found in touching)


def test_names_an_inflation_that_closed_too_much(room):
    grid, config = room
    wrong = grid.inflate(0.2)
    row, col = np.argwhere(grid.inflate(0.3).free[10:, 10:])[0].tolist()
    row, col = row + 10, col + 10
    wrong.levels[0].weights[row, col] = np.inf
    assert kinds_at(navbake.verify(wrong, config)) == {(kinds.BLOCKED_APART, 0, (row, col))}


@pytest.mark.parametrize("missing", [0, 1])
def test_names_a_level_that_was_deleted_from_the_file(house, tmp_path, missing):
    grid, config = house
    path = tmp_path / "house.grid.json"
    grid.save(path)
    content = json.loads(path.read_text())
    assert content["type"] == "MultiLevelGrid"
    del content["grids"][missing]
    path.write_text(json.dumps(content))
    with pytest.raises(FormatError, match=r"an existing cell, got cell \d+ of level 1 in link 0"):
        navbake.verify(path, config)
    for table in ("links", "rooms"):  # these name the level
        del content["metadata"]["navbake"][table]
    path.write_text(json.dumps(content))
    report = navbake.verify(path, config)
    assert report.num_cells == grid.levels[1 - missing].width * grid.levels[1 - missing].height
    lost = {found.geom for found in report.of_kind(kinds.PLACE_LOST)}
    assert lost & {("ground floor", "upper floor")[missing], "landing", "tread 0", "tread 14"}


@pytest.mark.parametrize("kind", [kinds.BLOCKED_APART, kinds.FREE_TOUCHES])
def test_a_map_that_is_all_wrong_is_counted(kind, room):
    """The first findings are measured, all are listed."""
    grid, config = room
    is_free = kind == kinds.FREE_TOUCHES
    wrong = copy_of(grid)
    wrong.weights[:] = 1.0 if is_free else np.inf
    wrong.attributes["occupancy"][:] = 0 if is_free else 1
    report = navbake.verify(wrong, config)
    found = list(report.of_kind(kind))
    counts = report.levels[0]
    num_faults = counts.free_touches if is_free else counts.blocked_apart
    assert len(found) == num_faults
    assert num_faults > 2 * MAX_MEASURED_FINDINGS
    sizes = [one.size for one in found]
    assert None not in sizes[:MAX_MEASURED_FINDINGS]
    assert set(sizes[MAX_MEASURED_FINDINGS:]) == {None}


def test_says_how_far_a_blocked_cell_is_from_the_nearest_geom(room):
    grid, config = room
    wrong = copy_of(grid)
    # beside the wall, whose face is at y = 1.9
    row, col = (int(v) for v in grid.lattice.rows_cols([-1.55, 1.75]))
    wrong.weights[row, col], wrong.attributes["occupancy"][row, col] = np.inf, 1
    (found,) = navbake.verify(wrong, config).findings
    assert (found.kind, found.geom) == (kinds.BLOCKED_APART, "wall")
    assert found.size == pytest.approx(0.1, abs=1e-4) and "'wall', is 0.1000 m off" in found.text


# ---------------------------------------------------------------- a mesh scene


def test_a_triangle_that_is_wound_downward_is_a_floor(tmp_path):
    """In a closed part, as a bake turns it; a floor beside it that moved is still named."""
    slab = trimesh.creation.box((4, 4, 0.2))
    top = np.flatnonzero(slab.face_normals[:, 2] > 0.5)[0]
    slab.faces[top] = slab.faces[top][::-1]
    path = tmp_path / "slab.obj"
    path.write_text(
        trimesh.Trimesh(slab.vertices, slab.faces, process=False).export(file_type="obj")
    )
    config = {"scene": {"path": str(path), "up": "z"}}
    grid = navbake.bake(config)
    assert grid.free.all()
    assert_true(grid, config)
    wrong = copy_of(grid)
    wrong.attributes["floorHeight"][20, 20] += np.float32(0.02)
    assert kinds_at(navbake.verify(wrong, config)) == {(kinds.FLOOR_OFF, 0, (20, 20))}


def test_names_faults_in_a_mesh_scene(tmp_path):
    """20 cells flipped each way, a floor 2 cm off, and a cell inside of what is closed."""
    grid, config = mesh_room(tmp_path)
    assert_true(grid, config)
    rng, wrong = np.random.default_rng(7), copy_of(grid)
    clear = np.argwhere(grid.inflate(0.2).free).tolist()
    places = rng.permutation(np.argwhere(grid.occupancy == 1))[:20].tolist()
    planted = {(kinds.FREE_TOUCHES, 0, (row, col)) for row, col in places}
    for row, col in places:
        wrong.weights[row, col], wrong.attributes["occupancy"][row, col] = 1.0, 0
    *chosen, (row, col) = rng.permutation(clear)[:21].tolist()
    for place in chosen:
        wrong.weights[tuple(place)], wrong.attributes["occupancy"][tuple(place)] = np.inf, 1
        planted.add((kinds.BLOCKED_APART, 0, tuple(place)))
    wrong.attributes["floorHeight"][row, col] += np.float32(0.02)
    planted.add((kinds.FLOOR_OFF, 0, (row, col)))
    report = navbake.verify(wrong, config)
    assert kinds_at(report) == planted
    inside = tuple(int(v) for v in grid.lattice.rows_cols([0.65, -0.9]))
    wrong = copy_of(grid)
    wrong.weights[inside] = 1.0
    (found,) = navbake.verify(wrong, config).findings
    assert found.cell == inside and "lies inside of" in found.text
