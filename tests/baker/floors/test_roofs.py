"""Which regions over a floor are storeys, which are roofs, and which are shelves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navbake.baker.bake.pipeline import BakeResult, run_bake
from navbake.config.settings import parse_config


def box(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float, more: str = "") -> str:
    pos = f"{(x0 + x1) / 2} {(y0 + y1) / 2} {(z0 + z1) / 2}"
    size = f"{(x1 - x0) / 2} {(y1 - y0) / 2} {(z1 - z0) / 2}"
    return f'<geom type="box" pos="{pos}" size="{size}" {more}/>'


def ring(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float, t: float = 0.1) -> list:
    """Four walls of thickness t along the inside of a rectangle."""
    return [
        box(x0, x1, y0, y0 + t, z0, z1),
        box(x0, x1, y1 - t, y1, z0, z1),
        box(x0, x0 + t, y0 + t, y1 - t, z0, z1),
        box(x1 - t, x1, y0 + t, y1 - t, z0, z1),
    ]


def posts(x0: float, x1: float, y0: float, y1: float, z0: float, z1: float) -> list[str]:
    return [box(x, x + 0.1, y, y + 0.1, z0, z1) for x in (x0, x1 - 0.1) for y in (y0, y1 - 0.1)]


YARD = box(-6, 16, -6, 14, -0.2, 0)
SLAB = box(0, 10, 0, 8, 2.6, 2.8)  # over a house of 10 x 8 m


def rack(x0: float, z: float, depth: float = 1.1) -> list[str]:
    """Three shelves 8 m long, the lowest at a height, and posts."""
    shelves = [box(x0, x0 + depth, 0, 8, z + h, z + h + 0.1) for h in (0.6, 2.0, 3.4)]
    return [*shelves, *posts(x0, x0 + depth, 0, 8, z, z + 3.4)]


@pytest.fixture
def bake(tmp_path: Path):
    def run(geoms: list[str], **settings: object) -> BakeResult:
        path = tmp_path / "scene.xml"
        path.write_text(f"<mujoco><worldbody>{''.join(geoms)}</worldbody></mujoco>")
        return run_bake(parse_config({"scene": {"path": str(path)}, **settings}))

    return run


def grounds(result: BakeResult) -> list[float]:
    return [round(level.ground, 6) for level in result.grid.levels]


def house_with_gate(gate: float) -> list[str]:
    sides = [box(0, 10, 0, 0.1, 0, 2.6), box(0, 10, 7.9, 8, 0, 2.6), box(0, 0.1, 0.1, 7.9, 0, 2.6)]
    front = [box(9.9, 10, 0.1, 1, 0, 2.6), box(9.9, 10, 1 + gate, 7.9, 0, 2.6)]
    return [YARD, *sides, *front]


GABLE = (
    '<geom type="box" pos="5 2 4.2" size="5.3 2.6 .05" euler="35 0 0"/>',
    '<geom type="box" pos="5 6 4.2" size="5.3 2.6 .05" euler="-35 0 0"/>',
)
CROWN = '<geom type="ellipsoid" pos="3 3 4" size="3 3 1"/>'

ROOFS = {
    "garage with a gate of 1.2 m": [*house_with_gate(1.2), SLAB],
    "garage with a gate of 3 m": [*house_with_gate(3.0), SLAB],
    "garage without a front": [*house_with_gate(6.8), SLAB],
    "carport": [YARD, *posts(0, 10, 0, 8, 0, 2.6), SLAB],
    "parapet": [*house_with_gate(1.2), SLAB, *ring(0, 10, 0, 8, 2.8, 3.8)],
    "gable": [*house_with_gate(1.2), *GABLE],
    "two heights": [
        *house_with_gate(1.2),
        *[box(0, 5, 0, 8, 2.6, 2.8), box(5, 10, 0, 8, 2.6, 4.8), box(4.6, 10, 0, 8, 4.8, 5)],
    ],
    "carport under eaves": [
        *[YARD, *ring(0, 10, 0, 8, 0, 3.9), box(-0.5, 10.5, -0.5, 8.5, 3.9, 4.1)],
        *[*posts(10, 13, 0, 5, 0, 2.3), box(10, 13, 0, 5, 2.3, 2.4)],
    ],
    "tree": [YARD, '<geom type="cylinder" pos="3 3 1.5" size=".2 1.5"/>', CROWN],
    "parasol": [
        YARD,
        '<geom type="cylinder" pos="3 3 1.2" size=".05 1.2"/>'
        '<geom type="cylinder" pos="3 3 2.42" size="1.5 .02"/>',
    ],
    "what stands on a roof": [
        *[*house_with_gate(1.2), SLAB],
        *[box(x, x + 1.5, y, y + 1.5, 2.8, 4.5) for x in (1, 4, 7) for y in (1, 3, 5)],
    ],
    "parapet of 1.2 m": [*house_with_gate(1.2), SLAB, *ring(0, 10, 0, 8, 2.8, 4.0)],
    "hall full of blocks": [
        *[YARD, *ring(0, 10, 0, 8, 0, 4), box(0, 10, 0, 8, 4, 4.2)],
        *[box(x, x + 1.8, 0.6, 7.4, 0, 2.5) for x in (0.6, 2.9, 5.2, 7.5)],
    ],
    "thick walls and eaves without ground around": [
        *[box(0, 10, 0, 6, -0.2, 0), *ring(0, 10, 0, 6, 0, 2.6, t=1.2)],
        box(-0.4, 10.4, -0.4, 6.4, 2.599, 2.8),
    ],
    "carport that goes on over wall tops": [
        *[YARD, *ring(0, 10, 0, 8, 0, 2.7, t=0.75), *posts(10, 14, 0, 8, 0, 2.5)],
        *[box(10, 14, 0, 8, 2.5, 2.6), box(-0.3, 10, -0.3, 8.3, 4.2, 4.4)],
    ],
    "canopy along a wall": [YARD, box(0, 10, 0, 8, 0, 5), box(1, 9, -1.6, 0, 2.6, 2.7)],
}


@pytest.mark.parametrize("name", ROOFS)
def test_roof_is_no_level(bake, name):
    result = bake(ROOFS[name])
    assert grounds(result) == [0]
    assert not any("no step leads to 'level" in warning for warning in result.warnings)


@pytest.mark.parametrize("name", [name for name in ROOFS if "canopy" not in name])
def test_roofs_are_levels_when_asked_for(bake, name):
    assert len(grounds(bake(ROOFS[name], floors={"roofs": True}))) > 1


LOWER = [YARD, *ring(0, 10, 0, 8, 0, 2.6), SLAB]
THIN = ring(0, 10, 0, 8, 2.8, 5.4, t=0.02)  # no cell's centre lies in them
STOREYS = {
    "without its ceiling": [*LOWER, *ring(0, 10, 0, 8, 2.8, 5.4)],
    "without its ceiling, of thin walls": [*LOWER, *THIN],
    "without its ceiling, open to one side": [*LOWER, *ring(0, 10, 0, 8, 2.8, 5.4)[:3]],
    "without its ceiling, thin walls inside of its rim": [
        *[YARD, *ring(0, 10, 0, 8, 0, 2.6), box(-0.25, 10.25, -0.25, 8.25, 2.6, 2.8), *THIN],
    ],
    "without walls, under a roof": [
        *LOWER,
        *posts(0, 10, 0, 8, 2.8, 5.4),
        box(0, 10, 0, 8, 5.4, 5.6),
    ],
    "slab of a tower": [
        *[YARD, *posts(0, 10, 0, 8, 0, 5.4), SLAB, box(0, 10, 0, 8, 5.4, 5.6)],
    ],
    "mezzanine in a hall": [
        *[YARD, *ring(0, 10, 0, 8, 0, 6), box(0, 10, 0, 8, 6, 6.2), box(6, 9, 2, 7, 2.6, 2.8)],
    ],
    "gallery in a hall": [
        *[YARD, *ring(0, 10, 0, 8, 0, 6), box(0, 10, 0, 8, 6, 6.2), box(0, 2, 0, 8, 2.6, 2.8)],
    ],
    "attic": [
        *[YARD, *ring(0, 10, 0, 8, 0, 2.6), SLAB],
        '<geom type="box" pos="5 2 3.9" size="5.3 2.6 .05" euler="25 0 0"/>',
        '<geom type="box" pos="5 6 3.9" size="5.3 2.6 .05" euler="-25 0 0"/>',
    ],
}


@pytest.mark.parametrize("name", STOREYS)
def test_storey_without_stairs_is_a_level_and_is_told_of(bake, name):
    result = bake(STOREYS[name])
    assert grounds(result) == [0, 2.8]
    texts = [text for text in result.warnings if "of the floor" not in text]  # of the yard
    [warning] = [text for text in texts if "of 'level 0'" not in text]
    assert "no step leads to 'level 1'" in warning and "2.80 m" in warning


def test_racks_are_furniture_outdoors_and_under_a_ceiling(bake):
    yard = bake([YARD, *rack(0, 0), *rack(4, 0, depth=2.2)])
    assert grounds(yard) == [0]
    hall = [YARD, *ring(-2, 12, -2, 10, 0, 6), box(-2, 12, -2, 10, 6, 6.2)]
    storey = [*ring(-2, 12, -2, 10, 6.2, 9), box(-2, 12, -2, 10, 9, 9.2)]
    result = bake([*hall, *storey, *rack(0, 0), *rack(4, 0, depth=2.2)])
    assert grounds(result) == [0, 6.2]
    assert any("not a floor, because it is higher than a step" in text for text in result.warnings)
    assert len(grounds(bake([*hall, *rack(0, 0)], floors={"tops": True}))) > 1


@pytest.mark.parametrize("depth", [0.12, 0.3, 0.5])
def test_shelf_is_furniture_with_a_rail_under_its_edge(bake, depth):
    """Neither the rail nor a lamp below the edge is in the way of what falls off the shelf."""
    hall = [YARD, *ring(-2, 12, -2, 10, 0, 6), box(-2, 12, -2, 10, 6, 6.2)]
    rails = [box(1, 9, y, y + depth, 1.45, 1.55) for y in (3 - depth, 4.2)]
    assert grounds(bake([*hall, box(1, 9, 3, 4.2, 1.9, 2), *rails])) == [0]


def test_given_levels_leave_roofs_out(bake):
    """A roof is a level only where it is all that there is on a level that is given."""
    scene = [*LOWER, *ring(0, 10, 0, 8, 2.8, 5.4), box(0, 10, 0, 8, 5.4, 5.6)]
    levels = [{"ground": 0}, {"ground": 2.8}]
    assert grounds(bake(scene, levels=levels)) == [0, 2.8]
    assert grounds(bake(scene, levels=[*levels, {"ground": 5.6}])) == [0, 2.8, 5.6]
    assert grounds(bake(scene, levels=levels, floors={"roofs": True})) == [0, 2.8, 5.6]


def test_what_was_dropped_is_no_floor_beyond_a_wall(bake):
    """The roof of a carport is a step lower than the storey behind the wall."""
    carport = [*posts(10, 13, 0, 5, 0, 2.5), box(10, 13, 0, 5, 2.5, 2.6)]
    storey = [*ring(0, 10, 0, 8, 2.8, 5.4, t=0.3), box(0, 10, 0, 8, 5.4, 5.6)]
    result = bake([*LOWER, *storey, *carport])
    upper = result.grid.levels[1]
    assert upper.ground == pytest.approx(2.8)
    row, col = upper.lattice.rows_cols([11.5, 2.5])
    inside = 0 <= row < upper.height and 0 <= col < upper.width
    assert not inside or not upper.free[row, col]


def test_floor_does_not_go_on_within_a_dropped_roof(bake):
    """The garage's walls end a millimetre inside of its roof, a step below the storey's floor."""
    garage = [*ring(10, 14, 0, 5, 0, 2.561), box(10, 14, 0, 5, 2.56, 2.7)]
    storey = [*ring(0, 10, 0, 8, 2.8, 5.4), box(0, 10, 0, 8, 5.4, 5.6)]
    upper = bake([*LOWER, *storey, *garage]).grid.levels[1]
    assert upper.ground == pytest.approx(2.8)
    _, col = upper.lattice.rows_cols([10.0, 2.5])
    assert not upper.free[:, int(col) + 1 :].any()


def test_storey_without_ceiling_is_one_where_the_grid_crops_its_walls(bake):
    """Beyond bounds that cut through the scene, nothing is known of walls."""
    scene = [*LOWER, *ring(0, 10, 0, 8, 2.8, 5.4)]
    assert grounds(bake(scene, grid={"bounds": [1, 1, 9, 7]})) == [0, 2.8]


def test_shelf_is_furniture_where_the_grid_crops_it(bake):
    shelf = [YARD, box(0, 10, 0, 8, 5, 5.2), box(1, 9, 3, 4.2, 1.9, 2)]
    for bounds in ([-2, 3.6, 12, 8], [3, -1, 5, 9]):
        assert grounds(bake(shelf, grid={"bounds": bounds})) == [0]


def test_large_roof_is_told_of_and_can_be_kept(bake):
    """A square over a garage that is smaller."""
    square = box(-6, 16, -6, 14, -0.2, 0)
    garage = [box(-5, 13, -5, 9, -3.2, -3), *ring(-5, 13, -5, 9, -3, -0.2)]
    result = bake([*garage, square])
    assert grounds(result) == [-3]
    [warning] = [text for text in result.warnings if "the roof" in text]
    assert "open to the sky" in warning and "440.0 m² at 0.00 m" in warning
    place = [float(word) for word in warning.split("[[")[1].split("]]")[0].split(",")]
    assert grounds(bake([*garage, square], floors={"from": [place]})) == [-3, 0]


def test_large_roof_on_no_walls_is_told_of(bake):
    """It is no larger than the floor under it."""
    for size, num_warnings in ((7.2, 1), (6.8, 0)):
        result = bake([box(0, 9, 0, 9, -0.2, 0), box(0, size, 0, size, 2.8, 3)])
        assert grounds(result) == [0]
        assert sum("the roof" in text for text in result.warnings) == num_warnings


@pytest.mark.parametrize(("size", "eaves"), [(8, 1.5), (3, 0.9), (3, 1.5)])
@pytest.mark.parametrize("slope", [0, 20, 35])
def test_wide_eaves_without_ground_are_no_level(bake, size, eaves, slope):
    """Most of the roof lies over nothing."""
    house = [*ring(0, size, 0, 6, 0, 2.6), box(0, size, 0, 6, -0.2, 0)]
    half = (3 + eaves) / 2
    tan = np.tan(np.radians(slope))
    along = half / np.cos(np.radians(slope))
    for side in (-1, 1):
        pos = f"{size / 2} {3 + side * half} {2.65 + tan * (3 - half)}"
        turn = f"{size / 2 + eaves} {along} .05' euler='{-side * slope} 0 0'".replace("'", '"')
        house.append(f'<geom type="box" pos="{pos}" size="{turn}/>')
    assert grounds(bake(house)) == [0]


def test_roof_of_a_house_is_not_told_of(bake):
    house = [
        *ring(0, 10, 0, 8, 0, 2.6),
        box(0, 10, 0, 8, -0.2, 0),
        box(-0.3, 10.3, -0.3, 8.3, 2.6, 3),
    ]
    assert bake(house).warnings == []
