"""What a bake warns of reaches whoever bakes: as warnings, in the grid, in its file and the log."""

from __future__ import annotations

import logging
import warnings

import numpy as np
import pytest
import trimesh

import navbake
from box_worlds import FLOOR, box, world
from navbake.baker.bake.pipeline import run_bake
from navbake.config.settings import SceneSettings, parse_config
from navbake.errors import SceneError
from project_paths import SHARED_DATA
from scenes_alone import load_alone

DUNGEON = SHARED_DATA / "recast_meshes" / "dungeon.obj"
ROBOT = """
<body name="robot" pos="{x} {y} {z}"><freejoint/><geom type="box" size=".25 .25 .3"/>
  <body name="head" pos="0 0 .4"><geom type="sphere" size=".1"/></body></body>"""


@pytest.fixture
def scene(tmp_path):
    """Returns a function that writes a scene of these pieces, and gives its settings."""

    def write(*pieces, **settings):
        path = tmp_path / "scene.xml"
        path.write_text(world(FLOOR + "".join(pieces)))
        own = settings.pop("scene", {})
        return {"scene": {"path": str(path), **own}, **settings}

    return write


def test_warnings_reach_python_the_file_and_the_log(scene, tmp_path, caplog):
    settings = scene(scene={"exclude": {"bodies": ["robott*"], "geoms": ["none\x1b*"]}})
    with pytest.warns(navbake.BakeWarning) as caught, caplog.at_level(logging.WARNING):
        grid = navbake.bake(settings)
    texts = [str(warning.message) for warning in caught]
    assert len(texts) == 2 and "'robott*'" in texts[0]
    assert {warning.filename for warning in caught} == {__file__}
    assert grid.warnings == tuple(texts)
    assert all(text.isprintable() for text in texts)
    assert [record.name for record in caplog.records] == ["navbake"] * 2
    assert [record.getMessage() for record in caplog.records] == [f"scene: {t}" for t in texts]
    grid.save(tmp_path / "a.json")
    loaded = navbake.load(tmp_path / "a.json")
    assert loaded.warnings == loaded.inflate(0.2).warnings == grid.warnings
    assert logging.getLogger("navbake").handlers  # else Python prints what nobody listens to


def test_warnings_can_be_made_errors(scene):
    with warnings.catch_warnings():
        warnings.simplefilter("error", navbake.BakeWarning)
        with pytest.raises(navbake.BakeWarning, match="robott"):
            navbake.bake(scene(scene={"exclude": {"bodies": ["robott"]}}))


def test_a_bake_without_warnings_says_nothing(scene):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        grid = navbake.bake(scene(box("crate", 0, 0, 0, 0.5, 0.5, 0.5)))
    assert grid.warnings == ()
    assert "warnings" not in grid.navbake


def test_what_no_warning_is_in_a_file_is_passed_over(scene):
    grid = run_bake(parse_config(scene())).grid
    for stated, kept in ((["a", 1, None], ("a",)), ("a", ()), ({}, ()), (None, ())):
        grid.navbake["warnings"] = stated
        assert grid.warnings == kept


def test_a_yard_that_is_most_of_the_floor_is_told(scene):
    walls = [
        box("south", -3, -3, 0, 3, -2.9, 2.6),
        box("north", -3, 2.9, 0, 3, 3, 2.6),
        box("west", -3, -2.9, 0, -2.9, 2.9, 2.6),
        box("east", 2.9, -2.9, 0, 3, 2, 2.6),
        box("roof", -3, -3, 2.6, 3, 3, 2.7),
    ]
    for half_side, is_told in ((4.0, False), (12.0, True)):
        lawn = box("lawn", -half_side, -half_side, -0.2, half_side, half_side, 0)
        settings = scene(lawn, *walls, grid={"cell_size": 0.2})
        texts = navbake.bake(settings).warnings
        told = [text for text in texts if "of the floor" in text and "outdoors" in text]
        assert len(told) == is_told, texts
    assert "95% of the floor, 540 of 572 m²" in told[0]


