"""Blocks of cells, and of rows: however large these are, a bake gives the same bytes."""

from functools import cache

import numpy as np
import pytest
import trimesh

from navbake.baker.bake.pipeline import run_bake
from navbake.baker.bake.stages import bake_stages, open_stages
from navbake.baker.columns import column_sources
from navbake.baker.columns import columns as columns_module
from navbake.baker.columns.column_sources import ChunkedShapes, ColumnCaster, join_columns
from navbake.baker.columns.columns import Columns, ShapeSource, split_into_row_chunks
from navbake.baker.core.blocks import Blocks, RowsBuilder
from navbake.baker.core.clock import StageClock
from navbake.baker.core.tiles import BLOCK
from navbake.baker.geometry import shapes as shapes_module
from navbake.baker.occupants import standing
from navbake.config.settings import load_config, parse_config
from navbake.formats.navgrid import dumps_navgrid
from navbake.navgrid.lattice import Lattice
from project_paths import CONFIGS

SAMPLES = sorted(path.stem for path in CONFIGS.glob("*.yaml"))

# slabs with cracks between them along both axes and at an angle, and a post in one
SLAB = '<geom type="box" size=".4 .4 .1" pos="{} {} {}" euler="0 0 {}"/>'
CRACKED = "".join(
    SLAB.format(0.81 * i + 0.005 * (j % 3), 0.82 * j, 0.02 * (i % 3), 2 * ((i + j) % 4))
    for i in range(4)
    for j in range(5)
)
CRACKED += '<geom type="cylinder" size=".05 .5" pos="1.2 1.2 .5"/>'
CRACKED += '<geom type="plane" size="0 0 1" pos="0 0 -1"/>'


@pytest.mark.parametrize("cell_size", [0.05, 0.02, 0.013])
def test_columns_of_rows_and_of_cells_are_those_of_the_whole(tmp_path, monkeypatch, cell_size):
    path = tmp_path / "scene.xml"
    # tetrahedra that share a mesh, some over the borders of blocks
    mesh = '<asset><mesh name="m" vertex="0 0 0 .3 0 0 0 .4 0 0 0 .5"/></asset>'
    geoms = [f'<geom type="mesh" mesh="m" pos="{n / 3} {n / 4} .3"/>' for n in range(5)]
    path.write_text(f"<mujoco>{mesh}<worldbody>{CRACKED}{''.join(geoms)}</worldbody></mujoco>")
    config = parse_config({"scene": {"path": str(path)}, "grid": {"cell_size": cell_size}})
    tiles = open_stages(config, StageClock()).shape_source

    def find(shapes: ShapeSource = tiles) -> ColumnCaster:
        return ColumnCaster(shapes, config.agent, config.floors.crack, StageClock())

    def join(shapes: ShapeSource = tiles) -> Columns:
        window = slice(0, tiles.lattice.height), slice(0, tiles.lattice.width)
        return join_columns(find(shapes), window, tiles.lattice)

    whole, width = join(), tiles.lattice.width
    assert len(whole.z) > len(columns_module.cast_columns(tiles).z)
    cells = np.unique(np.random.default_rng(0).integers(0, width * tiles.lattice.height, 500))
    for rows in (8, 16, 40):
        monkeypatch.setattr(columns_module, "CELLS_PER_CHUNK", rows * width)
        assert len(split_into_row_chunks(tiles.lattice)) == -(-tiles.lattice.height // rows)
        for one, other in zip(join().hits, whole.hits, strict=True):
            np.testing.assert_array_equal(one, other)
    monkeypatch.setattr(column_sources, "MAX_CELLS_IN_MEMORY", 0)
    monkeypatch.setattr(column_sources, "MAX_TRIANGLES_EXPANDED_AT_ONCE", 0)
    monkeypatch.setattr(column_sources, "MAX_EXPANSIONS_PER_TRIANGLE", np.inf)
    for shapes in (tiles, open_stages(config, StageClock()).shape_source):
        for one, other in zip(join(shapes).hits, whole.hits, strict=True):
            np.testing.assert_array_equal(one, other)
        some = find(shapes).columns_at(cells)
        for cell in cells.tolist():
            one, other = (slice(*of.start[cell : cell + 2].tolist()) for of in (some, whole))
            for a, b in zip(some.hits[1:], whole.hits[1:], strict=True):
                np.testing.assert_array_equal(a[one], b[other])
    assert isinstance(shapes, ChunkedShapes)


@pytest.mark.parametrize("num_cells", [1, 40, 400])
def test_normals_of_rough_ground_at_some_cells_are_those_of_the_whole(
    tmp_path, monkeypatch, num_cells
):
    """Cells far apart: the columns between them are not cast, and have no hits."""
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.arange(101) * 0.02, np.arange(101) * 0.02)
    vertices = np.stack([x.ravel(), y.ravel(), rng.normal(0, 0.01, x.size)], axis=1)
    corner = np.arange(101 * 101).reshape(101, 101)[:-1, :-1].ravel()
    faces = np.concatenate(
        [corner[:, None] + [0, 1, 102], corner[:, None] + [0, 102, 101]], dtype=np.int64
    )
    path = tmp_path / "rough.ply"
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    config = parse_config({"scene": {"path": str(path), "up": "z"}})
    shapes = open_stages(config, StageClock()).shape_source
    whole = ColumnCaster(shapes, config.agent, config.floors.crack, StageClock())
    (columns,) = whole.row_chunks()
    is_replaced = (columns.normal != columns_module.cast_columns(shapes).normal).any(axis=1)
    assert is_replaced.sum() > 100
    cells = np.sort(rng.choice(len(columns.start) - 1, num_cells, replace=False))
    monkeypatch.setattr(column_sources, "MAX_CELLS_IN_MEMORY", 0)
    caster = ColumnCaster(shapes, config.agent, config.floors.crack, StageClock())
    columns_of_cells = caster.columns_at(cells)
    for cell in cells.tolist():
        hits = slice(*columns_of_cells.start[cell : cell + 2].tolist())
        expected_hits = slice(*columns.start[cell : cell + 2].tolist())
        np.testing.assert_array_equal(columns_of_cells.normal[hits], columns.normal[expected_hits])


