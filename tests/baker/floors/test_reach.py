"""What steps lead to: `floors.reach`, `floors.from`, and the levels that are told of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from navbake.baker.bake.pipeline import BakeResult, run_bake
from navbake.config.settings import load_config, parse_config
from navbake.errors import ConfigError, SceneError


def box(name: str, x0: float, x1: float, y0: float, y1: float, z0: float, z1: float) -> str:
    pos = f"{(x0 + x1) / 2} {(y0 + y1) / 2} {(z0 + z1) / 2}"
    size = f"{(x1 - x0) / 2} {(y1 - y0) / 2} {(z1 - z0) / 2}"
    return f'<geom name="{name}" type="box" pos="{pos}" size="{size}"/>'


# A tower of three slabs and a roof; steps lead from the lowest to the second beside them
TOWER = [
    box("ground", -8, 6, 0, 6, -0.2, 0),
    *(box(name, 0, 6, 0, 6, z - 0.2, z) for name, z in
      [("first", 3.0), ("second", 6.0), ("roof", 9.0)]),
    *(box(f"tread {i}", -0.3 * (17 - i), -0.3 * (16 - i), 2, 4, 0, 3 * (i + 1) / 18)
      for i in range(17)),
]  # fmt: skip


@pytest.fixture
def bake(tmp_path: Path):
    def run(geoms: list[str], **settings: object) -> BakeResult:
        path = tmp_path / "scene.xml"
        path.write_text(f"<mujoco><worldbody>{''.join(geoms)}</worldbody></mujoco>")
        return run_bake(parse_config({"scene": {"path": str(path)}, **settings}))

    return run


def grounds(result: BakeResult) -> list[float]:
    return [level.ground for level in result.grid.levels]


def free_area(result: BakeResult) -> float:
    return sum(float(level.free.sum()) * level.cell_size**2 for level in result.grid.levels)


def test_each_level_that_no_step_leads_to_is_told(bake):
    result = bake(TOWER)
    assert grounds(result) == [0, 3, 6]
    [warning] = result.warnings
    assert warning.startswith("no step leads to 'level 2' (36.0 m² at 6.00 m, most of it on 'sec")
    assert "`floors.reach: steps`" in warning and "`floors.from`" in warning


def test_many_levels_that_no_step_leads_to_are_summed_up(bake):
    # the last one is a roof
    slabs = [box(f"slab {k}", -2, 2, -2, 2 + k / 10, 3 * k - 0.1, 3 * k) for k in range(13)]
    result = bake(slabs)
    warnings = [text for text in result.warnings if "no step leads to" in text]
    assert len(result.grid.levels) == 12 and len(warnings) == 6
    # the largest five one by one, in the order of levels
    for k, text in zip(range(7, 12), warnings[:5], strict=True):
        assert f"'level {k}'" in text
    smaller = sum(4 * (4 + k / 10) for k in range(1, 7))
    assert f"floors of 6 more levels, either, {smaller:.1f} m² in all" in warnings[-1]


def test_steps_leaves_them_out(bake):
    result = bake(TOWER, floors={"reach": "steps"})
    assert grounds(result) == [0, 3]
    [warning] = result.warnings
    assert (
        warning.startswith("left out by `floors.reach: steps`") and "'second' (36.0 m²" in warning
    )
    assert all(np.isfinite(level.floor_height).any() for level in result.grid.levels)


def test_from_names_what_counts_as_reached(bake):
    result = bake(TOWER, floors={"from": [[3, 3, 6.5]]})
    assert grounds(result) == [0, 3, 6]
    warnings = [text for text in result.warnings if "no step leads to" in text]
    assert len(warnings) == 2 and "'level 0'" in warnings[0] and "'level 1'" in warnings[1]
    result = bake(TOWER, floors={"from": [[3, 3, 6.5]], "reach": "steps"})
    assert grounds(result) == [6]
    result = bake(TOWER, floors={"from": [[3, 3, 6.5], [-3, 1, 0]], "reach": "steps"})
    assert grounds(result) == [0, 3, 6] and result.warnings == []


def test_from_takes_a_roof_and_a_bed_for_floors(bake):
    """One can only start from where one stands."""
    assert grounds(bake(TOWER, floors={"from": [[3, 3, 9.0]]})) == [0, 3, 6, 9]
    bed = box("bed", 1, 3, 1, 3, 0, 0.6)
    result = bake([TOWER[0], bed], floors={"from": [[2, 2, 0.6]], "reach": "steps"})
    assert grounds(result) == [pytest.approx(0.6)]


def test_from_takes_furniture_only_at_its_own_height(bake):
    ground = box("ground", -4, 4, -4, 4, -0.2, 0)
    shelf = box("shelf", -1, 1, 0, 0.4, 2.0, 2.1)
    settings = {"from": [[0, 0.2, 2.5]], "reach": "steps"}
    result = bake([ground, shelf], floors=settings)
    assert grounds(result) == [0] and result.warnings == []
    for thing in box("desk", -1, 1, 0, 0.4, 0, 0.75), box("bed", -1, 1, -1, 1, 0, 0.75):
        result = bake([ground, thing], floors=settings)
        assert grounds(result) == [0] and result.warnings == []
        assert free_area(result) > 50
    desk = box("desk", -1, 1, 0, 0.4, 0, 0.75)
    result = bake([ground, desk], floors={**settings, "from": [[0, 0.2, 0.76]]})
    assert grounds(result) == [0.75]
    warning, left_out = result.warnings
    assert "too small" in warning and "'desk' (0.8 m² at 0.75 m)" in warning
    assert "'ground' (63.2 m² at 0.00 m)" in left_out


def test_from_over_furniture_takes_the_floor_in_front_of_it(bake):
    """A desk fills a niche, with a larger room behind the thin walls of its three other sides."""
    walls = [
        (-4, 1, 0, 0.1),
        (2, 8, 0, 0.1),
        (0.9, 1, 0.1, 0.9),
        (2, 2.1, 0.1, 0.9),
        (1, 2, 0.8, 0.9),
    ]
    geoms = [
        box("ground", -4, 8, -6, 10, -0.2, 0),
        *(box("", *wall, 0, 2.6) for wall in walls),
        box("desk", 1, 2, 0.1, 0.8, 0, 0.75),
    ]
    for position in [1.5, 0.5, 1.6], [1.5, 0.75, 0.9]:
        result = bake(geoms, floors={"from": [position], "reach": "steps"})
        assert free_area(result) == pytest.approx(72, abs=2)


def test_from_over_a_roof_or_a_platform_takes_these(bake):
    platform = box("platform", -4, 2, 1, 5, 0, 0.8)
    for start, expected in ([3, 3, 10.5], 9), ([-1, 3, 2.4], 0.8):
        settings = {"from": [start], "reach": "steps"}
        geoms = TOWER if expected == 9 else [TOWER[0], platform]
        assert grounds(bake(geoms, floors=settings)) == [expected]


TWO_HOUSES = [
    box(name, x, x + 8, 0, 8, z - 0.2, z)
    for x, house in ((0, "a"), (12, "b"))
    for z, name in ((0, f"{house}0"), (3, f"{house}1"), (6, f"{house}2"))
] + [
    wall
    for x in (0, 12)
    for z in (0, 3)
    for wall in (
        box("", x, x + 8, 0, 0.2, z, z + 2.8), box("", x, x + 8, 7.8, 8, z, z + 2.8),
        box("", x, x + 0.2, 0.2, 7.8, z, z + 2.8), box("", x + 7.8, x + 8, 0.2, 7.8, z, z + 2.8),
    )
]  # fmt: skip


def test_floors_beside_reached_ones_are_told_of(bake):
    """Two closed houses side by side, one of them reached: its neighbour's ground floor is not."""
    result = bake(TWO_HOUSES)
    assert grounds(result) == [0, 3]
    beside, above = result.warnings
    assert beside.startswith(
        "no step leads to 57.8 m² of 'level 0' (most of it on 'b0', as at 15.9"
    )
    assert above.startswith("no step leads to 'level 1' (115.5 m² at 3.00 m")
    result = bake(TWO_HOUSES, floors={"reach": "steps"})
    [warning] = result.warnings
    assert "(57.8 m² at 3.00 m, and 2 more)" in warning
    x, y, z = (float(word) for word in warning.split("[[")[1].split("]]")[0].split(","))
    starts = [[4, 4, 0], [x, y, z]]
    assert free_area(bake(TWO_HOUSES, floors={"reach": "steps", "from": starts})) > 110