def test_each_level_of_several_has_the_warnings_of_all(tmp_path):
    path = tmp_path / "tower.xml"
    path.write_text(world("".join(box(f"slab{z}", 0, 0, z, 4, 4, z + 0.2) for z in (0, 3))))
    result = run_bake(parse_config({"scene": {"path": str(path)}, "floors": {"roofs": True}}))
    assert len(result.grid.levels) == 2 and "no step leads to 'level 1'" in result.warnings[0]
    assert all(level.warnings == tuple(result.warnings) for level in result.grid.levels)


def movable(result):
    return [warning for warning in result.warnings if "bodies that can move take floor" in warning]


@pytest.mark.parametrize(
    ("cell_size", "half_width", "is_told"),
    [(10.0, 5.0, True), (1.0, 9.0, True), (1.0, 11.0, False), (0.5, 2.0, False)],
)
def test_cells_that_are_coarse_for_their_scene_are_told(scene, cell_size, half_width, is_told):
    floor = f'<geom type="box" size="{half_width} 30 .1" pos="0 0 -.1"/>'
    config = scene(floor, grid={"cell_size": cell_size})
    warnings = run_bake(parse_config(config)).grid.warnings
    told = [warning for warning in warnings if "are coarse for a scene of" in warning]
    assert len(told) == is_told
    if is_told:
        width = round(2 * half_width / cell_size)
        assert f"cells of {cell_size:g} m are coarse for a scene of {width} x " in told[0]
        assert "set `grid.cell_size`" in told[0]


def test_a_robot_that_takes_floor_is_named(scene):
    robot = ROBOT.format(x=0.5, y=0.5, z=0.3)
    result = run_bake(parse_config(scene(robot)))
    [warning] = movable(result)
    [level] = result.grid.levels
    taken = np.count_nonzero(~level.free) * 0.01
    assert f"'robot' ({taken:.2f} m²)" in warning and taken > 0.2
    assert "`scene.exclude.movable: true`" in warning and "head" not in warning
    for exclude in ({"movable": True}, {"bodies": ["rob*"]}):
        result = run_bake(parse_config(scene(robot, scene={"exclude": exclude})))
        assert movable(result) == [] and result.grid.levels[0].free.all()


def test_things_on_tables_take_no_floor(scene):
    table = box("table", 0, 0, 0, 1.5, 1.5, 0.7)
    assert movable(run_bake(parse_config(scene(table, ROBOT.format(x=0.75, y=0.75, z=1.0))))) == []
    fixed = ROBOT.format(x=0.5, y=0.5, z=0.3).replace("<freejoint/>", "")
    assert movable(run_bake(parse_config(scene(fixed)))) == []


def test_few_of_many_movable_bodies_are_named_the_largest_first(scene):
    ball = '<body name="ball{n}" pos="{x} 0 .5"><freejoint/><geom size="{radius}"/></body>'
    balls = "".join(ball.format(n=n, x=0.8 * (n - 2), radius=0.2 + 0.05 * n) for n in range(5))
    [warning] = movable(run_bake(parse_config(scene(balls))))
    assert warning.index("'ball4'") < warning.index("'ball3'") < warning.index("'ball2'")
    assert ", and 2 more;" in warning and "ball1" not in warning


def test_of_bodies_that_take_as_much_the_first_are_named(scene):
    ball = '<body name="ball{n}" pos="{x} 0 .5"><freejoint/><geom size="{radius}"/></body>'
    radii = (0.2, 0.3, 0.2, 0.2, 0.2)
    balls = (ball.format(n=n, x=0.8 * (n - 2), radius=radius) for n, radius in enumerate(radii))
    [warning] = movable(run_bake(parse_config(scene("".join(balls)))))
    assert warning.index("'ball1'") < warning.index("'ball0'") < warning.index("'ball2'")
    assert ", and 2 more;" in warning and "ball3" not in warning and "ball4" not in warning


