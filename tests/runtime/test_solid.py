"""Inflation from bakes of any radius: the layer `solid` makes them equal, cell for cell."""

from __future__ import annotations

import numpy as np
import pytest

import navbake
from box_worlds import body, box, world
from differences import first_difference
from navbake.formats.navgrid import dumps_navgrid

RADII = (0.0, 0.05, 0.17, 0.3)  # the last ones beyond half a cell of 0.1 m, and its diagonal


def bake(folder, content: str, radius: float, cell: float = 0.1, **settings):
    path = folder / "scene.xml"
    path.write_text(world(content), encoding="utf-8")
    agent = {"radius": radius, **settings.pop("agent", {})}
    scene = {"path": str(path)}
    return navbake.bake({"scene": scene, "agent": agent, "grid": {"cell_size": cell}, **settings})


def random_things(rng, count: int) -> str:
    """Posts, boxes, balls and things that hang, turned as they like, all on one flat floor."""
    things = []
    for _ in range(count):
        x, y = rng.uniform(-1.4, 1.4, 2)
        kind = rng.choice(["box", "cylinder", "sphere", "capsule"])
        size = " ".join(f"{v:.3f}" for v in rng.uniform(0.04, 0.3, 3))
        z = rng.choice([0.6, 0.75, 1.0])
        turn = " ".join(f"{v:.1f}" for v in (0, 0, rng.uniform(0, 90)))
        things.append(
            f'<geom type="{kind}" size="{size}" pos="{x:.3f} {y:.3f} {z}" euler="{turn}"/>'
        )
    return "".join(things)


def same_free(one, other) -> bool:
    pairs = zip(one.levels, other.levels, strict=True)
    return all(np.array_equal(a.weights, b.weights) for a, b in pairs)


@pytest.mark.parametrize("seed", range(6))
def test_inflated_from_any_bake_is_inflated_from_radius_0(tmp_path, seed):
    rng = np.random.default_rng(seed)
    content = box("floor", -2, -2, -0.1, 2, 2, 0) + random_things(rng, 6)
    cell = float(rng.choice([0.1, 0.13]))
    bakes = [bake(tmp_path, content, radius, cell) for radius in RADII]
    for grid, radius in zip(bakes, RADII, strict=True):
        assert ("solid" in grid.attributes) == (radius > cell / 2)
        np.testing.assert_array_equal(grid.solid, bakes[0].occupancy)
    for radius in (0.0, 0.1, 0.17, 0.26, 0.4):
        of_point = bakes[0].inflate(radius, clearance=0.2)
        for grid in bakes[1:]:
            assert same_free(grid.inflate(radius, clearance=0.2), of_point)
        native = bake(tmp_path, content, radius, cell)
        assert not (of_point.free & ~native.free).any()
    costs = [grid.inflate(0.2, costs="nav2") for grid in bakes]
    assert all(same_free(grid, costs[0]) for grid in costs)
    outline = [(0.3, 0.1), (-0.1, 0.1), (-0.1, -0.1), (0.3, -0.1)]
    masks = [grid.inflate_footprint(outline, 4)[0] for grid in bakes]
    assert all(np.array_equal(mask, masks[0]) for mask in masks)


@pytest.mark.parametrize("offset", [0.0, 0.005, 0.01, 0.02, 0.035])
def test_a_door_that_lets_an_agent_through_when_baked_does_so_when_inflated(tmp_path, offset):
    walls = box("", -2, -0.05, 0, offset - 0.35, 0.05, 2) + box(
        "", offset + 0.35, -0.05, 0, 2, 0.05, 2
    )
    content = box("floor", -2, -1, -0.1, 2, 1, 0) + walls
    for radius in (0.0, 0.05, 0.2, 0.3):
        grid = bake(tmp_path, content, radius, 0.05).inflate(0.3)
        path = navbake.PathFinder(grid).find_path((0, -0.8, 0), (0, 0.8, 0))
        assert path is not None, radius


HOUSE = (
    box("ground", -2, -2, -0.1, 2, 2, 0)
    + box("", -2, -2, 0, -1.9, 2, 2.4)
    + box("upper", -2, -2, 2.4, 0.6, 2, 2.5)
    + box("", -0.5, 0.3, 2.5, -0.4, 2, 4)
    + box("", 1.2, 1.0, 0, 1.3, 1.1, 2)
)


