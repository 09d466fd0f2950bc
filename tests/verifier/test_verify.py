"""Verification of grids: it agrees with true ones, and names each fault that is planted."""

from __future__ import annotations

import json

import numpy as np
import pytest

import navbake
from box_worlds import body, box, world
from door_scenes import LEAF, ROOMS
from door_scenes import world as door_world
from navbake.errors import ConfigError, QueryError
from navbake.navgrid.grid import MultiLevelGrid
from navbake.testing import assert_true
from navbake.verifier import report as kinds
from navbake.verifier.probes import TOUCHES, Probe

ROOM = "".join(
    (
        box("floor", -2, -2, -0.1, 2, 2, 0),
        box("wall", -2, 1.9, 0, 2, 2, 2.5),
        box("table", 0.3, -0.5, 0.6, 1.3, 0.2, 0.7),
        '<geom name="ball" type="sphere" size="0.4" pos="-0.9 -0.8 0.4"/>',
        '<geom name="log" type="capsule" size="0.15 0.5" pos="-0.6 0.8 0.3" euler="0 80 25"/>',
        '<geom name="egg" type="ellipsoid" size="0.2 0.3 0.5" pos="1.2 -1.3 0.4"/>',
        '<geom name="drum" type="cylinder" size="0.25 0.4" pos="1 1.2 0.4" euler="20 0 0"/>',
    )
)


def stairs_house() -> str:
    """Two storeys of 5 x 4 m, with a stair of 16 treads of 0.17 m from one to the other."""
    parts = [box("ground floor", 0, 0, -0.2, 5, 4, 0)]
    parts += [box(f"wall {k}", *sides) for k, sides in enumerate(walls(0.0))]
    for k in range(15):
        x = 0.3 + 0.28 * k
        parts.append(box(f"tread {k}", x, 0.1, 0.0, x + 0.28, 1.1, 0.17 * (k + 1)))
    parts.append(box("upper floor", 0, 1.1, 2.52, 5, 4, 2.72))
    parts.append(box("landing", 4.5, 0.1, 2.52, 5, 1.1, 2.72))
    parts += [box(f"upper wall {k}", *sides) for k, sides in enumerate(walls(2.72))]
    return "".join(parts)


def walls(z: float) -> list[tuple[float, ...]]:
    return [
        (-0.1, -0.1, z, 5.1, 0, z + 2.5),
        (-0.1, 4, z, 5.1, 4.1, z + 2.5),
        (-0.1, 0, z, 0, 4, z + 2.5),
        (5, 0, z, 5.1, 4, z + 2.5),
    ]


def write(folder, content: str, name: str = "scene.xml"):
    path = folder / name
    path.write_text(content, encoding="utf-8")
    return path


def of_room(folder, **settings):
    path = write(folder, world(ROOM).replace("<mujoco>", '<mujoco><compiler angle="degree"/>'))
    config = {"scene": {"path": str(path)}, **settings}
    return navbake.bake(config), config


@pytest.fixture(scope="module")
def house(tmp_path_factory):
    folder = tmp_path_factory.mktemp("house")
    config = {"scene": {"path": str(write(folder, world(stairs_house())))}}
    grid = navbake.bake(config)
    assert len(grid.levels) == 2
    return grid, config


def copy_of(grid):
    """A grid that can be changed without changing the other."""
    levels = [
        level.with_layers(
            weights=level.weights.copy(),
            attributes={name: array.copy() for name, array in level.attributes.items()},
        )
        for level in grid.levels
    ]
    return grid.with_levels(levels)


def kinds_at(report):
    return {(found.kind, found.level, found.cell) for found in report.findings}


# ---------------------------------------------------------------- what is true