def in_blocks(monkeypatch, cells):
    """Bake in blocks of about so many cells, and keep none of their columns."""
    monkeypatch.setattr(columns_module, "CELLS_PER_CHUNK", cells)
    monkeypatch.setattr(column_sources, "MAX_CELLS_IN_MEMORY", 0)


def bake_bytes(config) -> bytes:
    grid = run_bake(config).grid
    grid.timings = {}
    return dumps_navgrid(grid)


@cache
def sample_in_one_block(name) -> bytes:
    return bake_bytes(load_config(CONFIGS / f"{name}.yaml"))


@pytest.mark.parametrize("cells", [1, 3000, 20_000])
@pytest.mark.parametrize("name", SAMPLES)
def test_samples_in_blocks(monkeypatch, name, cells):
    expected = sample_in_one_block(name)
    in_blocks(monkeypatch, cells)
    assert bake_bytes(load_config(CONFIGS / f"{name}.yaml")) == expected


@pytest.mark.parametrize("cells", [3000, 1 << 20])
@pytest.mark.parametrize("name", SAMPLES)
def test_samples_whose_occupants_are_listed_in_pieces(monkeypatch, name, cells):
    """Of a row of tiles each, also in several blocks with several pieces."""
    expected = sample_in_one_block(name)
    in_blocks(monkeypatch, cells)
    monkeypatch.setattr(standing, "CELLS_PER_CALL", 1)
    assert bake_bytes(load_config(CONFIGS / f"{name}.yaml")) == expected


