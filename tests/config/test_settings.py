"""The YAML: defaults, types, ranges, overrides, and what each mistake is told."""

import json
from pathlib import Path

import pytest
import yaml

from navbake.config.settings import (
    SECTIONS,
    BakeConfig,
    as_config,
    load_config,
    parse_config,
    settings_digest,
)
from navbake.config.template import render_template, write_template
from navbake.errors import ConfigError, SceneError
from navbake.yaml_text import parse_yaml


@pytest.fixture
def house(tmp_path):
    """Returns a function that writes house.yaml."""

    def write(text):
        path = tmp_path / "house.yaml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def with_scene(text=""):
    return f"scene: {{path: house.xml}}\n{text}"


def message(path, overrides=()):
    with pytest.raises(ConfigError) as caught:
        load_config(path, overrides)
    text = str(caught.value)
    assert "\n" not in text
    return text.replace(str(path), Path(path).name)


# ---------------------------------------------------------------- what is read


def test_defaults(house):
    config = load_config(house(with_scene()))
    assert config.scene.id == "house"
    assert config.scene.geoms == config.scene.meshes == "auto"
    assert config.scene.exclude.bodies == []
    assert config.agent.model_dump() == {
        "height": 1.14,
        "radius": 0.05,
        "traversable_floor_height": 0.25,
        "max_slope": 45.0,
    }
    assert (config.grid.cell_size, config.grid.bounds, config.grid.margin) == (0.1, None, 0.0)
    assert config.grid.max_cells == 25_000_000
    assert config.levels == "auto"
    assert config.floors.model_dump() == {
        "min_area": 1.0,
        "shrink": 0.3,
        "crack": 0.03,
        "fill": 0.0,
        "tops": False,
        "roofs": False,
        "voids": False,
        "reach": "all",
        "movable": [],
        "starts": [],
    }
    assert config.names.model_dump() == {"enabled": True, "walls": []}
    assert config.attributes == []
    assert config.output is None


def test_scans_have_their_holes_closed(house):
    scan = load_config(house("scene: {path: a.ply, scan: true}"))
    assert (scan.scene.up, scan.floors.fill) == ("auto", 2.0)
    given = load_config(house("scene: {path: a.ply, scan: true}\nfloors: {fill: 0.5}"))
    assert given.floors.fill == 0.5


def test_every_key(house):
    config = load_config(
        house("""
            scene:
              id: flat
              path: ../scenes/a.xml
              up: y
              unit: 0.01
              geoms: visual
              meshes: {"wall*": surface}
              exclude: {bodies: ["robot*"], geoms: [lamp], movable: true}
              keyframe: 2
              joints: {door: 1.57, ball: [1, 0, 0, 0]}
            agent: {height: 2, radius: 0, traversable_floor_height: 1e-1, max_slope: 89.9}
            grid: {cell_size: 1, bounds: [-1, 0, 2.5, 3], margin: 1, max_cells: 1_000}
            levels:
            - {ground: 0, top: 2.7, name: ground floor}
            - ground: 3.0
            floors: {min_area: 0, shrink: 0, roofs: true, movable: [bridge, "stage*"]}
            names: {enabled: false, walls: ["wall_*", fence]}
            attributes: [clearance, island]
            output: out/a.grid.json
        """)
    )
    assert config.scene.keyframe == 2
    assert config.scene.meshes == {"wall*": "surface"}
    assert config.scene.joints == {"door": 1.57, "ball": [1.0, 0.0, 0.0, 0.0]}
    assert config.agent.traversable_floor_height == 0.1
    assert config.grid.bounds == [-1.0, 0.0, 2.5, 3.0]
    assert config.grid.max_cells == 1000
    assert isinstance(config.grid.cell_size, float)
    assert config.floors.movable == ["bridge", "stage*"]
    assert config.levels[0].name == "ground floor"
    assert config.levels[1].model_dump() == {"ground": 3.0, "top": None, "name": None}
    assert config.names.model_dump() == {"enabled": False, "walls": ["wall_*", "fence"]}
    assert config.output == Path("out/a.grid.json")