def test_a_level_without_room_to_stand_is_told(scene):
    pillars = "".join(
        box(f"pillar{x}{y}", x, y, 0, x + 0.1, y + 0.1, 2.5)
        for x in (-2, -1, 0, 1, 1.9)
        for y in (-2, -1, 0, 1, 1.9)
    )
    result = run_bake(parse_config(scene(pillars, agent={"radius": 0.75})))
    [warning] = [warning for warning in result.warnings if "nothing is free" in warning]
    assert not result.grid.levels[0].free.any()
    assert "on 'level 0'" in warning and "`navbake why`" in warning
    assert run_bake(parse_config(scene(pillars))).warnings == []


def building(path, up: str) -> str:
    """A house of 8 m x 6 m x 3 m with an inner wall, whose floor faces along `up`."""
    shell = trimesh.creation.box((8, 6, 3))
    wall = trimesh.creation.box((0.2, 4, 2.8))
    mesh = trimesh.util.concatenate([shell, wall])
    if up == "y":
        mesh.vertices = mesh.vertices @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    mesh.export(path)
    return str(path)


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl"])
def test_a_mesh_that_lies_on_its_side_gets_a_hint(tmp_path, suffix):
    lying = building(tmp_path / f"lying.{suffix}", "y")
    hints = load_alone(SceneSettings(path=lying)).warnings
    assert any("lowest along y" in hint and "set `scene.up` to y" in hint for hint in hints)
    for up in ("y", "z"):  # whoever says which axis is up knows
        assert not any(
            "scene.up" in h for h in load_alone(SceneSettings(path=lying, up=up)).warnings
        )
    upright = building(tmp_path / f"upright.{suffix}", "z")
    assert not any("scene.up" in h for h in load_alone(SceneSettings(path=upright)).warnings)


@pytest.mark.parametrize(
    ("scale", "told"),
    [
        (1.0, ()),
        (100.0, ("is 250 m high", "to 0.01")),
        (1000.0, ("is 2500 m high", "to 0.01")),
        (0.05, ("is only 0.4 m large", "1000 for kilometres")),
        ((1000.0, 1000.0, 1.0), ("is 8000 m large", "to 0.01")),
    ],
)
def test_a_mesh_that_is_probably_not_in_metres_gets_a_hint(tmp_path, scale, told):
    path = tmp_path / "flat.ply"
    trimesh.creation.box((8, 6, 2.5)).apply_scale(scale).export(path)
    scene = load_alone(SceneSettings(path=path))
    hints = [text for text in scene.warnings if "unit" in text]
    assert len(hints) == bool(told) and scene.hints == hints
    assert all(text in hint for text in told for hint in hints)
    # whoever says the unit knows
    said = load_alone(SceneSettings(path=path, unit=1.0)).warnings
    assert not any("unit" in text for text in said)


@pytest.mark.skipif(not DUNGEON.exists(), reason="needs the meshes of Recast")
def test_recasts_dungeon_lies_on_its_side():
    warnings = load_alone(SceneSettings(path=DUNGEON)).warnings
    assert any("is taken with y up" in text and "`scene.up: y`" in text for text in warnings)


def test_wrong_units_are_told_before_the_bake_and_named_in_its_error(tmp_path):
    path, told = tmp_path / "flat.ply", []
    trimesh.creation.box((0.08, 0.06, 0.025)).export(path)
    config = parse_config({"scene": {"path": path}, "grid": {"cell_size": 0.01}})
    with pytest.raises(SceneError, match=r"only 0\.08 m large: set `scene\.unit`"):
        run_bake(config, warn_early=told.append)
    assert len(told) == 1 and "`scene.unit`" in told[0]
    trimesh.creation.box((1.0, 0.8, 0.6)).export(path)
    with pytest.raises(
        SceneError, match=r"`scene\.up` is auto\) and the unit \(`scene\.unit` is 1\)"
    ):
        run_bake(parse_config({"scene": {"path": path}}))


STOREYS = "".join(
    box(name, -3, -3, z - 0.2, 3, 3, z) for name, z in (("low", 0.0), ("high", 2.8), ("roof", 5.6))
)


