"""What stands in each cell, against plain exact geometry; and under which names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from numpy.typing import NDArray

from bake_stages import Stages, run_stages, stages_of_xml
from navbake.bake.contents import Contents, LevelContents
from navbake.bake.walls import DOOR, OBJECT, STRUCTURE, WALL, WALL_BAND
from navbake.config import load_config, parse_config
from oracles.prisms import FREE, OCCUPIED, UNKNOWN, Prisms
from oracles.scene import HalfSpace, Thing, cross_part, part_meets_prisms, part_of, scene_xml

CONFIGS = Path(__file__).parents[2] / "configs"
HEIGHT, STEP = 1.14, 0.25  # of the default agent [m]
SMALL = {"min_area": 0.1, "shrink": 0.1}

CUBE = tuple((x, y, z) for x in (-0.3, 0.3) for y in (-0.2, 0.2) for z in (-0.25, 0.25))
CUBE_FACES = (
    (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
    (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
)  # fmt: skip


# ---------------------------------------------------------------- against exact geometry


def random_things(rng: np.random.Generator, kinds: tuple[str, ...], number: int) -> list[Thing]:
    """Things that lie, stand and hang about, half of them upright, in millimetres."""
    things = []
    for _ in range(number):
        kind = str(rng.choice(kinds))
        size = tuple(rng.integers(20, 500, 3) / 1000)
        num_sizes = {"sphere": 1, "cylinder": 2, "capsule": 2, "closed": 0, "open": 0, "hull": 0}
        pos = (*rng.integers(-1300, 1300, 2) / 1000, rng.integers(-200, 2200) / 1000)
        yaw = rng.uniform(0, np.pi)
        quat = np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])
        if rng.random() < 0.5:
            quat = rng.normal(size=4)
        mesh = {}
        if kind in ("closed", "open", "hull"):
            faces = {"closed": CUBE_FACES, "open": CUBE_FACES[:-2], "hull": ()}[kind]
            mesh = {"vertices": CUBE, "faces": faces}
        things.append(
            Thing(
                kind,
                tuple(map(float, size[: num_sizes.get(kind, 3)])),
                tuple(map(float, pos)),
                tuple(map(float, quat)),
                **mesh,
            )
        )
    return things


def masks(listed: LevelContents, geom: int) -> tuple[NDArray, NDArray, NDArray]:
    """The cells that a geom stands in, those it blocks, and those it meets in the upper band."""
    here = listed.geom == geom
    found = np.zeros((3, len(listed.start) - 1), dtype=bool)
    for mask, flag in zip(found, (listed.stands, listed.blocks, listed.upper), strict=True):
        mask[listed.cell[here & flag]] = True
    return tuple(found)


def compare(stages: Stages, contents: Contents, things: list[Thing]) -> float:
    """Compare each geom in each cell with a floor; returns the share that is too near to tell."""
    lattice, radius = stages.lattice, stages.config.agent.radius
    half = lattice.cell_size / 2
    unknown = total = 0
    tops = [level.ground for level in stages.floors.levels[1:]]
    tops.append(-np.inf if stages.scene.bounds is None else stages.scene.bounds[1, 2])
    for level, top, listed in zip(stages.floors.levels, tops, contents.levels, strict=True):
        cells = np.flatnonzero(~np.isnan(level.floor))
        floor = level.floor.ravel()[cells]
        x, y = lattice.positions(*np.divmod(cells, lattice.width)).T
        ceiling = np.maximum(floor + HEIGHT, top)
        column = Prisms(x, y, floor + 1e-5, ceiling, half, False)
        upper = Prisms(x, y, floor + WALL_BAND[0], floor + WALL_BAND[1], half, False)
        band = [Prisms(x, y, floor + STEP, floor + HEIGHT, half, False)]
        if radius > half:
            band.append(Prisms(x, y, floor + STEP, floor + HEIGHT, radius, True))
        for geom, thing in enumerate(things):
            part = part_of(thing)
            line = cross_part(part, x, y)
            stands = part_meets_prisms(part, line, column)
            met = np.stack([part_meets_prisms(part, line, prisms) for prisms in band])
            blocks = np.where((met == OCCUPIED).any(axis=0), OCCUPIED, met.min(axis=0))
            blocks[(met == UNKNOWN).any(axis=0) & (blocks != OCCUPIED)] = UNKNOWN
            in_upper = part_meets_prisms(part, line, upper)
            in_upper[(stands == FREE) | (in_upper == FREE)] = FREE
            in_upper[(stands == UNKNOWN) & (in_upper == OCCUPIED)] = UNKNOWN
            if isinstance(part, HalfSpace):  # is no wall, so it isn't asked for
                in_upper[:] = UNKNOWN
            for expected, found in zip(
                (stands, blocks, in_upper), masks(listed, geom), strict=True
            ):
                sure = expected != UNKNOWN
                wrong = cells[sure & ((expected == OCCUPIED) != found[cells])]
                assert not len(wrong), f"{thing}: {len(wrong)} cells, the first is {wrong[0]}"
                unknown += int((~sure).sum())
                total += len(cells)
    return unknown / total


def check_whole(stages: Stages, contents: Contents) -> None:
    """Entries are sorted, in cells with a floor only, and block exactly what is occupied."""
    for level, occupied, listed in zip(
        stages.floors.levels, stages.occupied, contents.levels, strict=True
    ):
        has_floor = ~np.isnan(level.floor.ravel())
        assert has_floor[listed.cell].all()
        assert (np.diff(listed.cell * 100_000 + listed.geom) > 0).all()
        assert (listed.stands | listed.blocks | listed.upper).all()
        blocked = np.zeros(len(has_floor), dtype=bool)
        blocked[listed.cell[listed.blocks]] = True
        np.testing.assert_array_equal(blocked[has_floor], occupied.ravel()[has_floor])


FLOORS = {
    "endless": Thing("plane", (), (0.0, 0.0, 0.0)),
    "sloping": Thing("plane", (), (0.0, 0.0, 0.0), (0.98, 0.12, 0.16, 0.0)),
    "slab": Thing("box", (1.4, 1.1, 0.1), (0.0, 0.0, -0.1)),
}


@pytest.mark.parametrize("radius", [0.05, 0.13, 0.3])
@pytest.mark.parametrize("floor", FLOORS)
@pytest.mark.parametrize(
    "kinds",
    [
        ("box", "cylinder", "sphere"),
        ("capsule", "ellipsoid", "box"),
        ("hull", "closed", "open", "cylinder"),
    ],
)
def test_every_geom_in_every_cell(tmp_path, monkeypatch, kinds, floor, radius):
    everything = lambda scene, extents: np.ones(len(scene.geoms), dtype=bool)  # noqa: E731
    monkeypatch.setattr("navbake.bake.contents.wall_candidates", everything)
    rng = np.random.default_rng([len(kinds), ord(floor[1]), round(radius * 100)])
    for _ in range(2):
        things = [FLOORS[floor], *random_things(rng, kinds, 7)]
        stages = stages_of_xml(
            tmp_path,
            scene_xml(things),
            scene={"geoms": "all"},
            agent={"radius": radius},
            grid={"cell_size": 0.13, "bounds": [-1.302, -1.003, 1.298, 1.004]},
            floors={"min_area": 0.1, "shrink": 0.1, "roofs": True},
        )
        contents = stages.contents()
        assert compare(stages, contents, things) < 0.01 + 1 / 3 / len(things)  # planes' uppers
        check_whole(stages, contents)


@pytest.mark.parametrize("name", ["apartment", "house", "warehouse", "terrain", "clutter"])
def test_what_blocks_is_what_occupies_the_samples(name):
    stages = run_stages(load_config(CONFIGS / f"{name}.yaml"))
    check_whole(stages, stages.contents())


def test_threads_change_nothing(tmp_path):
    rng = np.random.default_rng(5)
    things = [FLOORS["slab"], *random_things(rng, ("box", "capsule", "hull", "cylinder"), 20)]
    stages = stages_of_xml(tmp_path, scene_xml(things), grid={"cell_size": 0.04}, floors=SMALL)
    before = numba.get_num_threads()
    found = []
    for threads in (1, before):
        numba.set_num_threads(threads)
        found.append(stages.contents().levels)
    numba.set_num_threads(before)
    for one, other in zip(*found, strict=True):
        for name in ("start", "geom", "stands", "blocks", "upper"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_what_lies_at_the_floors_height_does_not_stand_there(tmp_path):
    xml = world(FLOOR + box("sunk", 0, 0, -0.2, 0.5, 0.5, 0.0) + box("on", 1, 1, 0, 1.3, 1.3, 0.3))
    stages = stages_of_xml(tmp_path, xml)
    contents = stages.contents()
    assert not masks(contents.levels[0], 1)[0].any()
    assert masks(contents.levels[0], 2)[0].sum() == 9


# ---------------------------------------------------------------- names


def world(content: str, assets: str = "") -> str:
    return f"<mujoco><asset>{assets}</asset><worldbody>{content}</worldbody></mujoco>"


def box(name: str, x0: float, y0: float, z0: float, x1: float, y1: float, z1: float) -> str:
    pos = f"{(x0 + x1) / 2} {(y0 + y1) / 2} {(z0 + z1) / 2}"
    size = f"{(x1 - x0) / 2} {(y1 - y0) / 2} {(z1 - z0) / 2}"
    named = f'name="{name}" ' if name else ""
    return f'<geom {named}type="box" pos="{pos}" size="{size}"/>'


def body(name: str, content: str, more: str = "") -> str:
    named = f'name="{name}"' if name else ""
    return f"<body {named} {more}>{content}</body>"


FLOOR = box("floor", -2, -2, -0.1, 2, 2, 0)


def user_data(stages: Stages, level: int = 0, doors: Any = None) -> dict[int, Any]:
    height, width = stages.lattice.shape
    return stages.contents(doors).user_data(level, (slice(0, height), slice(0, width)))


def at(stages: Stages, x: float, y: float, level: int = 0, doors: Any = None) -> Any:
    """The user data of the cell that holds a position."""
    row, col = stages.lattice.rows_cols([x, y])
    return user_data(stages, level, doors).get(int(row) * stages.lattice.width + int(col))


def test_names_are_those_of_the_topmost_body(tmp_path):
    things = body(
        "table",
        box("top", 0, 0, 0.7, 1, 1, 0.75)
        + body(
            "leg",
            box("leg_geom", 0, 0, 0, 0.1, 0.1, 0.7) + body("", box("", 0, 0, 0.75, 0.1, 0.1, 1)),
        ),
    )
    stages = stages_of_xml(tmp_path, world(FLOOR + things))
    assert at(stages, 0.05, 0.05) == {"objects": ["table"]}
    assert at(stages, 0.55, 0.55) == {"objects": ["table"]}
    assert at(stages, -0.5, -0.5) is None


def test_on_the_world_a_geom_has_its_own_name_and_without_one_its_number(tmp_path):
    things = (
        box("crate", 0, 0, 0, 0.5, 0.5, 0.5)
        + box("", -1, -1, 0, -0.5, -0.5, 0.5)
        + body("", box("inner", 1, 1, 0, 1.5, 1.5, 0.5))
    )
    stages = stages_of_xml(tmp_path, world(FLOOR + things))
    assert at(stages, 0.25, 0.25) == {"objects": ["crate"]}
    assert at(stages, -0.75, -0.75) == {"objects": ["geom 2"]}
    assert at(stages, 1.25, 1.25) == {"objects": ["body 1"]}


def test_several_names_are_sorted_and_unique(tmp_path):
    things = (
        body("zebra", box("z", 0, 0, 0, 1, 1, 0.3))
        + body("ähre", box("a", 0, 0, 0.3, 1, 1, 0.4) + box("b", 0, 0, 0.4, 1, 1, 0.5))
        + body("ant", box("c", 0, 0, 0.5, 1, 1, 0.6))
    )
    stages = stages_of_xml(tmp_path, world(FLOOR + things))
    assert at(stages, 0.5, 0.5) == {"objects": ["ant", "zebra", "ähre"]}


def test_one_name_for_a_geom_and_a_body_is_there_once(tmp_path):
    things = box("box", 0, 0, 0, 1, 1, 0.3) + body("box", box("other", 0, 0, 0.3, 1, 1, 0.6))
    stages = stages_of_xml(tmp_path, world(FLOOR + things))
    assert at(stages, 0.5, 0.5) == {"objects": ["box"]}


def test_blockers_are_named_where_not_all_that_stands_there_blocks(tmp_path):
    things = (
        body("lamp", box("shade", 0, 0, 1.8, 1.5, 0.5, 2))
        + body("table", box("top", 0, 0, 0.6, 1, 1, 0.7))
        + body("mat", box("rubber", 0, 0, 0, 0.5, 1, 0.1))
    )
    stages = stages_of_xml(tmp_path, world(FLOOR + things))
    assert at(stages, 0.75, 0.75) == {"objects": ["table"]}
    assert at(stages, 0.75, 0.25) == {"objects": ["lamp", "table"], "blockers": ["table"]}
    assert at(stages, 1.25, 0.25) == {"objects": ["lamp"]}
    assert at(stages, 0.25, 0.75) == {"objects": ["mat", "table"], "blockers": ["table"]}


def test_a_wide_agent_is_blocked_by_what_stands_beside_the_cell(tmp_path):
    stages = stages_of_xml(
        tmp_path, world(FLOOR + box("crate", 0, 0, 0, 0.5, 0.5, 0.5)), agent={"radius": 0.2}
    )
    assert at(stages, 0.25, 0.25) == {"objects": ["crate"]}
    assert at(stages, -0.15, 0.25) == {"blockers": ["crate"]}
    assert at(stages, -0.35, 0.25) is None


def test_things_that_carry_a_floor_are_named_and_floors_and_stairs_are_not(tmp_path):
    rug = body("rug", box("weave", -1.9, -1.9, 0, -1, -1, 0.01))
    toy = body("toy", box("block", -1.9, 0, 0, -1.6, 0.3, 0.2))
    steps = "".join(
        box(f"step {k}", 0.3 * k, -1.5, 0, 0.3 * k + 0.3, -0.5, 0.2 * k + 0.2) for k in range(4)
    )
    landing = box("landing", 1.2, -1.9, 0, 4, 1.9, 1.0)
    stages = stages_of_xml(tmp_path, world(FLOOR + rug + toy + steps + landing))
    kinds = dict(zip((r.name for r in stages.scene.geoms), stages.contents().kinds, strict=True))
    assert {name for name, kind in kinds.items() if kind == OBJECT} == {"weave", "block"}
    assert at(stages, -1.45, -1.45) == {"objects": ["rug"]}
    assert at(stages, -1.75, 0.15) == {"objects": ["toy"]}
    assert at(stages, 0.15, -1.05) is None
    assert at(stages, 0.5, 0.5) is None


def test_stairs_block_under_their_names_only(tmp_path):
    steps = body(
        "stair",
        "".join(box("", 0.3 * k, -1.5, 0, 0.3 * k + 0.3, -0.5, 0.2 * k + 0.2) for k in range(5)),
    )
    landing = box("landing", 1.5, -1.9, 0, 4, 1.9, 1.2)
    stages = stages_of_xml(tmp_path, world(FLOOR + steps + landing), agent={"radius": 0.4})
    assert at(stages, 0.25, -1.05) == {"blockers": ["stair"]}
    assert at(stages, 1.35, 0.0) == {"blockers": ["landing"]}
    assert {key for data in user_data(stages).values() for key in data} == {"blockers"}


def test_a_large_rug_and_floors_on_a_ground_plane_are_not_named(tmp_path):
    plane = '<geom name="ground" type="plane" size="0 0 1" pos="0 0 -0.05"/>'
    rug = body("rug", box("weave", -1.5, -1.5, 0, 1.5, 1.5, 0.01))
    tiles = "".join(
        box(f"tile {i}{j}", i, j, -0.1, i + 1, j + 1, 0) for i in range(-2, 2) for j in range(-2, 2)
    )
    for floor in (FLOOR, tiles):
        stages = stages_of_xml(tmp_path, world(plane + floor + rug))
        assert user_data(stages) == {}


def test_ceilings_and_roofs_are_not_named_but_what_hangs_from_them_is(tmp_path):
    roof = box("roof", -2, -2, 2.5, 2, 2, 2.7) + body("fan", box("blade", 0, 0, 2.2, 1, 0.2, 2.25))
    stages = stages_of_xml(tmp_path, world(FLOOR + roof))
    assert at(stages, 0.5, 0.1) == {"objects": ["fan"]}
    assert at(stages, -0.5, -0.5) is None


def test_each_level_names_its_own(tmp_path):
    upper = box("slab", -2, -2, 2.7, 2, 2, 3.0)
    things = body("low", box("a", 0, 0, 0, 1, 1, 1)) + body("high", box("b", 0, 0, 3, 1, 1, 4))
    stages = stages_of_xml(tmp_path, world(FLOOR + upper + things), floors={"roofs": True})
    assert len(stages.floors.levels) == 2
    assert at(stages, 0.5, 0.5) == {"objects": ["low"]}
    assert at(stages, 0.5, 0.5, level=1) == {"objects": ["high"]}


def test_doors_are_objects_too(tmp_path):
    leaf = body("door", '<joint type="hinge"/>' + box("leaf", 0, 0, 0, 1, 0.05, 2))
    stages = stages_of_xml(tmp_path, world(FLOOR + leaf))
    doors = np.array([False, True])
    assert at(stages, 0.5, 0.025, doors=doors) == {"doors": ["door"], "objects": ["door"]}
    assert stages.contents(doors).kinds.tolist() == [STRUCTURE, DOOR]


def test_a_window_counts_cells_from_its_own_corner(tmp_path):
    stages = stages_of_xml(tmp_path, world(FLOOR + box("crate", 0, 0, 0, 0.3, 0.2, 0.5)))
    contents = stages.contents()
    whole = contents.user_data(0, (slice(0, 40), slice(0, 40)))
    part = contents.user_data(0, (slice(18, 30), slice(21, 25)))
    expected = {
        (cell // 40 - 18) * 4 + cell % 40 - 21: data
        for cell, data in whole.items()
        if 18 <= cell // 40 < 30 and 21 <= cell % 40 < 25
    }
    assert part == expected
    assert len(part) == 4
    assert list(part) == sorted(part)


def test_an_empty_level_has_no_user_data(tmp_path):
    stages = stages_of_xml(tmp_path, world(FLOOR))
    assert user_data(stages) == {}
    assert not stages.contents().wall_cells(0).any()


def test_the_map_of_a_room(tmp_path):
    walls = box("south wall", -1, -1, 0, 1, -0.8, 2.5) + box("west wall", -1, -0.8, 0, -0.8, 1, 2.5)
    things = body("bed", box("mattress", 0, 0, 0, 0.6, 0.6, 0.5)) + body(
        "lamp", box("shade", 0.4, 0.4, 1.8, 0.8, 0.8, 2)
    )
    floor = box("floor", -1, -1, -0.1, 1, 1, 0)
    stages = stages_of_xml(
        tmp_path, world(floor + walls + things), grid={"cell_size": 0.2}, floors=SMALL
    )
    contents = stages.contents()
    data = user_data(stages)
    picture = "\n".join(
        "".join(
            "".join(sorted(name[0] for key in ("objects", "walls") for name in cell.get(key, [])))
            or "."
            for cell in (data.get(row * 10 + col, {}) for col in range(10))
        )
        for row in range(10)
    )
    assert picture.replace("bl", "2") == (
        "w.........\n"
        "w......ll.\n"
        "w....bb2l.\n"
        "w....bbb..\n"
        "w....bbb..\n"
        "w.........\n"
        "w.........\n"
        "w.........\n"
        "w.........\n"
        "ssssssssss"
    )
    expected = np.zeros((10, 10), dtype=bool)
    expected[:, 0] = expected[9] = True
    np.testing.assert_array_equal(contents.wall_cells(0), expected)
    assert [contents.kinds[k] for k in (1, 2)] == [WALL, WALL]


def test_names_can_be_switched_off(tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(world(FLOOR + box("crate", 0, 0, 0, 1, 1, 1)))
    from navbake.bake.pipeline import run_bake

    for names, expected in ((True, 100), (False, 0), ({"enabled": False}, 0)):
        grid = run_bake(parse_config({"scene": {"path": path}, "names": names})).grid
        assert len(grid.levels[0].user_data) == expected