def test_scene_path_is_relative_to_the_yaml_and_output_is_not(house, tmp_path):
    path = house("scene: {path: scenes/house.xml}\noutput: house.grid.json")
    config = load_config(path)
    assert config.scene.path == tmp_path / "scenes" / "house.xml"
    assert config.output == Path("house.grid.json")


def test_absolute_scene_path_stays(house):
    path = Path("/data/house.xml")
    assert load_config(house(f"scene: {{path: {path.as_posix()}}}")).scene.path == path


@pytest.mark.parametrize("name", ["house.xml", "house.glb", "house.v2.obj"])
def test_a_scene_file_gets_the_defaults(name):
    config = load_config(f"scenes/{name}")
    assert config.scene.path == Path("scenes") / name
    assert config.scene.id == Path(name).stem
    assert config == parse_config({"scene": {"path": f"scenes/{name}"}})


def test_sections_may_be_empty(house):
    config = load_config(house("scene:\n  path: house.xml\n  exclude:\nagent:\ngrid:\nfloors:"))
    assert config == load_config(house(with_scene()))


@pytest.mark.parametrize(
    ("text", "enabled"), [("false", False), ("true", True), ("", True), ("{}", True)]
)
def test_names_are_switched_by_one_word(house, text, enabled):
    assert load_config(house(with_scene(f"names: {text}"))).names.enabled is enabled
    assert load_config(house(with_scene()), [f"names={text}"]).names.enabled is enabled


def test_text_that_yaml_1_1_would_turn_into_something_else(house):
    config = load_config(
        house("scene: {path: a.xml, exclude: {bodies: [on, no, 2026-01-01, 1:30]}}")
    )
    assert config.scene.exclude.bodies == ["on", "no", "2026-01-01", "1:30"]


@pytest.mark.parametrize(
    ("text", "value"),
    [("1e-3", 1e-3), ("010", 10), ("1_000", 1000), ("5.", 5.0), (".5", 0.5), ("-2", -2)],
)
def test_numbers_of_yaml(text, value):
    assert parse_yaml(text, "text") == value


def test_as_config_takes_every_form(house, tmp_path):
    path = house(with_scene())
    config = load_config(path)
    assert as_config(config) is config
    assert as_config(path) == as_config(str(path)) == config
    assert as_config({"scene": {"path": tmp_path / "house.xml"}}) == config


# ---------------------------------------------------------------- what is refused

