"""The commands `navbake init` and `navbake geoms`."""

import json

import pytest

from navbake.config.settings import load_config


def test_init_writes_settings_that_bake_the_same(folder, run):
    status, out, _ = run("init", "room.xml", "-o", "made.yaml")
    assert (status, out.startswith("made.yaml")) == (0, True)
    made = load_config("made.yaml")
    assert made.scene.path.samefile("room.xml")
    assert run("init", "room.xml", "-o", "made.yaml")[0] == 1
    assert run("init", "room.xml", "-o", "made.yaml", "--force")[0] == 0
    assert run("init", "room.xml")[0] == 1  # room.yaml is there
    assert run("init", "none.xml")[2] == "navbake: no such file: none.xml\n"


@pytest.mark.parametrize("config", ["room.xml", "room.yaml"])
def test_geoms(folder, run, config):
    status, out, _ = run("geoms", config)
    assert status == 0
    lines = {line.split()[1]: line for line in out.splitlines()[1:-1]}
    assert "wall [b]" in lines["wall"]  # no markup
    assert " yes " in lines["floor"]
    assert " no " in lines["shade"]
    assert out.splitlines()[-1] == "2 geoms counted, 1 left out"


def test_geoms_as_json(folder, run):
    status, out, _ = run("geoms", "room.yaml", "--json", "--set", "scene.geoms=all")
    assert status == 0
    facts = json.loads(out)
    assert facts["scene_id"] == "room"
    assert [geom["name"] for geom in facts["geoms"]] == ["floor", "wall [b]", "shade"]
    assert all(geom["counted"] for geom in facts["geoms"])
    assert set(facts["geoms"][0]) == {"id", "name", "body", "type", "counted", "shape", "reason"}