@pytest.mark.parametrize("ground", [2.9, 3.3, 2.8, 2.7, 4.0])
def test_a_ground_that_is_a_little_too_high_is_told(tmp_path, ground):
    (tmp_path / "a.xml").write_text(world(STOREYS))
    levels = [{"ground": 0, "name": "down"}, {"ground": ground, "name": "up"}]
    settings = {"scene": {"path": str(tmp_path / "a.xml")}, "levels": levels}
    found = run_bake(parse_config(settings)).warnings
    told = [text for text in found if "no floor near its ground" in text]
    if not 2.8 < ground <= 3.3:  # right, or so far that nobody can tell what was meant
        assert told == []
        return
    assert told == [
        f"'up' has no floor near its ground, {ground:.2f} m: one of 36.0 m² lies {ground - 2.8:.2f}"
        " m below it and is on another level; `ground: 2.8` in `levels` takes it in"
    ]
    [unreached] = [text for text in found if "no step leads to 'up'" in text]
    assert "36.0 m² at 5.60 m" in unreached


def floors_below_grounds(tmp_path, geoms, levels, **settings):
    """What a bake tells of floors below grounds, and the area of all its floors [m²]."""
    (tmp_path / "a.xml").write_text(world(geoms))
    settings |= {"scene": {"path": str(tmp_path / "a.xml")}, "levels": levels}
    result = run_bake(parse_config(settings))
    area = sum(np.isfinite(level.floor_height).sum() for level in result.grid.levels) * 0.01
    return [text for text in result.warnings if "because it lies below the ground" in text], area


YARD = box("yard", -5, -5, -1, 5, 5, -0.05) + box("slab", -2, -2, -1, 2, 2, 0.05)


@pytest.mark.parametrize("ground", [0.05, 0.0, -0.02, -0.031, -0.029, -0.05, -3.0])
def test_floor_a_little_below_a_given_ground_is_told(tmp_path, ground):
    """The ground that the warning names takes in as much floor as it says; up to 2 cm all do."""
    told, area = floors_below_grounds(tmp_path, YARD, [{"ground": ground, "name": "down"}])
    if ground <= -0.03:
        assert told == [] and area == pytest.approx(100)
        return
    assert told == [
        f"on no level, because it lies below the ground {ground:.2f} m of 'down': 84.0 m² of "
        "floor, from -0.05 m up, most of it on 'yard', as at -0.05, 2.05, -0.05; `ground: -0.05` "
        "in `levels` takes it in"
    ]
    assert area == pytest.approx(100 - 84)
    assert floors_below_grounds(tmp_path, YARD, [{"ground": -0.05}])[0] == []


def test_a_level_whose_whole_floor_lies_a_little_lower_is_told_its_ground(tmp_path):
    """Not of a floor that is as deep as a storey below."""
    floor = box("", -5, -5, -1, 5, 5, -0.0849)
    for ground, levels in ((0.0, [{"ground": 0.0}]), (-0.02, [{"ground": -0.02, "top": 2.5}])):
        top_text = ", top 2.5 m" if ground else ""
        with pytest.raises(SceneError) as caught:
            floors_below_grounds(tmp_path, floor, levels)
        assert (
            f"no floor on level 0 (ground {ground:g} m{top_text}) of `levels`: the scene's "
            "surfaces span -1 to -0.0849 m; `ground: -0.08` takes in 100.0 m²; the scene spans"
        ) in str(caught.value)
    assert floors_below_grounds(tmp_path, floor, [{"ground": -0.08}]) == ([], pytest.approx(100))
    with pytest.raises(SceneError, match="no floor on level 0") as caught:
        floors_below_grounds(tmp_path, floor, [{"ground": 0.5}])
    assert "takes in" not in str(caught.value)


