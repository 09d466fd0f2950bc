"""Warnings that name geoms: drawn ones that count nowhere, and objects that MuJoCo drops."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

import navbake
from navbake.baker.bake.stages import bake_stages

FLOOR = '<geom name="floor" type="box" size="3 3 .05" pos="0 0 -.05"/>'


def warnings_of(body: str, **settings: object) -> tuple[str, ...]:
    xml = f"<mujoco><worldbody>{FLOOR}{body}</worldbody></mujoco>"
    return navbake.bake(mujoco.MjSpec.from_string(xml), **settings).warnings


def told(warnings: tuple[str, ...]) -> list[str]:
    return [text for text in warnings if text.startswith("drawn on free floor")]


def visual(name: str, size: str, pos: str, more: str = "") -> str:
    return (
        f'<geom name="{name}" type="box" size="{size}" pos="{pos}" contype="0" conaffinity="0" '
        f"{more}/>"
    )


def test_drawn_things_without_a_collider_are_named_largest_first():
    things = "".join(
        visual(f"thing_{n}", f".2 {0.1 * (n + 1):.1f} .5", f"{0.8 * n - 2.4:.1f} 0 .5")
        for n in range(7)
    )
    (text,) = told(warnings_of(things))
    names = [text.index(repr(f"thing_{n}")) for n in (6, 5, 4, 3, 2)]
    assert names == sorted(names) and "thing_1" not in text and "and 2 more" in text
    assert "`scene.geoms: all`" in text


@pytest.mark.parametrize(
    "body",
    [
        visual("rug", "1 1 .005", "0 0 .005"),  # too low to matter
        visual("lamp", ".3 .3 .1", "0 0 2.4"),  # over heads
        visual("hidden", ".3 .3 .5", "0 0 .5", 'group="4"'),
        visual("clear", ".3 .3 .5", "0 0 .5", 'rgba="1 1 1 0"'),
        visual("shell", ".31 .31 .51", "0 0 .5")
        + '<geom type="box" size=".3 .3 .5" pos="0 0 .5"/>',
        visual("sky", "9 9 9", "0 0 0"),
    ],
)
def test_what_is_in_nobody_s_way_or_collides_by_another_geom_is_not_told(body):
    assert not told(warnings_of(body))


def test_visuals_of_what_moves_and_collides_are_not_told():
    moving = (
        f'<body pos="1 1 .5"><freejoint/><geom type="box" size=".1 .1 .1"/>'
        f"{visual('cart', '.5 .5 .4', '0 0 0')}</body>"
    )
    assert not told(warnings_of(moving))


def test_an_excluded_thing_is_not_told():
    body = visual("thing", ".3 .3 .5", "0 0 .5")
    assert told(warnings_of(body))
    assert not told(warnings_of(body, scene={"exclude": {"geoms": ["thing"]}}))
    assert not told(warnings_of(body, scene={"geoms": "all"}))


def test_objects_of_an_obj_that_mujoco_drops_are_told(tmp_path: Path):
    first = trimesh.creation.box((4, 4, 0.1))
    second = trimesh.creation.box((0.4, 0.4, 2))
    second.apply_translation((1, 0, 1))
    lines = []
    for name, mesh, offset in (("floor", first, 1), ("pillar", second, 1 + len(first.vertices))):
        lines.append(f"o {name}")
        lines += [f"v {x} {y} {z}" for x, y, z in mesh.vertices]
        lines += ["f {} {} {}".format(*face) for face in mesh.faces + offset]
    (tmp_path / "two.obj").write_text("\n".join(lines))
    (tmp_path / "two.xml").write_text(
        '<mujoco><asset><mesh name="two" file="two.obj"/></asset>'
        '<worldbody><geom type="mesh" mesh="two"/></worldbody></mujoco>'
    )
    warnings = navbake.bake(tmp_path / "two.xml").warnings
    (text,) = (text for text in warnings if "have no face" in text)
    assert text.startswith("mesh 'two': 8 of 16 vertices") and "two.obj" in text
    one_object = "\n".join(line for line in lines if not line.startswith("o "))
    (tmp_path / "one.obj").write_text(one_object)
    (tmp_path / "one.xml").write_text((tmp_path / "two.xml").read_text().replace("two", "one"))
    warnings = navbake.bake(tmp_path / "one.xml").warnings
    assert not [text for text in warnings if "have no face" in text]


@pytest.mark.parametrize("offset", [1e3, 1e5, 4.2e6])
def test_a_scene_has_its_cells_wherever_it_lies(offset):
    body = f'<geom type="box" size="3 3 .1" pos="{offset} {offset} -.1"/>'
    spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    assert navbake.bake(spec).levels[0].shape == (60, 60)


def test_too_many_cells_name_the_largest_geom():
    with pytest.raises(navbake.ConfigError) as caught:
        warnings_of('<geom name="dome" type="sphere" size="900"/>', scene={"geoms": "all"})
    for words in ("'dome'", "1800 x 1800 m", "`grid.bounds`", "`scene.exclude`"):
        assert words in str(caught.value)


@pytest.mark.parametrize(
    ("stray", "words"),
    [
        ('<geom name="stray" size=".05" pos="5000 0 1"/>', "without 'stray' it is 6 x 6 m"),
        ('<geom name="stray" size=".05" pos="-40 90 1"/>', "without 'stray' it is 6 x 6 m"),
        # two far ones: neither makes the box alone
        (
            '<geom size=".05" pos="900 900 0"/><geom size=".05" pos="900 900 1"/>'
            '<geom size=".05" pos="-2 -2 1"/>',
            "the largest geom is 'floor', 6 x 6 m",
        ),
        ("", "the largest geom is 'floor', 6 x 6 m"),
    ],
)
def test_too_many_cells_name_the_geom_that_makes_the_box(stray, words):
    with pytest.raises(navbake.ConfigError) as caught:
        warnings_of(stray, grid={"max_cells": 1000})
    assert words in str(caught.value)
    with pytest.raises(navbake.ConfigError) as caught:
        warnings_of(stray, grid={"max_cells": 3000, "bounds": [0, 0, 90, 90]})
    assert "geom is" not in str(caught.value) and "without" not in str(caught.value)


def test_a_thing_that_collides_in_a_pair_is_not_told_to_collide_with_nothing():
    body = visual("thing", ".3 .3 .5", "0 0 .5") + visual("other", ".3 .3 .5", "1 0 .5")
    ball = '<body pos="0 0 2"><freejoint/><geom name="ball" size=".1"/></body>'
    pair = '<contact><pair geom1="thing" geom2="ball"/></contact>'
    xml = f"<mujoco><worldbody>{FLOOR}{body}{ball}</worldbody>{pair}</mujoco>"
    spec = mujoco.MjSpec.from_string(xml)
    (text,) = told(navbake.bake(spec).warnings)
    assert "can't collide" not in text and "<contact><pair>" in text
    assert "'thing' (0.36 m²)" in text and "'other'" in text
    reasons = {geom.name: geom.reason for geom in bake_stages(spec).scene.geoms}
    assert reasons["thing"].startswith("collides in a <contact><pair> alone")
    assert reasons["other"].startswith("can't collide")


def test_slats_whose_gaps_hold_all_centres_are_a_floor():
    """No line through a cell's centre meets anything, and a crack is beside each."""
    slats = "".join(
        f'<geom type="box" size=".045 1.5 .05" pos="{0.1 * n:.2f} 1.5 -.05"/>' for n in range(31)
    )
    spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{slats}</worldbody></mujoco>")
    grid = navbake.bake(spec, grid={"bounds": [0, 0, 3, 3]})
    assert grid.levels[0].free.sum() == 900


