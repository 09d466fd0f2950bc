"""Surfaces and regions, found by threads and block by block, are those of plain loops."""

from typing import NamedTuple

import numpy as np
import pytest

from navbake.baker.bake.stages import bake_stages
from navbake.baker.columns.columns import Columns, RowChunk
from navbake.baker.core.components import label_components
from navbake.baker.core.limits import make_agent_limits
from navbake.baker.core.tolerances import LIMIT_SLACK, SAME_HEIGHT
from navbake.baker.core.windows import NEIGHBOR_SLICES
from navbake.baker.floors.regions import (
    find_large_regions,
    find_large_remaining_regions,
    find_regions,
    remove_from_regions,
)
from navbake.baker.floors.surface_kernels import STANDABLE, UNCOVERED
from navbake.baker.floors.surfaces import find_surfaces
from navbake.threads import limit_threads

BOXES = 40
GRID = {"cell_size": 0.1, "bounds": [-4.0, -3.5, 4.0, 3.5]}


def scene(seed):
    """Boxes at all heights over a floor: surfaces under others, and covered ones."""
    draw = np.random.default_rng(seed)
    boxes = []
    for _ in range(BOXES):
        x = draw.uniform(-3, 3)
        y = draw.uniform(-3, 3)
        z = draw.choice([0.1, 0.4, 1.5, 3.0])
        half = draw.uniform(0.1, 0.8, 2)
        boxes.append(f'<geom type="box" size="{half[0]} {half[1]} .1" pos="{x} {y} {z}"/>')
    floor = '<geom type="box" size="3.3 3.3 .1" pos="0 0 -.1"/>'
    return f"<mujoco><worldbody>{floor}{''.join(boxes)}</worldbody></mujoco>"


def list_plainly(columns, agent):
    """Cell, height and marks of all surfaces, column by column, where solids hold none of them."""
    limits = make_agent_limits(agent)
    rows = []
    for cell in range(len(columns.start) - 1):
        column = slice(columns.start[cell], columns.start[cell + 1])
        z = columns.z[column]
        up = columns.normal[column, 2]
        last = -np.inf
        for i in np.flatnonzero(up >= limits.min_normal_z):
            inside = np.where(up > 0, 1, -1)[z - z[i] > SAME_HEIGHT].sum()
            above = z[z - z[i] > SAME_HEIGHT].min(initial=np.inf)
            stands = inside <= 0 and above - z[i] >= limits.headroom - LIMIT_SLACK
            stands &= z[i] - last > SAME_HEIGHT  # of several at one height, the lowest
            last = z[i] if stands else last
            is_top = stands and z[-1] - z[i] <= LIMIT_SLACK
            rows.append((cell, z[i], bool(stands), bool(is_top)))
    return rows


def listed(surfaces):
    """The same of surfaces that were rows."""
    rows = []
    for cell in range(len(surfaces.first)):
        for j in range(surfaces.first[cell], surfaces.end[cell]):
            marks = int(surfaces.flags[j])
            rows.append((cell, surfaces.z[j], bool(marks & STANDABLE), bool(marks & UNCOVERED)))
    return rows


def bake(tmp_path, seed=5):
    path = tmp_path / "boxes.xml"
    path.write_text(scene(seed))
    return bake_stages({"scene": {"path": str(path)}, "grid": GRID})


class InBands(NamedTuple):
    """Columns that come in bands of rows; a `ColumnSource`."""

    columns: Columns
    bands: list[RowChunk]

    @property
    def lattice(self):
        return self.columns.lattice

    def row_chunks(self):
        return map(self.columns.select_rows, self.bands)

    def columns_at(self, cells):
        return self.columns


def surfaces_in(stages, bands):
    columns = InBands(stages.columns, bands)
    return find_surfaces(columns, stages.shape_source.shapes.planes, stages.config.agent)


@pytest.mark.parametrize("threads", [1, 3])
def test_surfaces_are_those_of_a_plain_loop(tmp_path, threads):
    stages = bake(tmp_path)
    expected = list_plainly(stages.columns, stages.config.agent)
    assert sum(stands for _, _, stands, _ in expected) > 4000
    all_rows = stages.columns.valid_rows
    middle = RowChunk(0, 32)
    with limit_threads(threads):
        for blocks in ([all_rows], [middle, RowChunk(middle.end, all_rows.end)]):
            assert listed(surfaces_in(stages, blocks)) == expected