def test_niches_that_no_step_leads_to_are_not_told_of(bake):
    shaft = [box("", 2, 4.3, 2, 2.1, 0, 3), box("", 2, 4.3, 4.2, 4.3, 0, 3),
             box("", 2, 2.1, 2, 4.3, 0, 3), box("", 4.2, 4.3, 2, 4.3, 0, 3)]  # fmt: skip
    assert bake([TOWER[0], *shaft]).warnings == []


def test_what_given_levels_show_is_reached_from_the_whole_scene(bake):
    """Of the tower's upper levels alone, the lower one is reached, by stairs from the ground."""
    levels = [{"ground": 3.0, "top": 5.0}, {"ground": 6.0, "top": 8.0}]
    [warning] = bake(TOWER, levels=levels).warnings
    assert warning.startswith("no step leads to 'level 1'")
    result = bake(TOWER, levels=levels[:1], floors={"reach": "steps"})
    assert grounds(result) == [3] and result.warnings == []
    with pytest.raises(SceneError, match="the largest floor of the lowest level lies outside of"):
        bake(TOWER, levels=levels[1:], floors={"reach": "steps"})


def test_a_position_belongs_to_the_floor_below_it_or_a_step_above(bake):
    for z, expected in [(5.9, [0, 3]), (2.76, [0, 3]), (2.74, [0, 3]), (8.7, [6]), (5.76, [6])]:
        result = bake(TOWER, floors={"from": [[3, 3, z]], "reach": "steps"})
        assert grounds(result) == (expected if z < 5.75 else [6]), z


