"""Which geoms count, and why."""

from __future__ import annotations

import pytest

from navbake.config.settings import SceneSettings
from navbake.errors import SceneError
from scenes_alone import load_alone

OFF = 'contype="0" conaffinity="0"'
TETRAHEDRON = 'vertex="0 0 0 1 0 0 0 1 0 0 0 1"'


@pytest.fixture
def load(tmp_path):
    """Returns a function that loads MJCF, given what is in its <worldbody> and before it."""

    def call(world, before="", **settings):
        path = tmp_path / "scene.xml"
        path.write_text(f"<mujoco>{before}<worldbody>{world}</worldbody></mujoco>")
        return load_alone(SceneSettings(path=path, **settings))

    return call


def counted(scene):
    return [geom.name for geom in scene.geoms if geom.counted]


def reasons(scene):
    return {geom.name: geom.reason for geom in scene.geoms}


# ---------------------------------------------------------------- collision, visual, all, auto

MIXED = f"""
  <geom name="ground" type="plane" size="0 0 1" rgba="1 1 1 0"/>
  <geom name="painted" type="box" size="1 1 1" group="1" {OFF}/>
  <geom name="half" size="1" contype="0"/>
  <geom name="ghost" size="1" rgba="1 1 1 0" {OFF}/>
  <body name="chair">
    <geom name="look" size="1" group="2" {OFF}/>
    <geom name="touch" size="1" group="3"/>
    <geom name="seat" size="1" group="0"/>
    <geom name="leg" size="1" group="2"/>
  </body>
  <body name="box"><geom name="both" size="1"/></body>
"""


@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        ("collision", "ground half touch seat leg both"),
        ("auto", "ground half touch seat leg both"),
        ("visual", "painted half look leg both"),
        ("all", "ground painted half ghost look touch seat leg both"),
    ],
)
def test_modes(load, mode, expected):
    assert counted(load(MIXED, geoms=mode)) == expected.split()


def test_reasons_read_well(load):
    off = "can't collide (contype and conaffinity are 0)"
    names = ["ground", "painted", "half", "ghost", "look", "touch", "seat", "leg", "both"]
    assert reasons(load(MIXED)) == {
        name: off if name in ("painted", "ghost", "look") else "can collide" for name in names
    }
    assert reasons(load(MIXED, geoms="visual")) == {
        "ground": "not drawn (alpha 0)",
        "painted": "is drawn",
        "half": "is drawn",
        "ghost": "not drawn (alpha 0)",
        "look": "is drawn",
        "touch": "not drawn (group 3)",
        "seat": "stands in for its body's visual geoms",
        "leg": "is drawn",
        "both": "is drawn",
    }
    assert set(reasons(load(MIXED, geoms="all")).values()) == {"all geoms count"}


def test_auto_counts_all_where_none_can_collide(load):
    world = f'<geom name="a" size="1" {OFF}/><geom name="b" size="1" rgba="0 0 0 0" {OFF}/>'
    assert reasons(load(world)) == dict.fromkeys("ab", "no geom can collide, so all count")


def test_auto_does_not_mind_an_excluded_robot(load):
    """A building that is only drawn still counts when all that collides is left out."""
    world = (
        f'<geom name="room" size="1" {OFF}/><body name="robot"><geom name="arm" size="1"/></body>'
    )
    assert counted(load(world)) == ["arm"]
    assert counted(load(world, exclude={"bodies": ["robot"]})) == ["room"]


def test_materials_and_colours_can_hide(load):
    assets = '<asset><material name="glass" rgba="1 1 1 0"/><material name="wood"/></asset>'
    world = """
      <geom name="glass" size="1" material="glass"/>
      <geom name="wood" size="1" material="wood"/>
      <geom name="painted glass" size="1" material="glass" rgba="1 0 0 1"/>
      <geom name="clear wood" size="1" material="wood" rgba="1 0 0 0"/>
    """
    assert counted(load(world, assets, geoms="visual")) == ["wood", "painted glass"]
    assert len(counted(load(world, assets))) == 4


def test_defaults_apply(load):
    inner = '<default class="c"><geom contype="1"/></default>'
    before = f"<default><geom {OFF}/>{inner}</default>"
    world = '<geom name="a" size="1"/><geom name="b" size="1" class="c"/>'
    assert counted(load(world, before)) == ["b"]


# ---------------------------------------------------------------- exclusion

