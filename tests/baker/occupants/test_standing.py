"""What stands in each cell, against plain exact geometry."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from box_worlds import FLOOR, box, stages_of_xml, world
from navbake.baker.bake.stages import Stages, bake_stages
from navbake.baker.occupancy.occupancy import WALL_HEIGHTS, select_list_entries
from navbake.baker.occupancy.volume_kernels import AT_WALL_HEIGHT, BLOCKING, OCCUPYING
from navbake.baker.occupants.occupant_kernels import LevelOccupants
from navbake.baker.occupants.standing import StandingOccupants
from navbake.config.settings import load_config
from navbake.threads import limit_threads
from oracles.prisms import FREE, OCCUPIED, UNKNOWN, Prisms
from oracles.scene import HalfSpace, Thing, cross_part, part_meets_prisms, part_of, scene_xml
from project_paths import CONFIGS

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


def all_entries(listed: LevelOccupants) -> tuple[NDArray, NDArray, NDArray]:
    """The cell, the geom and the flags of each entry of a level."""
    return select_list_entries(
        listed.list_start, listed.geom, listed.flags, np.arange(len(listed.list_start))
    )


def masks(listed: LevelOccupants, geom: int) -> tuple[NDArray, NDArray, NDArray]:
    """The cells that a geom stands in, those it blocks, and those it meets in the upper band."""
    cell, geoms, flags = all_entries(listed)
    found = np.zeros((3, len(listed.list_start)), dtype=bool)
    for mask, flag in zip(found, (OCCUPYING, BLOCKING, AT_WALL_HEIGHT), strict=True):
        mask[cell[(geoms == geom) & (flags & flag > 0)]] = True
    return tuple(found)


def compare(stages: Stages, contents: StandingOccupants, things: list[Thing]) -> float:
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
        upper = Prisms(x, y, floor + WALL_HEIGHTS[0], floor + WALL_HEIGHTS[1], half, False)
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


def check_whole(stages: Stages, contents: StandingOccupants) -> None:
    """Entries are sorted, in cells with a floor only, and block exactly what is occupied."""
    for level, occupied, listed in zip(
        stages.floors.levels, stages.occupancy.levels, contents.levels, strict=True
    ):
        has_floor = ~np.isnan(level.floor.ravel())
        cell, geom, flags = all_entries(listed)
        assert has_floor[cell].all()
        assert (np.diff(cell * 100_000 + geom) > 0).all()
        assert flags.all()
        blocked = np.zeros(len(has_floor), dtype=bool)
        blocked[cell[flags & BLOCKING > 0]] = True
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
    monkeypatch.setattr("navbake.baker.bake.stages.mark_wall_candidates", everything)
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
        contents = stages.standing_occupants
        assert compare(stages, contents, things) < 0.01 + 1 / 3 / len(things)  # planes' uppers
        check_whole(stages, contents)


@pytest.mark.parametrize("name", ["apartment", "house", "warehouse", "terrain", "clutter"])
def test_what_blocks_is_what_occupies_the_samples(name):
    stages = bake_stages(load_config(CONFIGS / f"{name}.yaml"))
    check_whole(stages, stages.standing_occupants)


def test_threads_change_nothing(tmp_path):
    rng = np.random.default_rng(5)
    things = [FLOORS["slab"], *random_things(rng, ("box", "capsule", "hull", "cylinder"), 20)]
    found = []
    for threads in (1, None):
        with limit_threads(threads):
            stages = stages_of_xml(
                tmp_path, scene_xml(things), grid={"cell_size": 0.04}, floors=SMALL
            )
        found.append(stages.standing_occupants.levels)
    for one, other in zip(*found, strict=True):
        for arrays in zip(all_entries(one), all_entries(other), strict=True):
            np.testing.assert_array_equal(*arrays)


def test_what_lies_at_the_floors_height_does_not_stand_there(tmp_path):
    xml = world(FLOOR + box("sunk", 0, 0, -0.2, 0.5, 0.5, 0.0) + box("on", 1, 1, 0, 1.3, 1.3, 0.3))
    stages = stages_of_xml(tmp_path, xml)
    contents = stages.standing_occupants
    assert not masks(contents.levels[0], 1)[0].any()
    assert masks(contents.levels[0], 2)[0].sum() == 9
