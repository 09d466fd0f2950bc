"""Surfaces and sheets, found by threads and block by block, are those of plain loops."""

import numpy as np
import pytest

from navbake.baker.columns import Rows
from navbake.baker.connect import connect
from navbake.baker.floors.kernels.surfaces import STANDS, TOP
from navbake.baker.floors.sheets import Sheets
from navbake.baker.floors.surfaces import SurfaceStore, agent_limits
from navbake.baker.kernels.constants import SAME, SLACK
from navbake.baker.lattice import EDGES
from navbake.baker.stages import bake_stages
from navbake.threads import limit_threads

BOXES = 40
GRID = {"cell_size": 0.1, "bounds": [-4.0, -3.5, 4.0, 3.5]}


def scene(seed):
    """Boxes at all heights over a floor: surfaces under others, and covered ones."""
    draw = np.random.default_rng(seed)
    boxes = []
    for _ in range(BOXES):
        x, y, z = draw.uniform(-3, 3), draw.uniform(-3, 3), draw.choice([0.1, 0.4, 1.5, 3.0])
        half = draw.uniform(0.1, 0.8, 2)
        boxes.append(f'<geom type="box" size="{half[0]} {half[1]} .1" pos="{x} {y} {z}"/>')
    floor = '<geom type="box" size="3.3 3.3 .1" pos="0 0 -.1"/>'
    return f"<mujoco><worldbody>{floor}{''.join(boxes)}</worldbody></mujoco>"


def list_plainly(columns, agent):
    """Cell, height and marks of all surfaces, column by column, where solids hold none of them."""
    limits, found = agent_limits(agent), []
    for cell in range(len(columns.start) - 1):
        here = slice(columns.start[cell], columns.start[cell + 1])
        z, up, last = columns.z[here], columns.normal[here, 2], -np.inf
        for i in np.flatnonzero(up >= limits.min_up):
            inside = np.where(up > 0, 1, -1)[z - z[i] > SAME].sum()
            above = z[z - z[i] > SAME].min(initial=np.inf)
            stands = inside <= 0 and above - z[i] >= limits.headroom - SLACK
            stands &= z[i] - last > SAME  # of several at one height, the lowest
            last = z[i] if stands else last
            is_top = stands and z[-1] - z[i] <= SLACK
            found.append((cell, z[i], bool(stands), bool(is_top)))
    return found


def listed(store):
    """The same of a store."""
    surfaces, found = store.surfaces, []
    for cell in range(len(surfaces.first)):
        for j in store.at(cell).tolist():
            marks = int(surfaces.marks[j])
            found.append((cell, surfaces.z[j], bool(marks & STANDS), bool(marks & TOP)))
    return found


def bake(tmp_path, seed=5):
    path = tmp_path / "boxes.xml"
    path.write_text(scene(seed))
    return bake_stages({"scene": {"path": str(path)}, "grid": GRID})


def store_of(stages, blocks):
    store = SurfaceStore(stages.lattice, stages.config.agent)
    for rows in blocks:
        store.add(stages.columns.only_rows(rows), stages.tiled.shapes.planes)
    store.finish()
    return store


@pytest.mark.parametrize("threads", [1, 3])
def test_surfaces_are_those_of_a_plain_loop(tmp_path, threads):
    stages = bake(tmp_path)
    expected = list_plainly(stages.columns, stages.config.agent)
    assert sum(stands for _, _, stands, _ in expected) > 4000
    whole, middle = stages.columns.known_rows, Rows(0, 32)
    with limit_threads(threads):
        for blocks in ([whole], [middle, Rows(middle.end, whole.end)]):
            assert listed(store_of(stages, blocks)) == expected


def check_sheets(sheets, step):
    """Hold the sheets against parts of one graph of all surfaces."""
    store, lattice = sheets.store, sheets.lattice
    rows = [row for row in listed(store) if row[2]]
    cell, z = (np.array(part) for part in list(zip(*rows, strict=True))[:2])
    at = [np.flatnonzero(cell == k) for k in range(lattice.width * lattice.height)]
    ids, pairs = np.arange(len(at)).reshape(lattice.shape), [(0, 0)]
    for one, other in EDGES:
        for a, b in zip(ids[one].ravel(), ids[other].ravel(), strict=True):
            pairs += [(i, j) for i in at[a] for j in at[b] if abs(z[i] - z[j]) <= step + SLACK]
    number = connect(np.array(pairs).T, len(cell))
    assert np.array_equal(sheets.size, np.bincount(number))
    top = np.array([row[3] for row in rows])
    assert np.array_equal(sheets.tops, np.bincount(number, top).astype(int))
    for sheet in range(len(sheets.key)):
        members = sheets.members(sheet)
        assert np.array_equal(members.cell, cell[number == sheet])
        assert np.array_equal(members.z, z[number == sheet])
        row, col = np.divmod(members.cell, lattice.width)
        box = [row.min(), col.min(), row.max() + 1, col.max() + 1]
        assert sheets.box[sheet].tolist() == box
    over = np.zeros(len(sheets.key), dtype=np.int64)
    for i in range(1, len(cell)):
        over[number[i]] += cell[i - 1] == cell[i] and number[i - 1] != number[i]
    above, below, count = sheets.stacks()
    assert np.array_equal(np.bincount(above, count * (above != below), len(over)), over)


def test_blocks_that_change_leave_the_sheets_of_a_fresh_bake(tmp_path):
    """Columns of one scene take the place of those of another, some cells at a time."""
    one, other = bake(tmp_path), bake(tmp_path, seed=6)
    planes, agent = one.tiled.shapes.planes, one.config.agent
    store = store_of(one, [one.columns.known_rows])
    sheets = Sheets(store, agent)
    every = sheets.blocks.all()
    sheets.update(every, every)
    check_sheets(sheets, agent.traversable_floor_height)
    rng, num = np.random.default_rng(3), len(one.columns.start) - 1
    order = rng.permutation(num)
    for cells in (order[:5], order[5:400], order[400:2000], order[2000:]):
        cells = np.sort(cells)
        changed, _ = store.replace(cells, other.columns, planes)
        stale = sheets.blocks.holding(changed)
        sheets.update(stale, stale)
        check_sheets(sheets, agent.traversable_floor_height)
    fresh = Sheets(store_of(other, [other.columns.known_rows]), agent)
    fresh.update(every, every)
    for name in ("key", "size", "tops", "box", "digest"):
        assert np.array_equal(getattr(sheets, name), getattr(fresh, name)), name