BODIES = """
  <geom name="floor" type="plane" size="5 5 1"/>
  <body name="table"><geom name="top" size="1"/></body>
  <body name="vase"><freejoint/>
    <geom name="glass" size="1"/>
    <body><geom size="1"/></body>
  </body>
  <body name="robot"><joint type="slide"/><geom name="arm [left]" size="1"/></body>
"""


@pytest.mark.parametrize(
    ("exclude", "left"),
    [
        ({}, ["floor", "top", "glass", "geom 3", "arm [left]"]),
        ({"bodies": ["vase"]}, ["floor", "top", "arm [left]"]),
        ({"bodies": ["va?e", "rob*"]}, ["floor", "top"]),
        ({"bodies": ["[tr]*"]}, ["floor", "glass", "geom 3"]),
        ({"bodies": ["*"]}, ["floor"]),  # the world itself is never excluded
        ({"bodies": ["body 3"]}, ["floor", "top", "glass", "arm [left]"]),
        ({"geoms": ["floor", "g*"]}, ["top", "arm [left]"]),
        ({"geoms": ["geom 3"]}, ["floor", "top", "glass", "arm [left]"]),
        ({"geoms": ["*[[]left[]]"]}, ["floor", "top", "glass", "geom 3"]),
        ({"geoms": ["Floor"]}, ["floor", "top", "glass", "geom 3", "arm [left]"]),
        ({"movable": True}, ["floor", "top"]),
    ],
)
def test_exclusion(load, exclude, left):
    assert counted(load(BODIES, exclude=exclude)) == left


def test_why_something_is_excluded(load):
    exclude = {"bodies": ["tab*"], "geoms": ["floor", "gl*"], "movable": True}
    scene = load(BODIES + '<geom name="shelf" size="1"/>', exclude=exclude)
    assert reasons(scene) == {
        "floor": "excluded: matches 'floor'",
        "shelf": "can collide",
        "top": "excluded: body 'table' matches 'tab*'",
        "glass": "excluded: matches 'gl*'",
        "geom 4": "excluded: body 'vase' can move",
        "arm [left]": "excluded: body 'robot' can move",
    }
    assert [geom.shape for geom in scene.geoms] == ["", "solid", "", "", "", ""]
    assert scene.warnings == []


def test_patterns_that_match_nothing_are_named(load):
    exclude = {"bodies": ["tabel", "t*", "table"], "geoms": ["lamp*"]}
    assert load(BODIES, exclude=exclude, meshes={"arm*": "hull"}).warnings == [
        "`scene.exclude.bodies` pattern 'tabel' matches nothing; near names are table",
        "`scene.exclude.geoms` pattern 'lamp*' matches nothing",
        "`scene.meshes` pattern 'arm*' matches no mesh",
    ]


def test_nothing_left_says_why(load):
    with pytest.raises(
        SceneError, match=r"none of the 5 geoms of .*scene.xml counts .*matches '\*'"
    ):
        load(BODIES, exclude={"geoms": ["*"]})
    world = f'<geom size="1" {OFF}/>'
    with pytest.raises(SceneError, match=r"`scene.geoms` is collision\): can't collide"):
        load(world, geoms="collision")


# ---------------------------------------------------------------- meshes

MESHES = f"""<asset>
  <mesh name="wall" inertia="shell" {TETRAHEDRON} face="0 2 1 0 1 3 0 3 2"/>
  <mesh name="post" {TETRAHEDRON}/>
</asset>"""
OF_MESHES = f"""
  <geom name="a" type="mesh" mesh="wall"/>
  <geom name="b" type="mesh" mesh="wall" {OFF}/>
  <body name="door"><geom name="c" type="mesh" mesh="post"/></body>
  <body><geom name="d" type="mesh" mesh="post" {OFF}/></body>
  <body><geom name="e" type="sphere" size="1"/></body>
"""


@pytest.mark.parametrize(
    ("meshes", "expected"),
    [
        ("auto", "hull surface hull closed"),
        ("hull", "hull hull hull hull"),
        ("surface", "surface surface closed closed"),
        ({"wall": "surface"}, "surface surface hull closed"),
        ({"door": "surface"}, "hull surface closed closed"),
        ({"b": "hull", "*": "surface"}, "surface hull closed closed"),
        ({"*": "auto", "a": "surface"}, "hull surface hull closed"),  # the first match wins
    ],
)
def test_meshes_as_hull_or_surface(load, meshes, expected):
    scene = load(OF_MESHES, MESHES, meshes=meshes, geoms="all")
    shapes = [geom.shape for geom in scene.geoms]
    assert [shape.split()[0] for shape in shapes] == [*expected.split(), "solid"]
    assert scene.warnings == []
