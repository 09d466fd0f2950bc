"""Storeys on round coordinates: seams, treads without room, voids, floors in planes, equal tops."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from box_worlds import box, stages_of_xml, world
from navbake.baker.bake.pipeline import run_bake
from navbake.baker.bake.stages import Stages, bake_stages
from navbake.baker.bake.warnings import collect_warnings
from navbake.baker.columns.columns import cast_columns
from navbake.baker.core.blocks import replace_slices
from navbake.config.settings import parse_config
from navbake.runtime.path_finder import PathFinder

GROUND = '<geom name="ground" type="plane" size="0 0 1"/>'


def two_storeys(under: float = 0.0) -> str:
    """Two storeys of 8.2 x 6.2 m; a stair that fills its opening, or reaches under its edges."""
    slabs = [(0, 1.5, 0, 6.2), (5, 8.2, 0, 6.2), (1.5, 5, 0, 0.25), (1.5, 5, 1.25, 6.2)]
    geoms = [box("", 0, 0, -0.2, 8.2, 6.2, 0), box("", 0, 0, 5.3, 8.2, 6.2, 5.5)]
    geoms += [box("", x0, y0, 2.6, x1, y1, 2.8) for x0, x1, y0, y1 in slabs]
    for k in range(14):
        x = 1.5 + 0.25 * k
        z = 0.2 * (k + 1)
        geoms.append(box(f"tread{k}", x, 0.25 - under, z - 0.05, x + 0.25, 1.25 + under, z))
    for x0, y0, x1, y1 in [
        (0, 0, 8.2, 0.15), (0, 6.05, 8.2, 6.2), (0, 0, 0.15, 6.2), (8.05, 0, 8.2, 6.2),
    ]:  # fmt: skip
        geoms.append(box("", x0, y0, 0, x1, y1, 5.3))
    return world("".join(geoms))


def grounds(stages: Stages) -> list[float]:
    return [round(level.ground, 6) for level in stages.floors.levels]


def warnings_of(stages: Stages) -> list[str]:
    return collect_warnings(stages.config, stages.baked_structure, stages.baked_pose)


@pytest.mark.parametrize("cell", [0.05, 0.08, 0.1, 0.11])
def test_stair_that_fills_its_opening_is_no_storey(tmp_path: Path, cell):
    path = tmp_path / "scene.xml"
    path.write_text(two_storeys())
    done = run_bake(parse_config({"scene": {"path": str(path)}, "grid": {"cell_size": cell}}))
    assert [level.ground for level in done.grid.levels] == pytest.approx([0, 2.8], abs=1e-6)
    assert PathFinder(done.grid).find_path([7, 3, 0], [7, 3, 2.8]) is not None
    assert done.warnings == []


def test_treads_without_room_in_their_columns_are_left_out(tmp_path: Path):
    stages = stages_of_xml(tmp_path, two_storeys(under=0.06))
    assert grounds(stages) == [0, 2.8]
    [warning] = [text for text in warnings_of(stages) if "more floors than there are" in text]
    count = sum(len(patch.cells) for patch in stages.floors.surfaces_without_level)
    assert 0 < count < 40
    assert f"{count} cells of 'tread" in warning


@pytest.mark.parametrize("size", [0.5, 1.5])
def test_what_a_walk_needs_opens_a_level(tmp_path: Path, size):
    """Two turns of a stair between two storeys: without either turn, nobody gets up.

    The floor under narrow treads is left out, as nobody needs it; that under wide ones is a floor
    as good as any.
    """
    far = 8 * size
    turn = 2 * size
    top = 4.8
    geoms = [box("", -far, -far, -0.2, far, far, 0)]
    sides = [(-far, -far, -turn, far), (turn, -far, far, far)]
    sides += [(-turn, -far, turn, -turn), (-turn, turn, turn, far)]
    geoms += [box("", x0, y0, top - 0.2, x1, y1, top) for x0, y0, x1, y1 in sides]
    cells_around = [(0, -2), (1, -2), (1, -1), (1, 0), (1, 1), (0, 1)]
    cells_around += [(-1, 1), (-2, 1), (-2, 0), (-2, -1), (-2, -2), (-1, -2)]
    for k in range(24):
        i, j = cells_around[k % 12]
        z = 0.2 * (k + 1)
        x = i * size
        y = j * size
        geoms.append(box("", x, y, z - 0.05, x + size, y + size, z))
    stages = stages_of_xml(tmp_path, world("".join(geoms)))
    if size == 0.5:
        assert grounds(stages) == [0, 4.8]
        assert 1 < sum(patch.area for patch in stages.floors.surfaces_without_level) < 2
    else:
        assert len(stages.floors.levels) > 2
        assert stages.floors.surfaces_without_level == []
    assert stages.floors.unreached_floors == []


def test_a_level_of_its_own_takes_whole_decks(tmp_path: Path):
    """A bridge over a path, both needed; the path lies below 4 mm of its height only."""
    parts = [(-4, 2, 4, 6, 0.0), (-4, -6, 4, -2, 0.0), (-0.4, -2, 0.4, 2, 0.0)]
    parts += [(-2, -0.4, -0.4, 0.4, 1.996), (-0.4, -0.4, 0.4, 0.4, 2.0), (0.4, -0.4, 2, 0.4, 1.996)]
    parts += [(-4, -1, -2, 1, 2.0), (2, -1, 4, 1, 2.0)]
    parts += [(-4, 1 + 0.3 * k, -3, 1.3 + 0.3 * k, 1.8 - 0.2 * k) for k in range(9)]
    geoms = [box("", x0, y0, z - 0.1, x1, y1, z) for x0, y0, x1, y1, z in parts]
    stages = stages_of_xml(tmp_path, world("".join(geoms)))
    assert grounds(stages) == [0, 1.996]
    assert np.count_nonzero(stages.floors.levels[1].floor > 1.9) == 40 * 8 + 2 * 20 * 20


@pytest.mark.parametrize("thickness", [0.06, 0.2])
def test_treads_that_lean_are_one_walk(tmp_path: Path, thickness):
    """A line meets the side of a tread, as the stair leans; the floor there is the tread's below.

    A block higher than a step is no stair for that.
    """
    geoms = [box("", -2, -6, -0.2, 2, 6, 0), box("block", -2, 3, 0, 2, 6, 0.45)]
    for k in range(12):
        y = -4 + 0.285 * k
        z = 0.19 * (k + 1)
        geoms.append(box("", 0, y, max(z - thickness, 0), 1, y + 0.285, z))
    geoms.append(box("", 0, -0.58, 2.2, 1, 1, 2.4))
    leaning = f'<body euler="1 0 0">{"".join(geoms)}</body>'
    settings = {"scene": {"path": str(tmp_path / "scene.xml")}, "grid": {"cell_size": 0.02}}
    (tmp_path / "scene.xml").write_text(world(leaning))
    finder = PathFinder(run_bake(parse_config(settings)).grid)
    assert finder.find_path([0.5, -5.0, -0.1], [0.5, 0.5, 2.4]) is not None
    assert finder.find_path([-1.0, -5.0, -0.1], [-1.0, 4.5, 0.53]) is None


def cast(folder: Path, xml: str) -> Stages:
    return stages_of_xml(folder, xml, grid={"cell_size": 0.1, "bounds": [[0, 0], [1, 1]]})


def column(stages: Stages, x: float, y: float) -> list[tuple[float, int]]:
    columns = stages.floor_columns.columns_at(np.arange(stages.floor_columns.lattice.width))
    lattice = columns.lattice
    row, col = (int(i[0]) for i in lattice.rows_cols([[x, y]]))
    first, end = columns.start[[row * lattice.width + col, row * lattice.width + col + 1]]
    z = columns.z[first:end]
    geom = columns.geom[first:end]
    return list(zip(z.round(6).tolist(), geom.tolist(), strict=True))


def test_line_in_a_common_face_belongs_to_the_eastern_and_northern_geom(tmp_path: Path):
    # of cells of 0.1 m that begin at 0, centres lie at 0.05, 0.15, …
    west = box("", 0, 0, 0, 0.45, 1, 0.2)
    east = box("", 0.45, 0, 0, 1, 1, 0.7)
    stages = stages_of_xml(tmp_path, world(west + east))
    assert column(stages, 0.45, 0.95) == [(0.0, 1), (0.7, 1)]
    assert column(stages, 0.35, 0.95) == [(0.0, 0), (0.2, 0)]
    south = box("", 0, 0, 0, 1, 0.45, 0.2)
    north = box("", 0, 0.45, 0, 1, 1, 0.7)
    stages = stages_of_xml(tmp_path, world(south + north))
    columns = stages.floor_columns.columns_at(np.arange(100))
    cell = 5 * 10 + 3  # of the row whose centre is at y = 0.45
    first = columns.start[cell]
    end = columns.start[cell + 1]
    assert columns.geom[first:end].tolist() == [1, 1]


def test_line_in_an_outer_face_keeps_its_geom(tmp_path: Path):
    west = box("", 0, 0, 0, 0.45, 1, 0.2)
    floor = box("", 0, 0, -0.2, 1, 1, -0.1)
    stages = stages_of_xml(tmp_path, world(west + floor))
    assert (0.2, 0) in column(stages, 0.45, 0.95)


def test_seams_of_meshes_are_settled_as_those_of_boxes(tmp_path: Path):
    boxes = stages_of_xml(tmp_path, two_storeys())
    solids = boxes.scene.shapes.solids
    mesh = tmp_path / "house.ply"
    trimesh.util.concatenate([
        trimesh.creation.box(2 * size, trimesh.transformations.translation_matrix(pos))
        for pos, size in zip(solids.pos, solids.size, strict=True)
    ]).export(mesh)  # fmt: skip
    box_stages = boxes
    mesh_stages = bake_stages({"scene": {"path": str(mesh), "up": "z"}})
    settled = []
    for stages in (box_stages, mesh_stages):
        columns = stages.floor_columns.columns_at(np.arange(3))
        raw = cast_columns(stages.floor_shape_source)
        settled.append(np.flatnonzero(np.diff(columns.start) != np.diff(raw.start)).tolist())
    assert settled[0] == settled[1] != []
    assert grounds(box_stages) == grounds(mesh_stages) == [0, 2.8]


def test_splice_is_numpys_insert_and_delete():
    rng = np.random.default_rng(0)
    for _ in range(50):
        old = rng.integers(0, 99, 30)
        new = rng.integers(100, 199, 12)
        cuts = np.sort(rng.choice(31, 8, replace=False)).reshape(4, 2)
        start = np.sort(rng.integers(0, 13, 5))
        start[[0, -1]] = 0, 12
        wanted: list[int] = []
        at = 0
        for k, (first, last) in enumerate(cuts.tolist()):
            wanted += [*old[at:first], *new[start[k] : start[k + 1]]]
            at = last
        wanted += old[at:].tolist()
        assert replace_slices(old, cuts[:, 0], cuts[:, 1], new, start).tolist() == wanted


def plenum(gap: float) -> str:
    """A room of 10 x 8 m with a suspended ceiling, `gap` [m] under its slab."""
    high = 2.68 + gap
    geoms = [box("", 0, 0, -0.3, 10, 8, 0), box("ceiling", 0.2, 0.2, 2.66, 9.8, 7.8, 2.68)]
    geoms += [box("", 0, 0, high, 10, 8, high + 0.3)]
    sides = [(0, 0, 0.2, 8), (9.8, 0, 10, 8), (0, 0, 10, 0.2), (0, 7.8, 10, 8)]
    return world("".join(geoms + [box("", x0, y0, 0, x1, y1, high) for x0, y0, x1, y1 in sides]))


def test_void_is_no_level(tmp_path: Path):
    stages = stages_of_xml(tmp_path, plenum(1.34))
    assert grounds(stages) == [0]
    [warning] = warnings_of(stages)
    assert "the void over 'ceiling' (73.0 m² at 2.68 m); `floors.voids: true` keeps all" in warning
    assert grounds(stages_of_xml(tmp_path, plenum(1.34), floors={"voids": True})) == [0, 2.68]
    assert grounds(stages_of_xml(tmp_path, plenum(1.9))) == [0, 2.68]


def test_crawl_space_below_is_no_level_and_not_where_one_starts(tmp_path: Path):
    geoms = [box("", 0, 0, -1.8, 10, 8, -1.6), box("floor", 0, 0, -0.2, 10, 8, 0)]
    geoms += [box("", 0, 0, 2.6, 10, 8, 2.8)]
    sides = [(0, 0, 0.2, 8), (9.8, 0, 10, 8), (0, 0, 10, 0.2), (0, 7.8, 10, 8)]
    geoms += [box("", x0, y0, -1.6, x1, y1, 2.6) for x0, y0, x1, y1 in sides]
    stages = stages_of_xml(tmp_path, world("".join(geoms)))
    assert grounds(stages) == [0]
    assert stages.floors.unreached_floors == []
    assert [round(patch.area) for patch in stages.floors.voids] == [73]


def test_floor_inside_an_endless_plane_is_told(tmp_path: Path):
    geoms = [GROUND, box("", 0, 0, -2.9, 8, 7, -2.7), box("", 0, 0, -0.2, 8, 7, 0.1)]
    stages = stages_of_xml(tmp_path, world("".join(geoms)))
    [warning] = [text for text in warnings_of(stages) if "endless plane" in text]
    assert "56.0 m² at -2.70 m under 'ground'" in warning
    assert "scene.exclude.geoms" in warning


@pytest.mark.parametrize("cell", [0.05, 0.08, 0.1, 0.13])
def test_of_equal_terraces_the_upper_ones_are_tops(tmp_path: Path, cell):
    geoms = [box("", 0, 1.5 * k, -1, 8, 1.5 * (k + 1), 0.4 * k) for k in range(5)]
    stages = stages_of_xml(tmp_path, world("".join(geoms)), grid={"cell_size": cell})
    [level] = stages.floors.levels
    assert np.nanmax(level.floor[level.standable]) == 0
    assert len(stages.floors.tops) == 4
    assert any("and 3 more); `floors.from:" in text for text in warnings_of(stages))


@pytest.mark.parametrize(("wide", "num_tops"), [(2.0, 1), (3.4, 0)])
def test_top_that_is_nowhere_wide_is_none_however_large(tmp_path: Path, wide, num_tops):
    """A comb of walls, larger than the floor between them."""
    geoms = [box("", 0, 0, -0.2, 40, 6 + wide, 0), box("", 0, 6, 0, 40, 6 + wide, 2)]
    for k in range(6):
        geoms.append(box("", 6.5 * k, 0, 0, 6.5 * k + wide * 2.2 / 2 - 0.2, 6, 2))
    stages = stages_of_xml(tmp_path, world("".join(geoms)))
    top = sum(len(patch.cells) for patch in stages.floors.tops) > 0
    assert top == bool(num_tops)