@pytest.mark.parametrize("agent", [{}, {"radius": 0.2}, {"radius": 0.3, "height": 0.5}])
def test_agrees_with_a_room_of_all_solids(tmp_path, agent):
    grid, config = of_room(tmp_path, agent=agent)
    report = assert_true(grid, config)
    assert report.checked == grid.width * grid.height
    counts = report.levels[0]
    assert counts.free_free == int(grid.free.sum())
    assert counts.free_free + counts.blocked_blocked == report.checked
    assert counts.floors == int((~np.isnan(grid.floor_height)).sum())
    assert counts.disputed == 0


def test_agrees_with_stairs_and_with_paths_on_them(house):
    grid, config = house
    report = assert_true(grid, config, paths=5)
    assert report.sweeps.paths == 5 and report.sweeps.length > 5
    assert report.total.cells == sum(level.width * level.height for level in grid.levels)


@pytest.mark.parametrize("radius", [0.1, 0.25])
def test_agrees_with_inflated_grids(tmp_path, house, radius):
    for grid, config in (of_room(tmp_path), house):
        inflated = grid.inflate(radius)
        report = assert_true(inflated, config, paths=3)
        assert report.radius == radius == report.sweeps.radius
        # so does what is inflated for it
        again = assert_true(grid, config, radius=radius)
        assert again.levels == report.levels


@pytest.mark.parametrize("state", ["modelled", "open", "closed", "removed"])
def test_doors_stand_as_the_grid_says(tmp_path, state):
    path = write(tmp_path, door_world(ROOMS, LEAF))
    grid = navbake.bake({"scene": {"path": str(path)}})
    assert len(grid.doors) == 1
    turned = grid.with_doors(state)
    assert_true(turned, path)
    if state in ("open", "removed"):
        # the grid with the closed door isn't true of the open one
        metadata = turned.metadata
        wrong = grid.with_layers(metadata=metadata)
        found = navbake.verify(wrong, path)
        assert {kinds.BLOCKED_APART} <= {f.kind for f in found.findings}


def test_meshes_count_as_they_are_baked(tmp_path):
    """A hollow box is solid, the same without its lid is none; and a mesh file is a scene."""
    corners = [(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)]
    faces = [(0, 2, 3), (0, 3, 1), (0, 1, 5), (0, 5, 4), (1, 3, 7), (1, 7, 5)]
    faces += [(3, 2, 6), (3, 6, 7), (2, 0, 4), (2, 4, 6), (4, 5, 7), (4, 7, 6)]
    lines = [f"v {4 * x - 2} {4 * y - 2} {-0.1 * (1 - z)}" for x, y, z in corners]
    lines += [f"v {0.9 * x + 0.2} {0.8 * y - 1.3} {1.5 * z + 0.01}" for x, y, z in corners]
    lines += [f"v {0.7 * x - 1.5} {0.9 * y + 0.3} {1.2 * z + 0.01}" for x, y, z in corners]
    text = "\n".join(lines)
    for number, kept in ((0, faces), (8, faces), (16, faces[:-2])):
        text += f"\no part_{number}\n"
        text += "\n".join(
            f"f {a + number + 1} {b + number + 1} {c + number + 1}" for a, b, c in kept
        )
    path = write(tmp_path, text, "room.obj")
    grid = navbake.bake({"scene": {"path": str(path)}})
    report = assert_true(grid, path)
    assert any("by the surface" in note for note in report.notes)
    # inside of the closed part, the floor is blocked, though no surface is near
    row, col = (int(v) for v in grid.lattice.rows_cols([0.65, -0.9]))
    assert grid.occupancy[row, col]
    wrong = copy_of(grid)
    wrong.levels[0].weights[row, col] = 1.0
    assert (kinds.FREE_TOUCHES, 0, (row, col)) in kinds_at(navbake.verify(wrong, path, force=True))