REFUSED = [
    (
        "grid: {cell_size: 5cm}",
        'expected a number > 0, got "5cm" at `grid.cell_size` in house.yaml',
    ),
    ("grid: {cell_size: '0.1'}", 'expected a number > 0, got "0.1" at `grid.cell_size`'),
    ("grid: {cell_size: 0}", "expected a number > 0, got 0 at `grid.cell_size`"),
    ("grid: {cell_size: -0.1}", "got -0.1 at `grid.cell_size`"),
    ("grid: {cell_size: .nan}", "got nan at `grid.cell_size`"),
    ("grid: {cell_size: .inf}", "got inf at `grid.cell_size`"),
    ("grid: {cell_size: 1e999}", "got inf at `grid.cell_size`"),
    ("grid: {cell_size: true}", "got true at `grid.cell_size`"),
    ("grid: {cell_size: null}", "got null at `grid.cell_size`"),
    ("grid: {cell_size: [0.1]}", "got [0.1] at `grid.cell_size`"),
    ("grid: {cell_size: {x: 1}}", "got a mapping at `grid.cell_size`"),
    ("grid: {margin: -1}", "expected a number >= 0, got -1 at `grid.margin`"),
    ("grid: {max_cells: 0}", "expected a whole number >= 1, got 0 at `grid.max_cells`"),
    ("grid: {max_cells: 1e6}", "expected a whole number >= 1, got 1000000.0 at `grid.max_cells`"),
    ("grid: {bounds: [0, 0, 1]}", "expected [x_min, y_min, x_max, y_max] with min < max, or null"),
    ("grid: {bounds: [0, 0, 0, 1]}", "got [0, 0, 0, 1] at `grid.bounds`"),
    ("grid: {bounds: [0, .nan, 1, 1]}", "at `grid.bounds`"),
    ("grid: [0.1]", "expected a mapping, got [0.1] at `grid`"),
    ("grid: 0.1", "expected a mapping, got 0.1 at `grid`"),
    ("agent: {height: 0}", "expected a number > 0, got 0 at `agent.height`"),
    ("agent: {radius: -0.05}", "expected a number >= 0, got -0.05 at `agent.radius`"),
    ("agent: {max_slope: 90}", "expected a number of degrees from 0 to 89.9, got 90"),
    (
        "agent: {height: 1, traversable_floor_height: 1}",
        "expected a number >= 0 and < `agent.height` (1), got 1 "
        "at `agent.traversable_floor_height`",
    ),
    ("agent: {height: 0.2}", "< `agent.height` (0.2), got 0.25"),
    ("levels: []", "expected auto or a list of {ground: …, top: …, name: …}, got a list of 0"),
    ("levels: three", 'got "three" at `levels`'),
    ("levels: [0.0, 3.0]", "a mapping such as {ground: 0.0}, got 0.0 at `levels[0]`"),
    ("levels: [0, 3]", "a mapping such as {ground: 3}, got 3 at `levels[1]`"),
    ("levels: [true]", "expected a mapping, got true at `levels[0]`"),
    ("levels: [{top: 3.0}]", "expected a value, found none at `levels[0].ground`"),
    ("levels: [{ground: low}]", 'expected a number, got "low" at `levels[0].ground`'),
    ("levels: [{ground: 1, top: 1}]", "expected a number > `ground` (1), or null, got 1"),
    ("levels: [{ground: 0, tpo: 1}]", "the nearest known one is `levels.top`"),
    (
        "levels: [{ground: 0}, {ground: 0}]",
        "expected a ground above that of the level before (0), got 0 at `levels[1].ground`",
    ),
    (
        "levels: [{ground: 0, top: 4}, {ground: 3}]",
        "expected a top up to the next level's ground (3), got 4 at `levels[0].top`",
    ),
    ("levels: [{ground: 0, name: ''}]", 'got "" at `levels[0].name`'),
    ("floors: {roofs: 1}", "expected true or false, got 1 at `floors.roofs`"),
    ("floors: {roofs: yes}", 'expected true or false, got "yes" at `floors.roofs`'),
    ("names: 0", "expected a mapping, got 0 at `names`"),
    ("names: {walls: 3}", "expected a list, got 3 at `names.walls`"),
    ("names: {wall: [wall_*]}", "the nearest known one is `names.walls`"),
    (
        "levels: [{ground: 0, name: a}, {ground: 3, name: a}]",
        'expected no name twice, got "a" at `levels[1].name`',
    ),
    ("attributes: [island, island]", "expected a list of some of island, clearance, each once"),
    ("attributes: [color]", 'got ["color"] at `attributes`'),
    ("attributes: island", 'got "island" at `attributes`'),
    ("output: ''", 'expected a path, got "" at `output`'),
    ("output: 3", "expected a path, got 3 at `output`"),
    ("outptu: a.json", "unknown key `outptu`, the nearest known one is `output`, in house.yaml"),
    (
        "grid: {cellsize: 0.1}",
        "unknown key `grid.cellsize`, the nearest known one is `grid.cell_size`",
    ),
    ("cell_size: 0.1", "unknown key `cell_size`, the nearest known one is `grid.cell_size`"),
    ("grid: {zzz: 1}", "known are cell_size, bounds, margin, max_cells"),
    ("5: 1", "got 5"),
    ("<<: {output: a}", "`<<` merges keys in YAML 1.1 alone"),
]
REFUSED_IN_SCENE = [
    ("path: 3", "expected the path of a scene file, got 3 at `scene.path`"),
    ("path: ''", 'expected the path of a scene file, got "" at `scene.path`'),
    ("id: flat", "expected a value, found none at `scene.path`"),
    ("path: a.xml, id: ''", 'got "" at `scene.id`'),
    ("path: a.xml, id: a/b", 'expected text without / and \\ (a number needs quotes), got "a/b"'),
    ("path: a.xml, id: 7", "got 7 at `scene.id`"),
    ("path: a.xml, id: ..", 'got ".." at `scene.id`'),
    ('path: a.xml, id: "a\\nb"', 'got "a\\nb" at `scene.id`'),
    (
        "path: a.xml, up: north",
        "expected auto, level, an axis (x, -x, y, -y, z, -z) or a direction [x, y, z], "
        'got "north" at `scene.up`',
    ),
    ("path: a.xml, up: [0, 0, 0]", "or a direction [x, y, z], got [0, 0, 0] at `scene.up`"),
    ("path: a.xml, unit: 0", "expected a number > 0, got 0 at `scene.unit`"),
    ("path: a.xml, geoms: some", "expected auto, collision, visual or all"),
    ("path: a.xml, meshes: soup", "expected auto, hull, surface, shell or {pattern: one of these}"),
    ("path: a.xml, meshes: {wall: soup}", 'got "soup" at `scene.meshes.wall`'),
    ("path: a.xml, exclude: {bodies: 3}", "expected a list, got 3"),
    ("path: a.xml, exclude: {bodies: [1]}", "got 1 at `scene.exclude.bodies[0]`"),
    ("path: a.xml, exclude: {body: []}", "the nearest known one is `scene.exclude.bodies`"),
    ("path: a.xml, exclude: {movable: 0}", "expected true or false, got 0"),
    ("path: a.xml, keyframe: -1", "expected a keyframe's name or index, or null, got -1"),
    ("path: a.xml, keyframe: true", "got true at `scene.keyframe`"),
    ("path: a.xml, joints: {door: open}", "expected a number or a list of numbers"),
    ("path: a.xml, joints: {door: .nan}", "got nan at `scene.joints.door`"),
    ("path: a.xml, joints: {1: 2}", "got 1 at `scene.joints[1]`"),
    ("path: a.xml, joints: [1]", "expected a mapping, got [1] at `scene.joints`"),
]