def test_levels_equal_those_of_radius_0_also_when_saved_alone(tmp_path):
    # without walls round it, the upper storey would be taken for a roof
    bakes = [bake(tmp_path, HOUSE, radius, floors={"roofs": True}) for radius in RADII]
    assert all(len(grid.levels) == 2 for grid in bakes)
    for radius in (0.0, 0.15, 0.33):
        inflated = [grid.inflate(radius) for grid in bakes]
        assert all(same_free(grid, inflated[0]) for grid in inflated)
    for number in range(2):
        alone = [navbake.load(dumps_navgrid(grid.levels[number])) for grid in bakes]
        assert "solid" in alone[-1].attributes
        inflated = [grid.inflate(0.2) for grid in alone]
        assert all(same_free(grid, inflated[0]) for grid in inflated)


ROOMS = (
    box("floor", -2, -2, -0.1, 2, 2, 0)
    + box("", -2, -0.05, 0, -0.45, 0.05, 2)
    + box("", 0.45, -0.05, 0, 2, 0.05, 2)
    + "".join(box("", *sides, 0, *ends, 2) for sides, ends in (
        ((-2, -2), (2, -1.9)), ((-2, 1.9), (2, 2)), ((-2, -2), (-1.9, 2)), ((1.9, -2), (2, 2))
    ))
    + body(
        "door",
        '<joint type="hinge" axis="0 0 1" pos="-.45 0 0" range="0 90"/>'
        '<geom type="box" size=".44 .02 1" pos="0 0 1"/>',
    )
)  # fmt: skip


@pytest.mark.parametrize("state", ["open", "closed", "removed"])
def test_doors_have_solid_cells_of_their_own(tmp_path, state):
    doors = {"doors": {"patterns": ["door"]}}
    bakes = [bake(tmp_path, ROOMS, radius, 0.1, **doors) for radius in (0.0, 0.2)]
    assert len(bakes[1].doors) == 1
    changed = [grid.with_doors(state) for grid in bakes]
    np.testing.assert_array_equal(changed[1].solid, changed[0].occupancy)
    assert same_free(changed[1].inflate(0.25), changed[0].inflate(0.25))
    baked = bake(tmp_path, ROOMS, 0.2, 0.1, doors={"patterns": ["door"], "state": state})
    np.testing.assert_array_equal(baked.solid, changed[1].solid)
    np.testing.assert_array_equal(baked.occupancy, changed[1].occupancy)
    again = navbake.load(dumps_navgrid(changed[1]))
    assert first_difference(again, changed[1]) is None
    assert same_free(again.with_doors("closed"), bakes[1].with_doors("closed"))


def test_blocks_are_laid_over_the_squares_too(tmp_path):
    content = box("floor", -2, -2, -0.1, 2, 2, 0) + box("", -0.3, -0.3, 0, 0.1, 0.2, 1)
    point, wide = (bake(tmp_path, content, radius) for radius in (0.0, 0.3))
    before = wide.solid.copy()
    shape = {"disc": ((1.0, 0.9, 0.0), 0.22)}
    with point.block(**shape), wide.block(**shape):
        np.testing.assert_array_equal(wide.solid, point.occupancy)
        assert same_free(wide.inflate(0.2), point.inflate(0.2))
        assert same_free(wide.inflate(0.4), point.inflate(0.4))
        assert same_free(
            wide.without_obstacles().inflate(0.2), bake(tmp_path, content, 0.2).inflate(0.2)
        )
    np.testing.assert_array_equal(wide.solid, before)


def test_clearance_and_sight_are_measured_from_the_squares(tmp_path):
    content = box("floor", -2, -2, -0.1, 2, 2, 0) + box("", -0.3, -0.3, 0, 0.1, 0.2, 1)
    layers = {"attributes": ["clearance"]}
    point, wide = (bake(tmp_path, content, radius, 0.1, **layers) for radius in (0.0, 0.3))
    shown = np.where(wide.free, point.attributes["clearance"], 0)
    np.testing.assert_array_equal(wide.attributes["clearance"], shown)
    finders = [navbake.PathFinder(grid) for grid in (point, wide)]
    place, other = (0.75, 0.05, 0.0), (-0.5, 1.05, 0.0)
    one, two = (finder.nearest_obstacle(place) for finder in finders)
    assert one.distance == two.distance == pytest.approx(0.65)
    assert finders[1].line_of_sight((0.15, -1, 0), (0.15, 1, 0))  # past the box, at 5 cm
    assert finders[1].line_of_sight(place, other) == finders[0].line_of_sight(place, other)


def test_a_file_without_the_layer_is_read_as_before(tmp_path):
    content = box("floor", -2, -2, -0.1, 2, 2, 0) + box("", -0.3, -0.3, 0, 0.1, 0.2, 1)
    grid = bake(tmp_path, content, 0.3)
    del grid.attributes["solid"]
    assert grid.solid is grid.occupancy
    inflated = grid.inflate(0.1)
    assert not (inflated.free & ~grid.free).any()