def test_part_of_a_scene_and_movable_bodies(tmp_path):
    cart = body("cart", '<freejoint/><geom type="box" size="0.2 0.2 0.4" pos="0 0 0.5"/>')
    path = write(tmp_path, world(ROOM + cart))
    config = {
        "scene": {"path": str(path), "exclude": {"movable": True, "geoms": ["ball"]}},
        "grid": {"bounds": [-1.5, -1.5, 0.6, 1.2]},
    }
    grid = navbake.bake(config)
    assert_true(grid, config)
    # the grid states what was left out, so the scene's file alone will do
    assert_true(grid, path)
    assert not navbake.verify(grid, {"scene": {"path": str(path)}}).ok


# ---------------------------------------------------------------- planted faults


def test_names_cells_that_were_flipped(tmp_path):
    grid, config = of_room(tmp_path)
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


def test_names_a_floor_that_moved(tmp_path):
    grid, config = of_room(tmp_path)
    wrong = copy_of(grid)
    row, col = np.argwhere(grid.free)[50].tolist()
    wrong.levels[0].attributes["floorHeight"][row, col] += np.float32(0.02)
    (found,) = navbake.verify(wrong, config).findings
    assert (found.kind, found.cell) == (kinds.FLOOR_OFF, (row, col))
    assert found.size == pytest.approx(0.02, abs=1e-6) and "0.0200 m off" in found.text


def test_names_a_floor_that_is_missing(tmp_path):
    grid, config = of_room(tmp_path)
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


def test_names_paths_that_touch(tmp_path):
    grid, config = of_room(tmp_path)
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


@pytest.mark.parametrize("seed", range(3))
def test_paths_through_corners_of_cells_and_over_links(house, seed):
    """A line through a corner is in none of the cells beside, and a step up has no length."""
    grid, config = house
    report = navbake.verify(grid, config, sample=1, radius=0.1, paths=20, seed=seed)
    assert report.ok and report.sweeps.paths == 20


def test_names_an_inflation_that_closed_too_much(tmp_path):
    grid, config = of_room(tmp_path)
    wrong = grid.inflate(0.2)
    row, col = np.argwhere(grid.inflate(0.3).free[10:, 10:])[0].tolist()
    row, col = row + 10, col + 10
    wrong.levels[0].weights[row, col] = np.inf
    assert kinds_at(navbake.verify(wrong, config)) == {(kinds.BLOCKED_APART, 0, (row, col))}


# ---------------------------------------------------------------- samples, reports


def test_a_sample_is_drawn_by_its_seed(tmp_path):
    grid, config = of_room(tmp_path)
    one, same, other = (navbake.verify(grid, config, sample=100, seed=s) for s in (1, 1, 2))
    assert one.checked == 100 and one.to_json() == same.to_json() and one.digest == same.digest
    assert one.digest != other.digest
    assert json.loads(json.dumps(one.to_json(), allow_nan=False))["ok"] is True


def test_assert_true_says_where(tmp_path):
    grid, config = of_room(tmp_path)
    wrong = copy_of(grid)
    wrong.levels[0].weights[grid.occupancy == 1] = 1.0
    with pytest.raises(AssertionError, match=r"(?s)free cell touches, level 0, .*and \d+ more"):
        assert_true(wrong, config)


def test_what_is_blocked_for_a_while_is_left_out(tmp_path):
    grid, config = of_room(tmp_path)
    with grid.block(disc=((0.0, 0.0), 0.3)):
        report = assert_true(grid, config)
    assert "blocked at run time" in report.notes[0]


def test_the_mode_of_the_original_client_promises_less(tmp_path):
    grid, config = of_room(tmp_path)
    report = assert_true(grid.inflate(0.2, mode="minos"), config)
    assert report.radius is None and any("minos" in note for note in report.notes)


# ---------------------------------------------------------------- bad input