@pytest.mark.parametrize(("text", "expected"), REFUSED)
def test_refuses(house, text, expected):
    assert expected in message(house(with_scene(text)))


@pytest.mark.parametrize(("text", "expected"), REFUSED_IN_SCENE)
def test_refuses_in_scene(house, text, expected):
    assert expected in message(house(f"scene: {{{text}}}"))


def test_a_scene_alone_is_written_as_a_mapping(house):
    expected = 'expected a mapping such as {path: x.xml}, got "x.xml" at `scene`'
    assert expected in message(house("scene: x.xml"))


def test_a_map_of_nav2_is_no_settings(house):
    text = message(house("image: a.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nmode: trinary"))
    assert "got a map of nav2: `navbake convert`" in text and "house.yaml" in text


@pytest.mark.parametrize("text", ["grid: {}", "scene:", "scene: {}"])
def test_the_scene_is_required(house, text):
    expected = "expected a value, found none at `scene.path` in house.yaml"
    assert message(house(text)) == expected


def test_tells_how_many_more(house):
    more = "grid: {cell_size: a, margin: b}\nagent: {radius: c, hight: 1}"
    text = message(house(with_scene(more)))
    assert text.startswith("unknown key `agent.hight`")  # often the reason for the others
    assert "`agent.radius`" in text and text.endswith("(and 1 more)")


def test_names_the_override_at_fault(house):
    text = message(house(with_scene("")), ["gird.cell_size=1"])
    assert "unknown key `gird`" in text and "in --set gird.cell_size=1" in text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "expected a mapping of settings in house.yaml"),
        ("- a", "expected a mapping of settings"),
        ("scene", "expected a mapping of settings"),
        ("scene: {path: [}", "line 1 of house.yaml"),
        ("scene:\n  path: a\n bad: 1", "line 3 of house.yaml"),
        ("scene: {path: a}\nscene: {path: b}", "'scene' stands here a second time in line 2"),
        (
            "scene: {path: a, exclude: {bodies: [*robot]}}",
            "found text that begins with * and needs quotes in line 1 of house.yaml",
        ),
        ("scene: !!python/object:os.system {}", "line 1"),
        ("a: 1\n---\nb: 2", "line 2"),
        ("? [a]\n: 1", "line 1"),
        ("a: " + "[" * 5000, "nest"),  # see test_yaml_text.py
        ("a: \x07", "is no YAML"),
        ("a: " + "9" * 5000, "house.yaml is no YAML: Exceeds the limit"),
        ("a: !!int x", "house.yaml is no YAML: invalid literal for int"),
        ("a: !!bool maybe", "house.yaml is no YAML"),
        ("a:\n  b: !!timestamp x", "house.yaml is no YAML"),
        ("a: !!float ''", "house.yaml is no YAML"),
        ("a: !!set [1]", "line 1"),
        ("a: !!omap 3", "line 1"),
    ],
)
def test_refuses_what_is_no_settings_file(house, text, expected):
    assert expected in message(house(text))