# a hall with what most rules are about: a storey on a stair, a mesh, posts, a roof, a door, a bed
HALL = """
<mujoco><compiler angle="degree"/>
<asset>
  <mesh name="wedge" vertex="0 0 0 1 0 0 0 1 0 1 1 0 0 0 .4 0 1 .4"/>
  <mesh name="shed" vertex="0 0 0 2 0 0 0 2 0 2 2 0 0 0 2 2 0 2 0 2 2 2 2 2"/>
</asset>
<worldbody>
  <geom name="floor" type="box" size="3 3 .1" pos="0 0 -.1"/>
  <geom name="beside" type="box" size="1 3 .1" pos="4.015 0 -.1"/>
  <geom name="ground" type="plane" size="0 0 1" pos="0 0 -.6"/>
  <geom name="wall_n" type="box" size="3 .1 1.4" pos="0 2.9 1.4"/>
  <geom name="wall_s" type="box" size="3 .1 1.4" pos="0 -2.9 1.4"/>
  <geom name="wall_m" type="box" size=".1 1.2 1.4" pos=".3 -1.7 1.4"/>
  <geom name="wall_o" type="box" size=".1 1.2 1.4" pos=".3 1.7 1.4" euler="0 0 4"/>
  <geom name="upper" type="box" size="1.2 2 .1" pos="-1.8 0 1.9"/>
  <geom name="roof" type="box" size="1.3 2.2 .05" pos="-1.8 0 4.4"/>
  <geom type="mesh" mesh="wedge" pos="1.2 -1 0" contype="0" conaffinity="0"/>
  <geom type="mesh" mesh="shed" pos="3.2 .4 0"/>
  <geom name="bed" type="box" size=".5 .9 .25" pos="1.8 1.6 .25"/>
  <geom type="cylinder" size=".03 .6" pos="2.1 -1.8 .6"/>
  <geom type="sphere" size=".3" pos="-2 -1 .1"/>
  {stairs}
  <body name="door" pos=".3 -.5 1"><joint type="hinge" axis="0 0 1" range="0 90"/>
    <geom type="box" size=".03 .48 1" pos="0 .48 0"/></body>
</worldbody></mujoco>
""".replace(
    "{stairs}",
    "".join(
        f'<geom type="box" size=".15 .4 {0.1 * k}" pos="{0.9 - 0.27 * k} -1 {0.1 * k}"/>'
        for k in range(1, 11)
    ),
)


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"agent": {"radius": 0.2}, "attributes": ["clearance"]},
        {"grid": {"cell_size": 0.04, "bounds": [-2.5, -1.7, 3.9, 2.1]}},
        {"grid": {"cell_size": 0.3, "margin": 1.0}},  # slopes join floors over coarse cells
        {"levels": [{"ground": 0.0, "top": 1.5}], "rooms": {"door_width": 0.9}},
        {"floors": {"crack": 0.0, "tops": True, "roofs": True}, "names": False},
        {"floors": {"from": [[4.0, -1.0, 0.0]], "reach": "steps"}},
    ],
)
def test_hall_in_blocks(tmp_path, monkeypatch, settings):
    path = tmp_path / "hall.xml"
    path.write_text(HALL)
    config = parse_config({"scene": {"path": str(path)}, "grid": {"cell_size": 0.05}} | settings)
    expected = bake_bytes(config)
    in_blocks(monkeypatch, 1000)
    assert bake_bytes(config) == expected
    in_blocks(monkeypatch, 5000)
    assert bake_bytes(config) == expected
    joined = bake_stages(config).columns
    monkeypatch.undo()
    for one, other in zip(joined.hits, bake_stages(config).columns.hits, strict=True):
        np.testing.assert_array_equal(one, other)


def write_hills(path, rows=60, cols=80) -> None:
    """A hilly height field, finer than the cells, with a house's walls and a slab on it."""
    y, x = np.mgrid[0:rows, 0:cols]
    rng = np.random.default_rng(1)
    heights = 0.5 + 0.4 * np.sin(x / 9) * np.cos(y / 7) + 0.02 * rng.random((rows, cols))
    elevation = " ".join(f"{height:.4f}" for height in heights.ravel())
    path.write_text(
        f"""<mujoco><asset><hfield name="h" nrow="{rows}" ncol="{cols}" size="4 3 .8 .1"
        elevation="{elevation}"/></asset><worldbody>
        <geom name="hills" type="hfield" hfield="h" euler="0 0 17"/>
        <geom name="wall" type="box" size=".1 1.5 1.5" pos=".5 0 1"/>
        <geom name="slab" type="box" size="1 1 .1" pos="-1.5 .5 1.2"/>
        <geom name="deck" type="box" size="1 1 .1" pos="-1.5 .5 3.6"/></worldbody></mujoco>"""
    )