def check_regions(regions, step):
    """Hold the regions against parts of one graph of all surfaces."""
    lattice = regions.lattice
    rows = [row for row in listed(regions.surfaces) if row[2]]
    cell, z = (np.array(part) for part in list(zip(*rows, strict=True))[:2])
    at = [np.flatnonzero(cell == k) for k in range(lattice.width * lattice.height)]
    ids = np.arange(len(at)).reshape(lattice.shape)
    pairs = [(0, 0)]
    for first_slice, second_slice in NEIGHBOR_SLICES:
        for a, b in zip(ids[first_slice].ravel(), ids[second_slice].ravel(), strict=True):
            pairs += [
                (i, j) for i in at[a] for j in at[b] if abs(z[i] - z[j]) <= step + LIMIT_SLACK
            ]
    number = label_components(np.array(pairs).T, len(cell))
    assert np.array_equal(regions.num_surfaces, np.bincount(number))
    top = np.array([row[3] for row in rows])
    assert np.array_equal(regions.num_uncovered, np.bincount(number, top).astype(int))
    for region in range(regions.num_regions):
        members = regions.surfaces_of(region)
        assert np.array_equal(members.cell, cell[number == region])
        assert np.array_equal(members.z, z[number == region])
        row, col = np.divmod(members.cell, lattice.width)
        box = [row.min(), col.min(), row.max() + 1, col.max() + 1]
        assert regions.box[region].tolist() == box
    over = np.zeros(regions.num_regions, dtype=np.int64)
    for i in range(1, len(cell)):
        over[number[i]] += cell[i - 1] == cell[i] and number[i - 1] != number[i]
    above, below, count = regions.find_stacks()
    assert np.array_equal(np.bincount(above, count * (above != below), len(over)), over)


@pytest.mark.parametrize("seed", [5, 6])
def test_regions_are_the_parts_of_one_graph(tmp_path, seed):
    stages = bake(tmp_path, seed)
    surfaces = surfaces_in(stages, [stages.columns.valid_rows])
    regions = find_regions(surfaces, stages.config.agent)
    check_regions(regions, stages.config.agent.traversable_floor_height)


@pytest.mark.parametrize("num_removed", [1, 30, 3000])
@pytest.mark.parametrize("seed", [5, 6])
def test_regions_without_some_surfaces_are_those_of_the_others(tmp_path, seed, num_removed):
    """Only some blocks are labelled again, and only some regions are tested for their size."""
    stages = bake(tmp_path, seed)
    agent, settings = stages.config.agent, stages.config.floors
    surfaces = surfaces_in(stages, [stages.columns.valid_rows])
    regions = find_regions(surfaces, agent)
    is_removed = np.zeros(len(surfaces.z), dtype=np.bool_)
    first = np.random.default_rng(seed).integers(0, max(len(surfaces.z) - num_removed, 1))
    is_removed[first : first + num_removed] = True
    removed_surfaces = np.flatnonzero(is_removed)
    flags = np.where(is_removed, 0, surfaces.flags).astype(np.uint8)
    expected = find_regions(surfaces._replace(flags=flags), agent)
    changed_blocks = regions.list_blocks_of(removed_surfaces)
    limits_to_try = [
        settings.model_copy(update={"min_area": min_area, "shrink": 0.0})
        for min_area in (0.01, 0.1, 1.0)
    ]
    is_large_before = [
        find_large_regions(regions, regions.num_surfaces > 0, limits) for limits in limits_to_try
    ]
    remaining = remove_from_regions(regions, removed_surfaces, changed_blocks, agent)
    assert np.array_equal(remaining.surfaces.flags, flags)
    for name in ("num_surfaces", "num_uncovered", "box", "lowest_z", "highest_z"):
        assert np.array_equal(getattr(remaining, name), getattr(expected, name)), name
    assert np.array_equal(remaining.region_of_component, expected.region_of_component)
    for name in expected.components._fields:
        values = getattr(remaining.components, name)
        assert np.array_equal(values, getattr(expected.components, name)), name
    for limits, is_large in zip(limits_to_try, is_large_before, strict=True):
        is_large_now = find_large_remaining_regions(
            remaining, regions, is_large, changed_blocks, limits
        )
        assert np.array_equal(
            is_large_now, find_large_regions(expected, expected.num_surfaces > 0, limits)
        )