def test_refuses_files_that_cannot_be_read(tmp_path):
    assert message(tmp_path / "none.yaml") == "no such file: none.yaml"
    (tmp_path / "nine.xml").touch()
    (tmp_path / "nine.png").touch()
    hint = "no such file: nine.yaml: did you mean nine.xml?"
    assert message(tmp_path / "nine.yaml") == hint.replace("nine.xml", str(tmp_path / "nine.xml"))
    with pytest.raises(ConfigError) as caught:
        load_config(tmp_path / "nine.yaml")
    assert caught.value.hint == f"did you mean {tmp_path / 'nine.xml'}?"
    (tmp_path / "folder.yaml").mkdir()
    assert "cannot read folder.yaml" in message(tmp_path / "folder.yaml")
    (tmp_path / "latin.yaml").write_bytes(b"scene: {id: caf\xe9}")
    assert "byte 15 is not UTF-8" in message(tmp_path / "latin.yaml")


# ---------------------------------------------------------------- overrides


def test_overrides(house):
    path = house(with_scene("grid: {cell_size: 0.2, margin: 1}"))
    config = load_config(
        path,
        [
            "grid.cell_size=0.05",
            "agent.radius=1e-1",
            "scene.exclude.bodies=['robot*', lamp]",
            "scene.joints.left.hip=0.5",
            "scene.meshes.wall.*=hull",
            "levels=[{ground: 1}]",
            "output=a=b.json",
            "grid.cell_size=0.4",
        ],
    )
    assert (config.grid.cell_size, config.grid.margin) == (0.4, 1.0)
    assert config.agent.radius == 0.1
    assert config.scene.exclude.bodies == ["robot*", "lamp"]
    assert config.scene.joints == {"left.hip": 0.5}
    assert config.scene.meshes == {"wall.*": "hull"}
    assert config.levels[0].ground == 1.0
    assert config.output == Path("a=b.json")


def test_overrides_leave_the_data_as_it_was():
    data = {"scene": {"path": "a.xml"}, "grid": {"margin": 1}}
    parse_config(data, overrides=["grid.margin=2", "scene.id=b"])
    assert data == {"scene": {"path": "a.xml"}, "grid": {"margin": 1}}


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("grid.cell_size=5cm", 'got "5cm" at `grid.cell_size` in --set grid.cell_size=5cm'),
        ("grid.cellsize=1", "the nearest known one is `grid.cell_size`, in --set"),
        ("grid={cell_size: 0}", "got 0 at `grid.cell_size` in --set grid={cell_size: 0}"),
        ("grid", "expected KEY=VALUE with a dotted key, got --set grid"),
        ("=1", "expected KEY=VALUE"),
        ("grid..margin=1", "expected KEY=VALUE"),
        ("scene.joints.=1", "expected KEY=VALUE"),
        ("levels.0.ground=1", "`levels` is no mapping"),
        ("grid.margin=[1", "line 1 of --set grid.margin=[1"),
    ],
)
def test_refuses_override(house, override, expected):
    assert expected in message(house(with_scene("levels: auto")), [override])


# ---------------------------------------------------------------- schema, digest, template


def test_schema_tells_unit_range_and_default_of_every_setting():
    for section in SECTIONS.values():
        for name, field in section.model_fields.items():
            if field.annotation not in SECTIONS.values():
                assert "default" in field.description, name
    schema = json.dumps(BakeConfig.model_json_schema())
    assert '"exclusiveMinimum": 0' in schema
    assert "edge of a cell [m], > 0; default 0.1" in schema