@pytest.mark.parametrize("cell_size", [0.05, 0.2])
def test_height_field_in_pieces_and_chunks(tmp_path, monkeypatch, cell_size):
    path = tmp_path / "hills.xml"
    write_hills(path)
    config = parse_config({"scene": {"path": str(path)}, "grid": {"cell_size": cell_size}})
    monkeypatch.setattr(shapes_module, "TRIANGLES_PER_PIECE", 1 << 20)
    monkeypatch.setattr(shapes_module, "TRIANGLES_PER_BATCH", 1 << 20)
    expected = bake_bytes(config)
    monkeypatch.setattr(shapes_module, "TRIANGLES_PER_PIECE", 500)
    monkeypatch.setattr(shapes_module, "TRIANGLES_PER_BATCH", 1000)
    assert bake_bytes(config) == expected
    # columns stay in memory, triangles don't
    monkeypatch.setattr(column_sources, "MAX_TRIANGLES_BESIDE_COLUMNS", 0)
    monkeypatch.setattr(column_sources, "TRIANGLES_PER_CHUNK", 3000)
    monkeypatch.setattr(column_sources, "MAX_EXPANSIONS_PER_TRIANGLE", np.inf)
    stages = open_stages(config, StageClock())
    assert isinstance(stages.shape_source, ChunkedShapes)
    assert len(stages.shape_source.row_chunks()) > 2
    assert bake_bytes(config) == expected
    in_blocks(monkeypatch, 1000)
    assert bake_bytes(config) == expected


@pytest.mark.parametrize("shape", [(1, 1), (70, 31), (64, 64), (75, 101)])
def test_cells_are_listed_block_by_block_and_brought_back(shape):
    height, width = shape
    blocks = Blocks(Lattice(0.0, 0.0, 0.1, width, height))
    for first_row, end_row in {(0, height), (height // 2 // 8 * 8, height)}:
        cells = np.arange(first_row * width, end_row * width)
        row, col = np.divmod(cells, width)
        expected_cells = cells[np.lexsort((cells, col // BLOCK, row // BLOCK))]
        listed_cells = blocks.list_cells(first_row, end_row)
        np.testing.assert_array_equal(listed_cells, expected_cells)
        cells_by_row = np.empty((end_row - first_row, width), dtype=np.int64)
        blocks.order_by_cell(listed_cells, first_row, cells_by_row)
        np.testing.assert_array_equal(cells_by_row.ravel(), cells)


@pytest.mark.parametrize(
    "rows_by_chunk", [[[7]], [[0], [3, 0, 2]], [[1, 1], [90, 40], [0], [200]], [[], [5]]]
)
def test_rows_of_chunks_are_appended_one_after_the_other(rows_by_chunk):
    """Later chunks may have many more rows than the first one lets expect."""
    rng = np.random.default_rng(0)
    builder = RowsBuilder([np.empty(0, dtype=np.int32), np.empty((0, 3))])
    expected_rows = [[np.empty(0, dtype=np.int32)], [np.empty((0, 3))]]
    for chunk_index, num_rows_of_pieces in enumerate(rows_by_chunk):
        pieces = []
        for num_rows in num_rows_of_pieces:
            pieces.append([np.arange(num_rows, dtype=np.int32), rng.random((num_rows, 3))])
            for arrays, piece_array in zip(expected_rows, pieces[-1], strict=True):
                arrays.append(piece_array)
        builder.append(pieces, (chunk_index + 1) / len(rows_by_chunk))
    assert builder.num_rows == sum(map(sum, rows_by_chunk))
    for array, arrays in zip(builder.build(), expected_rows, strict=True):
        assert array.dtype == arrays[0].dtype
        np.testing.assert_array_equal(array, np.concatenate(arrays))


def test_room_for_rows_is_bounded_where_the_first_cells_have_all_of_them():
    """Reserved memory counts where the address space of a process is limited."""
    builder = RowsBuilder([np.empty(0, dtype=np.int32)])
    builder.append([[np.arange(1000, dtype=np.int32)]], 1 / 64)
    assert builder.build()[0].base.size <= 4000
    builder.append([[np.arange(10, dtype=np.int32)]], 1.0)
    assert len(builder.build()[0]) == 1010


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_cells_of_some_blocks(share):
    lattice = Lattice(0.0, 0.0, 0.1, 101, 75)
    blocks = Blocks(lattice)
    is_selected = np.random.default_rng(0).random(blocks.num_blocks) < share
    row, col = np.divmod(np.arange(lattice.width * lattice.height), lattice.width)
    block = row // BLOCK * blocks.num_cols + col // BLOCK
    np.testing.assert_array_equal(
        blocks.list_cells_of_blocks(is_selected), np.flatnonzero(is_selected[block])
    )
