"""Walls at many places of the raster, and houses on slabs of many heights: none is special."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from box_truth import TINY, centers, occupied_by_boxes, within
from box_worlds import box, world
from hard_cases import GROUND, STONES, house_on_slab
from navbake.baker.bake.pipeline import run_bake
from navbake.config.settings import parse_config
from navbake.navgrid.grid import SceneGrid2D
from navbake.navgrid.islands import find_islands
from navbake.runtime.path_finder import PathFinder
from navbake.types import Bool, Float

# Each wall crosses a lane of its own; the lanes lie beside each other, with a gap between them
LANE, PITCH, HALF = 0.7, 0.8, 0.8  # width, distance, half length [m]
# every multiple of 1 cm, and 1 mm past it
PLACES = [round(n / 100 + past, 3) for n in range(-40, 41) for past in (0.0, 0.001)]
BLIND = 'contype="0" conaffinity="0"'  # else MuJoCo wants a hull of it
# the ends of house walls, from the ceiling [m]
ENDS = [-0.002, -0.001, 0.0, 0.001, 0.002]


def bake(path: Path, xml: str, **settings) -> SceneGrid2D:
    path.write_text(xml, encoding="utf-8")
    scene = {"path": str(path), **settings.pop("scene", {})}
    grid = run_bake(parse_config({"scene": scene, **settings})).grid
    assert isinstance(grid, SceneGrid2D)
    return grid


# ---------------------------------------------------------------- walls without thickness


def lanes(folder: Path, kind: str, along: str, cell: float, radius: float) -> SceneGrid2D:
    """Lanes along an axis, and a wall without thickness across each of them."""
    is_x = along == "x"

    def rect(a0: float, b0: float, a1: float, b1: float) -> tuple[float, float, float, float]:
        return (a0, b0, a1, b1) if is_x else (b0, a0, b1, a1)

    pieces, vertices = [], []
    for number, place in enumerate(PLACES):
        low, high = PITCH * number, PITCH * number + LANE
        x0, y0, x1, y1 = rect(-HALF, low, HALF, high)
        pieces.append(box("", x0, y0, -0.1, x1, y1, 0))
        # a plane's own axes lie differently where its normal turns to x than to y
        middle = (low + high) / 2
        at, turn, size = (
            (f"{place} {middle}", "1 0 0", f"1 {LANE / 2}")
            if is_x
            else (f"{middle} {place}", "0 1 0", f"{LANE / 2} 1")
        )
        if kind == "plane":
            pieces.append(f'<geom type="plane" size="{size} 1" pos="{at} 1" zaxis="{turn}"/>')
        vertices += [rect(place, b, 0, 0)[:2] if is_x else (b, place) for b in (low, high)]
    asset = ""
    if kind == "mesh":
        corners = [(*vertex, z) for vertex in vertices for z in (0.0, 2.0)]
        text = " ".join(str(value) for corner in corners for value in corner)
        starts = range(0, len(corners), 4)
        faces = " ".join(f"{i} {i + 1} {i + 2} {i + 1} {i + 3} {i + 2}" for i in starts)
        asset = f'<mesh name="walls" vertex="{text}" face="{faces}" inertia="shell"/>'
        pieces.append(f'<geom type="mesh" mesh="walls" {BLIND}/>')
    return bake(
        folder / "lanes.xml",
        world("".join(pieces), asset),
        scene={"geoms": "all"},
        grid={"cell_size": cell, "bounds": list(rect(-HALF, 0.0, HALF, PITCH * len(PLACES)))},
        agent={"radius": radius},
        floors={"min_area": 0.0, "shrink": 0.0},
        rooms="none",
        names={"enabled": False},
    )


def on_lanes(level: SceneGrid2D, along: str) -> tuple[Float, Float, Bool]:
    """Of each cell: where it is along its lane, that lane's wall, and whether it is on a lane."""
    x, y = centers(level)
    run, across = (x, y) if along == "x" else (y, x)
    number = np.floor(across / PITCH).astype(int)
    is_lane: Bool = across - number * PITCH < LANE
    return run, np.array(PLACES)[number], is_lane


@pytest.mark.parametrize("kind", ["plane", "mesh"])
@pytest.mark.parametrize(
    ("along", "cell", "radius"), [("x", 0.1, 0.05), ("y", 0.1, 0.0), ("x", 0.05, 0.0)]
)
def test_wall_without_thickness_parts_its_lane(tmp_path, kind, along, cell, radius):
    level = lanes(tmp_path, kind, along, cell, radius)
    run, wall, is_lane = on_lanes(level, along)
    touched = abs(run - wall) <= cell / 2 + TINY  # the closed square
    np.testing.assert_array_equal(level.free, is_lane & ~touched)

    for wider in (0.0, 0.15, 0.25):
        grid = level.inflate(wider) if wider else level
        island = find_islands(grid)[0]
        finder = PathFinder(grid)
        for number, place in enumerate(PLACES):
            here = grid.free & is_lane & (wall == place)
            before, behind = here & (run < place), here & (run > place)
            # there is room on both sides, and no way from one to the other
            assert before.any() and behind.any(), place
            assert not set(island[before]) & set(island[behind]), place
            if number % 10 == 0:
                ends = [(*np.stack(centers(grid))[:, side][:, 0], 0.0) for side in (before, behind)]
                assert finder.find_path(*ends) is None
                assert not finder.line_of_sight(*ends)


# ---------------------------------------------------------------- houses on slabs


@pytest.mark.parametrize("slab", [0.02, 0.05, 0.1, 0.15, 0.2, 0.24, 0.26, 0.3])
def test_house_has_the_same_floor_wherever_its_walls_end(tmp_path, slab):
    levels = []
    for end in ENDS:
        boxes = [*STONES, *house_on_slab(slab, 2.6 + end)]
        xml = world("".join(box("", *corners) for corners in boxes) + GROUND)
        level = bake(tmp_path / f"{end}.xml", xml)
        levels.append(level)
        # the room and the door's threshold, to a cell
        room = within(level, 0.2, 0.2, 7.8, 7.8) | within(level, 3.6, 0, 4.4, 0.2)
        assert (abs(level.floor_height - slab) < 1e-6)[room].all()
        has_floor = ~np.isnan(level.floor_height)
        blocked = occupied_by_boxes(level, boxes)
        np.testing.assert_array_equal(level.free, has_floor & ~blocked)
        assert level.free[room].all()
        outside = ~within(level, 0, 0, 8, 8)
        stones = within(level, -3, 0, -2.9, 0.1) | within(level, 10.9, 7.9, 11, 8)
        assert (level.floor_height[outside & ~stones] == 0).all()
    for level in levels[1:]:
        for layer in ("floorHeight", "occupancy", "roomIndex"):
            np.testing.assert_array_equal(level.attributes[layer], levels[0].attributes[layer])