def test_every_default_passes_its_own_check():
    config = parse_config({"scene": {"path": "a.xml"}})
    assert parse_config(config.model_dump()) == config


@pytest.mark.parametrize("change", [{"output": "b.json"}, {"grid": {"max_cells": 9}}])
def test_digest_ignores_what_changes_no_cell(change):
    config = parse_config({"scene": {"path": "a.xml"}})
    assert settings_digest(parse_config({"scene": {"path": "a.xml"}, **change})) == (
        settings_digest(config)
    )


def test_digest_ignores_where_the_scene_lies_and_how_numbers_are_written():
    one = parse_config({"scene": {"path": "x/a.xml"}, "grid": {"margin": 1}})
    two = parse_config({"scene": {"path": "y/a.xml"}, "grid": {"margin": 1.0}})
    assert settings_digest(one) == settings_digest(two)


@pytest.mark.parametrize(
    "override",
    [
        "scene.id=b",
        "grid.cell_size=0.2",
        "agent.radius=0.3",
        "levels=[{ground: 0}]",
        "scene.up=y",
        "floors.movable=[bridge]",
    ],
)
def test_digest_sees_what_changes_cells(override):
    data = {"scene": {"path": "a.xml"}}
    config = parse_config(data, overrides=[override])
    assert settings_digest(config) != settings_digest(parse_config(data))


@pytest.mark.parametrize(
    "name", ["house.xml", "my house [2].xml", "1e5.xml", "true.xml", "ä'\"#: {.obj", "- a.xml"]
)
def test_template_is_exactly_the_defaults(tmp_path, name):
    (tmp_path / "scenes").mkdir()
    scene = tmp_path / "scenes" / name
    scene.touch()
    path = write_template(scene, tmp_path / "house.yaml")
    config = load_config(path)
    assert config.scene.path.samefile(scene)
    default = load_config(scene)
    moved = config.scene.model_copy(update={"path": scene})
    assert config.model_copy(update={"scene": moved}) == default


def test_template_comments_every_key(tmp_path):
    text = render_template(parse_config({"scene": {"path": "a.xml"}}))
    for section in SECTIONS:
        if section not in ("levels", "rooms.polygons", "agents", "areas", "links"):
            for key, field in SECTIONS[section].model_fields.items():
                assert f"{field.alias or key}:" in text
                assert field.description.split(";")[0][:30] in text
    plain = yaml.safe_load(text)  # any YAML reader reads it
    assert plain["grid"]["cell_size"] == 0.1


def test_template_holds_other_settings_too():
    data = {
        "scene": {"path": "a.xml", "meshes": {"w*": "hull"}, "joints": {"j": [1.0]}},
        "levels": [{"ground": 0.0, "name": "x: y"}],
        "rooms": {"from": ["polygons"], "polygons": [{"points": [[0, 0], [4, 0], [4, 3]]}]},
        "output": "o.json",
    }
    config = parse_config(data)
    assert parse_config(parse_yaml(render_template(config), "template")) == config


def test_template_overwrites_nothing_unasked(tmp_path):
    scene, path = tmp_path / "a.xml", tmp_path / "a.yaml"
    scene.touch()
    path.write_text("mine")
    with pytest.raises(ConfigError, match=r"a\.yaml exists; --force"):
        write_template(scene, path)
    assert path.read_text() == "mine"
    write_template(scene, path, force=True)
    assert load_config(path).scene.id == "a"


def test_template_needs_a_scene_and_a_yaml(tmp_path):
    with pytest.raises(SceneError, match=r"no such file: .*a\.xml"):
        write_template(tmp_path / "a.xml")
    (tmp_path / "a.yaml").touch()
    with pytest.raises(ConfigError, match=r"expected a scene, got .*a\.yaml"):
        write_template(tmp_path / "a.yaml")
    (tmp_path / "a.xml").touch()
    with pytest.raises(ConfigError, match=r"ends in \.yaml, got .*a\.txt"):
        write_template(tmp_path / "a.xml", tmp_path / "a.txt")
    with pytest.raises(ConfigError, match="cannot write"):
        write_template(tmp_path / "a.xml", tmp_path / "none" / "a.yaml")