@pytest.mark.parametrize(
    ("position", "words"),
    [
        ([50, 3, 0], "none in that cell"),
        ([-3, 1, -1], "floors there are at 0.00 m"),
    ],
)
def test_a_position_without_a_floor_is_refused(bake, position, words):
    with pytest.raises(SceneError, match=r"no floor at `floors\.from\[1\]` \(") as caught:
        bake(TOWER, floors={"from": [[3, 3, 0], position]})
    assert words in str(caught.value)


def test_what_is_reached_but_lies_outside_of_given_levels_is_refused(bake):
    levels = [{"ground": 0.0, "top": 5.0}]
    with pytest.raises(SceneError, match=r"`floors\.from` names lies outside of the `levels`"):
        bake(TOWER, floors={"from": [[3, 3, 6.0]], "reach": "steps"}, levels=levels)


def test_given_levels_are_told_of_too(bake):
    levels = [{"ground": 0.0}, {"ground": 3.0}, {"ground": 6.0, "name": "attic", "top": 8.0}]
    [warning] = bake(TOWER, levels=levels).warnings
    assert warning.startswith("no step leads to 'attic'")


@pytest.mark.parametrize(
    ("yaml", "message"),
    [
        ("floors: {reach: some}", "expected all or steps|`floors.reach`"),
        ("floors: {from: [[1, 2]]}", r"expected a position \[x, y, z\], got \[1, 2\] at `floors"),
        ("floors: {from: [1, 2, 3]}", r"expected a position \[x, y, z\], got 1 at `floors.from"),
    ],
)
def test_settings_are_checked(tmp_path, yaml, message):
    path = tmp_path / "s.yaml"
    path.write_text(f"scene: {{path: a.xml}}\n{yaml}\n")
    with pytest.raises(ConfigError, match=message):
        load_config(path)