@pytest.mark.parametrize(("width", "fill"), [(3.0, 8.9), (3.0, 10.0), (3.0, 1e6), (0.9, 2.0)])
def test_holes_may_be_larger_than_the_whole_grid(width, fill):
    corners = [[0, 0, 0], [width, 0, 0], [width, width, 0], [0, width, 0]]
    sheet = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    floors = {"fill": fill, "min_area": 0.1, "shrink": 0.1}
    grid = navbake.bake(sheet, scene={"up": "z"}, floors=floors)
    assert grid.levels[0].free.sum() == round(width * 10) ** 2


def test_a_scan_s_holes_are_closed_before_its_size_is_judged():
    """A hole of 10 cm every 0.5 m leaves nothing after shrinking by 0.3 m."""
    side = np.arange(41) / 10
    points = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    row, col = np.divmod(np.arange(1600), 40)
    corner = (row * 41 + col)[~((row % 5 == 2) & (col % 5 == 2))]
    triangles = [corner, corner + 1, corner + 42], [corner, corner + 42, corner + 41]
    faces = np.concatenate([np.stack(triangle, axis=1) for triangle in triangles])
    scan = trimesh.Trimesh(np.c_[points, np.zeros(len(points))], faces, process=False)
    level = navbake.bake(scan, scene={"up": "z", "scan": True}).levels[0]
    assert level.free.sum() == 1600 and level.attributes["unseen"].sum() == 64
    with pytest.raises(navbake.SceneError, match="no floor"):
        navbake.bake(scan, scene={"up": "z"})


def test_a_part_of_a_large_scene_is_judged_by_what_is_near():
    """A plain of 2 x 2 km has 4e8 cells; the grid of 10 x 10 m needs those within 50 m."""
    plain = '<geom type="box" size="1000 1000 .1" pos="0 0 -.1"/>'
    spec = mujoco.MjSpec.from_string(f"<mujoco><worldbody>{plain}</worldbody></mujoco>")
    grid = navbake.bake(spec, grid={"bounds": [-5, -5, 5, 5]})
    assert grid.levels[0].free.all()
    (text,) = (text for text in grid.warnings if "decided on a part" in text)
    assert "x -55 to 55 m" in text