def test_a_scene_is_needed(tmp_path, monkeypatch):
    grid, _ = of_room(tmp_path)
    monkeypatch.chdir(tmp_path)
    assert_true(grid)  # its file is here, by the name that the grid states
    grid.save(tmp_path / "room.grid.json")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert_true(tmp_path / "room.grid.json")  # or beside the grid
    with pytest.raises(
        QueryError, match=r"scene\.xml that scene was baked from isn't in the current folder"
    ):
        navbake.verify(grid)
    (tmp_path / "scene.xml").rename(tmp_path / "moved.xml")
    with pytest.raises(QueryError, match=r"isn't in .* or the current folder: give its path"):
        navbake.verify(tmp_path / "room.grid.json")
    with pytest.raises(QueryError, match=r"no scene at .*scene\.xml: it may have moved"):
        navbake.verify(grid, tmp_path / "scene.xml")
    del grid.metadata["navbake"]["settings"]
    with pytest.raises(QueryError, match="doesn't say which scene it was baked from"):
        navbake.verify(grid)


def test_another_scene_is_refused(tmp_path):
    grid, _ = of_room(tmp_path)
    other = write(tmp_path, world(ROOM.replace("1.2 -1.3", "1.0 -1.1")), "other.xml")
    with pytest.raises(
        QueryError, match=r"other\.xml isn't the scene that the grid was baked from"
    ):
        navbake.verify(grid, other)
    report = navbake.verify(grid, other, force=True)
    assert not report.ok and "isn't the scene" in report.notes[0]


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"sample": 0}, "a sample of at least 1 cell, got 0"),
        ({"radius": -0.1}, "radius >= 0 m"),
        ({"tolerance": 0.0}, "tolerance > 0 m"),
        ({"paths": -1}, "paths >= 0"),
    ],
)
def test_options_have_ranges(tmp_path, options, text):
    grid, config = of_room(tmp_path)
    with pytest.raises(QueryError, match=text):
        navbake.verify(grid, config, **options)


def test_a_grid_of_others_without_floors(tmp_path):
    """Its cells are judged over the ground, and it says so."""
    grid, config = of_room(tmp_path)
    free = grid.free & (np.nan_to_num(grid.floor_height, nan=1.0) == 0)
    bare = navbake.SceneGrid2D(
        width=grid.width,
        height=grid.height,
        cell_size=grid.cell_size,
        min_yup=grid.min_yup,
        weights=np.where(free, 1.0, np.inf),
    )
    report = navbake.verify(bare, config)
    notes = "\n".join(report.notes)
    for text in ("no digest", "no floors of cells", "of another program"):
        assert text in notes
    assert not list(report.of_kind(kinds.FREE_TOUCHES))
    wrong = bare.with_layers(weights=np.ones(bare.shape))
    assert any(navbake.verify(wrong, config).of_kind(kinds.FREE_TOUCHES))


# ---------------------------------------------------------------- the setting of the bake


def test_a_bake_verifies_its_grid(tmp_path):
    grid, config = of_room(tmp_path, verify={"sample": 300})
    stated = grid.navbake["verified"]
    report = navbake.verify(grid, config, sample=300)
    assert stated == {"sample": 300, "cells": 300, "disagreements": 0, "digest": report.digest}
    without, _ = of_room(tmp_path)
    assert "verified" not in without.navbake
    assert without.navbake["settingsDigest"] == grid.navbake["settingsDigest"]
    np.testing.assert_array_equal(without.weights, grid.weights)


@pytest.mark.parametrize("sample", [0, 1.5, "all"])
def test_the_setting_has_a_range(tmp_path, sample):
    with pytest.raises(ConfigError, match=r"a whole number >= 1, or null, got .* `verify\.sample`"):
        of_room(tmp_path, verify={"sample": sample})


def test_a_bake_warns_where_it_disagrees(tmp_path, monkeypatch):
    """MuJoCo and FCL are made to find everything touching."""
    monkeypatch.setattr(Probe, "touches", lambda *_: TOUCHES)
    with pytest.warns(
        navbake.BakeWarning, match=r"verify: MuJoCo and FCL disagree .* at \d+ places"
    ):
        grid, _ = of_room(tmp_path, verify={"sample": 300})
    assert grid.navbake["verified"]["disagreements"] > 0
    assert any("navbake verify lists them" in warning for warning in grid.warnings)