def test_the_lowest_floor_below_a_ground_says_which_ground_takes_it_in(tmp_path):
    """Under an upper storey with floors 5 and 20 cm lower, below which the level below ends."""
    storeys = box("", -6, -3, -0.2, 6, 3, 0) + box("", -6, -3, 5.6, 6, 3, 5.8)
    storeys += box("", -6, -3, 2.5, -2, 3, 2.85) + box("", -2, -3, 2.5, 2, 3, 2.8)
    storeys += box("bath", 2, -3, 2.5, 6, 3, 2.65)
    levels = [{"ground": 0, "top": 2.4}, {"ground": 2.85, "top": 5}]
    [told], area = floors_below_grounds(tmp_path, storeys, levels)
    assert "below the ground 2.85 m of 'level 1': 48.0 m² of floor, from 2.65 m up" in told
    levels[1]["ground"] = 2.65
    assert floors_below_grounds(tmp_path, storeys, levels) == ([], pytest.approx(area + 48))
    levels[0]["top"] = 2.7  # the bath is above no ground, and below where the level may begin
    levels[1]["ground"] = 2.85
    [told], _ = floors_below_grounds(tmp_path, storeys, levels)
    assert "24.0 m² of floor, from 2.80 m up" in told and "`ground: 2.8`" in told
    del levels[0]["top"]  # now what lies below the ground is on the level below
    assert floors_below_grounds(tmp_path, storeys, levels)[0] == []


STAIR = "".join(box("", 0.28 * k, -1, -3, 0.28 * (k + 1), 1, -2.7 + 0.18 * k) for k in range(15))
RAMP = '<geom type="box" size="13.5 1 .05" euler="0 -5.7106 0" pos="13.44 0 -1.4"/>'  # one in ten


@pytest.mark.parametrize("way", [STAIR, RAMP])
def test_a_storey_that_is_left_out_is_not_told_of(tmp_path, way):
    """Neither the cellar nor the stair or the ramp that leads up from it, 2 m wide."""
    cellar = box("", -6, -4, -3, 40, 4, -2.7) + way
    end = 4.2 if way is STAIR else 26.8
    upper = box("", end, -4, -0.1, 40, 4, 0) + box("", -6, 1, -0.1, end, 4, 0)
    told, area = floors_below_grounds(tmp_path, cellar + upper, [{"ground": 0.0, "top": 2}])
    assert told == [] and area > 40
    told, area_of_both = floors_below_grounds(
        tmp_path, cellar + upper, [{"ground": -2.7}, {"ground": 0.0}]
    )
    assert told == [] and area_of_both > area + 50


def test_what_no_rule_keeps_is_not_told_as_floor_below_a_ground(tmp_path):
    """A table, what no step leads to where such floors are left out, and a strip of floor."""
    table = FLOOR + box("table", -1, -1, 0, 1, 1, 0.8)
    hall = box("", 5, -2, 1, 9, 2, 1.1)
    levels = [{"ground": -0.1, "top": 0.5}, {"ground": 1.0}]
    assert floors_below_grounds(tmp_path, table + hall, levels)[0] == []
    apart = box("", -9, -2, 0.7, -4, 2, 0.8)
    assert len(floors_below_grounds(tmp_path, table + hall + apart, levels)[0]) == 1
    reach = {"reach": "steps", "from": [[7, 0, 1.1]]}
    assert floors_below_grounds(tmp_path, table + hall + apart, levels, floors=reach)[0] == []
    strip = FLOOR + box("", 2, -2, -1, 2.5, 2, -0.1)
    assert floors_below_grounds(tmp_path, strip, [{"ground": 0.0}])[0] == []


@pytest.mark.parametrize("depth", [0.0, 4e-7, 9e-7, -4e-7])
def test_a_floor_where_one_given_level_ends_and_the_next_begins_is_on_one(tmp_path, depth):
    """It was on none if it lay up to a micrometre deeper, as rounding may lay it."""
    storeys = box("", -3, -3, -0.2, 3, 3, 0) + box("", -3, -3, 2.6, 3, 3, 2.83 - depth)
    levels = [{"ground": 0.0}, {"ground": 2.85, "top": 5}]
    told, area = floors_below_grounds(tmp_path, storeys, levels)
    assert told == [] and area == pytest.approx(72)
