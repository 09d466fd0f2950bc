"""Bad input: each with one clear line that names the culprit, and nothing written."""

from __future__ import annotations

import os
import re
import resource
import subprocess
import sys
from pathlib import Path

import mujoco
import pytest
import trimesh

import navbake
from navbake.baker.bake.pipeline import run_bake
from navbake.baker.scene.model import load_model
from navbake.cli.main import main
from navbake.config.settings import SceneSettings, load_config, parse_config
from navbake.errors import ConfigError, NavbakeError, SceneError
from project_paths import ROOT

ROOM = """<mujoco><worldbody>
  <geom name="floor" type="box" size="3 2 .1" pos="0 0 -.1"/>
  <geom name="wall" type="box" size=".1 2 1" pos="1 0 1"/>
</worldbody></mujoco>"""
BOX = trimesh.creation.box(extents=[4, 4, 1])
FLOOR = '<geom type="plane" size="3 3 1"/>'
CEILING = '<geom type="plane" size="3 3 1" pos="0 0 1.1" euler="180 0 0"/>'
BOMB = (
    '<!DOCTYPE m [<!ENTITY a "aaaaaaaaaa">'
    + "".join(
        f'<!ENTITY {name} "{f"&{before};" * 10}">'
        for before, name in zip("abcdefghij", "bcdefghijk", strict=True)
    )
    + "]>"
)


def world(geoms):
    return f"<mujoco><worldbody>{geoms}</worldbody></mujoco>"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def fails(folder, capfd):
    """Returns a function that bakes what must fail, in both ways; the line it says."""

    def call(*arguments, **settings):
        before = sorted(folder.rglob("*"))
        with pytest.raises(SystemExit) as caught:
            main(["bake", *map(str, arguments)])
        out, err = capfd.readouterr()
        err = re.sub(r"^navbake: compiling for this machine, once: .*\n", "", err)  # the first ever
        assert (caught.value.code, out) == (1, "")
        assert err.startswith("navbake: ")
        assert err.endswith("\n")
        assert err.count("\n") == 1
        assert sorted(folder.rglob("*")) == before
        if settings:
            with pytest.raises(NavbakeError) as raised:
                run_bake(parse_config(settings))
            assert f"navbake: {raised.value}\n" == err
            assert sorted(folder.rglob("*")) == before
        return err

    return call


def write(path, content):
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


# ---------------------------------------------------------------- files


@pytest.mark.parametrize(
    "name", ["none.xml", "none/none.xml", "none.obj", "none.mjb", "none.urdf", "room.xml/none.xml"]
)
def test_missing_file(fails, name):
    write("room.xml", ROOM)
    assert f"no scene file at {name}" in fails(name, scene={"path": name})


def test_the_settings_and_a_near_file_are_named_for_a_scene_that_is_missing(fails, tmp_path):
    (tmp_path / "scenes").mkdir()
    write("scenes/twins.xml", ROOM)
    write("scenes/twins.txt", "")
    Path("twinz.yaml").write_text("scene: {path: scenes/twinz.xml}")
    told = (
        "no scene file at scenes/twinz.xml (`scene.path` in twinz.yaml): "
        "did you mean scenes/twins.xml?"
    )
    assert told in fails("twinz.yaml")
    for scene in ("twinz.yaml", Path("twinz.yaml")):
        with pytest.raises(navbake.SceneError, match=f"^{re.escape(told)}$") as caught:
            navbake.bake(scene, grid={"cell_size": 0.2})
        assert (caught.value.key, caught.value.path) == ("scene.path", "scenes/twinz.xml")
    # the same name with another ending
    assert "no scene file at scenes/twins.obj: did you mean scenes/twins.xml?" in fails(
        "scenes/twins.obj"
    )


def test_settings_are_named_only_for_a_scene_that_they_name(fails):
    write("room.yaml", "scene: {path: room.xml}")
    write("room.xml", ROOM)
    told = "no scene file at nix.xml"
    assert fails("room.yaml", "--set", "scene.path=nix.xml") == f"navbake: {told}\n"
    for bake in (
        lambda: navbake.bake("room.yaml", scene={"path": "nix.xml"}),
        lambda: navbake.bake(load_config("room.yaml", ["scene.path=nix.xml"])),
    ):
        with pytest.raises(SceneError, match=f"^{told}$"):
            bake()


def test_a_scene_that_went_missing_is_no_device(folder):
    with pytest.raises(SceneError, match=r"^no scene file at none\.xml$"):
        load_model(SceneSettings(path="none.xml"), [])


def test_a_name_that_is_too_long(fails):
    name = "x" * 300 + ".xml"
    assert f"cannot read {name}: File name too long" in fails(name, "--set", "scene.id=room")


@pytest.mark.parametrize("name", ["room.xml", "room.obj", "room.glb", "room.mjb"])
def test_a_folder(fails, folder, name):
    (folder / name).mkdir()
    assert f"got a folder at {name}" in fails(name, scene={"path": name})


def test_a_device(fails, folder):
    os.mkfifo(folder / "pipe.xml")
    assert "got a device at pipe.xml" in fails("pipe.xml", scene={"path": "pipe.xml"})


@pytest.mark.parametrize("name", ["room.txt", "room", "room.blend"])
def test_an_unknown_format(fails, folder, name):
    write(name, ROOM)
    err = fails(name, scene={"path": name})
    assert f"cannot tell what {name} is: expected one of .building.yaml, " in err


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read anything")
def test_a_file_that_may_not_be_read(fails, folder):
    write("room.xml", ROOM).chmod(0)
    assert "room.xml" in fails("room.xml", scene={"path": "room.xml"})


SUFFIXES = ["xml", "mjcf", "urdf", "mjb", "obj", "ply", "stl", "glb", "gltf", "dae"]
JUNK = bytes(range(256)) * 40


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("content", [b"", b"\n", b"hello world\n", JUNK, b"\0" * 5000])
def test_empty_files_and_junk(fails, folder, suffix, content):
    name = f"room.{suffix}"
    write(name, content)
    assert name in fails(name, scene={"path": name})


# ---------------------------------------------------------------- XML


@pytest.mark.parametrize(
    ("text", "culprit"),
    [
        (ROOM[:-20], "broken XML in room.xml"),
        (ROOM.replace("<geom", "<goem"), "unrecognized element; Element 'goem', line 2"),
        (ROOM.replace("type=", "tpye="), "unrecognized attribute"),
        (ROOM.replace('"3 2 .1"', '"3 2 x"'), "room.xml"),
        (ROOM.replace('"3 2 .1"', '"3 0 .1"'), "size 1 must be positive in geom"),
        ("<sdf/>", "expected <mujoco> or <robot> in room.xml, got <sdf>"),
        ("<html><body/></html>", "got <html>"),
        ("<mujoco/>", "room.xml has no geoms: nothing to bake"),
        ("<mujoco><worldbody><body/></worldbody></mujoco>", "room.xml has no geoms"),
        (f"{BOMB}<mujoco model='&k;'/>", "room.xml"),
        (f"{BOMB}<mujoco>&k;</mujoco>", "room.xml"),
        (f"{BOMB}<robot>&k;</robot>", "room.xml"),
        ("<mujoco>" * 100_000, "room.xml"),
        ("<robot>" + "<link>" * 100_000, "room.xml"),
        (world("<body>" * 3000 + "</body>" * 3000), "nesting is too deep"),
        ('<mujoco><include file="room.xml"/></mujoco>', "'room.xml' already included"),
        ('<mujoco><include file="a.xml"/></mujoco>', "already included"),
        ('<mujoco><include file="none.xml"/></mujoco>', "Error opening file 'none.xml'"),
        ('<mujoco><include file="junk.xml"/></mujoco>', "Include error"),
        ('<mujoco><asset><mesh file="none.stl"/></asset></mujoco>', "'none.stl'"),
        ('<mujoco><asset><mesh file="junk.stl"/></asset></mujoco>', "'junk.stl'"),
        ('<mujoco><asset><mesh file="junk.obj"/></asset></mujoco>', "room.xml"),
        ('<mujoco><asset><mesh name="m" file="junk.dae"/></asset></mujoco>', "'junk.dae'"),
        ('<mujoco><asset><texture type="2d" file="junk.png"/></asset></mujoco>', "'junk.png'"),
        ('<mujoco><asset><hfield size="1 1 1 1" file="junk.bin"/></asset></mujoco>', "'junk.bin'"),
        ('<mujoco><size memory="999999G"/></mujoco>', "Could not allocate memory"),
    ],
)  # fmt: skip
def test_broken_xml(fails, folder, text, culprit):
    for name in ("junk.xml", "junk.stl", "junk.obj", "junk.dae", "junk.png", "junk.bin"):
        write(name, JUNK)
    write("a.xml", '<mujoco><include file="room.xml"/></mujoco>')
    write("room.xml", text)
    assert culprit in fails("room.xml", scene={"path": "room.xml"})


def test_numbers_that_are_none(fails, folder):
    write("room.xml", ROOM.replace('pos="1 0 1"', 'pos="nan 0 1"'))
    err = fails("room.xml", scene={"path": "room.xml"})
    assert (
        "geom 'wall' has a pose or size that is no number, or beyond 1e+100 m, in room.xml" in err
    )


# ---------------------------------------------------------------- MJB and meshes


def saved_model(folder):
    model = mujoco.MjModel.from_xml_string(ROOM)
    mujoco.mj_saveModel(model, str(folder / "good.mjb"))
    data = (folder / "good.mjb").read_bytes()
    (folder / "good.mjb").unlink()
    return data


@pytest.mark.parametrize(
    ("change", "culprit"),
    [
        (lambda data: data[:10], "incomplete header"),
        (lambda data: data[: len(data) // 2], "ran out of data"),
        (lambda data: data[:-8], "ran out of data"),
        (lambda data: data + b"more", "too large"),
        (lambda data: b"\1" + data[1:], "header ID"),
        (lambda data: data[:8] + bytes([data[8] ^ 1]) + data[9:], "different number of sizes"),
        (lambda data: data[:12] + bytes(4) + data[16:], "room.mjb"),
    ],
)
def test_broken_mjb(fails, folder, change, culprit):
    write("room.mjb", change(saved_model(folder)))
    err = fails("room.mjb", scene={"path": "room.mjb"})
    assert culprit in err
    assert f"an MJB fits only the MuJoCo that wrote it, this is {mujoco.__version__}" in err


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "glb", "dae"])
def test_meshes_cut_off(fails, folder, suffix, share):
    data = BOX.export(file_type=suffix)
    data = data if isinstance(data, bytes) else data.encode()
    if suffix == "obj":  # a text that ends early is still an OBJ, but not in the middle of a line
        data = data[: data.index(b"f ") + 5]
        share = 1.0
    name = f"box.{suffix}"
    write(name, data[: int(len(data) * share)])
    assert name in fails(name, scene={"path": name})


def test_a_mesh_of_points(fails, folder):
    write("box.obj", "v 0 0 0\nv 1 0 0\n")
    text = fails("box.obj", scene={"path": "box.obj"})
    assert "box.obj holds points without triangles" in text


# ---------------------------------------------------------------- nothing to stand on


@pytest.mark.parametrize(
    ("geoms", "reason"),
    [
        ('<geom type="plane" size="3 3 1" euler="180 0 0"/>', "faces up within 45°"),
        ('<geom type="plane" size="3 3 1" euler="80 0 0"/>', "faces up within 45°"),
        (f"{FLOOR}{CEILING}", "1.14 m of headroom"),
        ('<geom type="box" size=".2 .2 .4"/>', "less than 1 m² after shrinking"),
        ('<geom type="sphere" size="1"/>', "less than 1 m² after shrinking"),
    ],
)
def test_no_floor(fails, folder, geoms, reason):
    write("room.xml", world(geoms))
    err = fails("room.xml", scene={"path": "room.xml"})
    assert err.startswith("navbake: room.xml: no floor")
    assert reason in err


def test_endless_ground_needs_bounds(fails, folder):
    write("room.xml", world('<geom type="plane" size="0 0 1"/>'))
    err = fails("room.xml", scene={"path": "room.xml"})
    assert "`grid.bounds`" in err
    assert "room.xml" in err


# ---------------------------------------------------------------- settings


@pytest.mark.parametrize(
    ("override", "culprit"),
    [
        ("grid.cell_size=0", "expected a number > 0, got 0 at `grid.cell_size`"),
        ("grid.cell_size=-0.1", "got -0.1 at `grid.cell_size`"),
        ("grid.cell_size=.nan", "`grid.cell_size`"),
        ("grid.cell_size=.inf", "`grid.cell_size`"),
        ("grid.cell_size=5cm", "`grid.cell_size`"),
        ("grid.cell_size=null", "`grid.cell_size`"),
        ("grid.cell_size=1e-9", "MuJoCo's unit is the metre: check the lengths"),
        ("grid.cell_size=1e-300", "`grid.max_cells`"),
        ("grid.max_cells=10", "`grid.max_cells` = 10"),
        ("grid.margin=1e9", "`grid.max_cells`"),
        ("grid.bounds=[100,100,110,110]", "floor"),
        ("grid.bounds=[0,0,1e12,1e12]", "`grid.max_cells`"),
        ("grid.bounds=[0,0,0,1]", "`grid.bounds`"),
        ("grid.cellsize=1", "`grid.cell_size`"),
        ("scene.geom=all", "`scene.geoms`"),
        ("scene.geoms=some", "`scene.geoms`"),
        ("scene.geoms=visual", ""),
        ("scene.keyframe=home", "no keyframe 'home'"),
        ("scene.keyframe=0", "no keyframe 0"),
        ("scene.joints={hinge: 1}", "no joint 'hinge'"),
        ("scene.exclude.geoms=['*']", "none of the 2 geoms of room.xml counts"),
        ("agent.height=-1", "`agent.height`"),
        ("agent.radius=wide", "`agent.radius`"),
        ("levels=[{ground: 100}]", "100"),
        ("levels=[{ground: -50, top: -40}]", "-50"),
        ("levels=[]", "`levels`"),
    ],
)
def test_settings(fails, folder, override, culprit):
    write("room.xml", ROOM)
    if override == "scene.geoms=visual":
        override = "scene.exclude={geoms: [floor, wall]}"
    err = fails("room.xml", "--set", override)
    assert culprit in err


def test_a_unit_with_a_typo(fails, folder):
    BOX.export("house.obj")
    err = fails("house.obj", "--set", "scene.unit=1000")
    assert "house.obj" in err or "`scene.unit`" in err
    assert "4000 x 4000 m at `grid.cell_size` = 0.1 m" in err
    assert "`scene.unit`" in fails("house.obj", "--set", "scene.unit=1e12")


# ---------------------------------------------------------------- output


@pytest.mark.parametrize(
    ("output", "culprit"),
    [
        ("none/grid.json", "none/grid.json"),
        ("room.xml/grid.json", "room.xml/grid.json"),
        ("/dev/null/grid.json", "/dev/null/grid.json"),
        ("/proc/grid.json", "/proc/grid.json"),
        ("grids/grid.json", "grids/grid.json"),
        ("x" * 300 + ".json", "x" * 300),
        ("room.xml", "room.xml"),
    ],
)
def test_unwritable_output(fails, folder, output, culprit):
    write("room.xml", ROOM)
    (folder / "grids/grid.json").mkdir(parents=True)
    for arguments in (["-o", output], ["--set", f"output={output}"]):
        if output == "grids/grid.json" and arguments[0] == "-o":
            continue  # a folder to write into
        assert culprit in fails("room.xml", *arguments)


# ---------------------------------------------------------------- in a process of its own


def run(folder, *arguments, memory=None):
    def limit():
        if memory is not None:
            resource.setrlimit(resource.RLIMIT_AS, (memory, memory))

    command = [sys.executable, "-m", "navbake", *arguments]
    here = str(ROOT)
    return subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": here},
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=limit,
    )


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("room.mjb", b"junk"),
        ("room.xml", ROOM.replace("3 2", "nan 2")),
        ("room.xml", f"{BOMB}<robot>&k;</robot>"),
        ("room.stl", JUNK),
    ],
)
def test_one_line_and_no_log_left_behind(tmp_path, name, content):
    write(tmp_path / name, content)
    done = run(tmp_path, "bake", name, memory=8 << 30)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("navbake: ")
    assert done.stderr.count("\n") == 1
    assert name in done.stderr
    assert os.listdir(tmp_path) == [name]  # no MUJOCO_LOG.TXT


def test_no_floor_tells_where_the_scene_is(tmp_path):
    path = tmp_path / "far.xml"
    path.write_text('<mujoco><worldbody><geom type="box" size="2 3 .1"/></worldbody></mujoco>')
    settings = {"scene": {"path": str(path)}, "grid": {"bounds": [10, 10, 12, 12]}}
    with pytest.raises(
        SceneError, match=r"the scene spans, in m, x -2 to 2, y -3 to 3, z -0.1 to 0.1"
    ):
        run_bake(parse_config(settings))


def test_no_floor_in_a_scene_of_another_unit_begins_with_the_unit(tmp_path):
    path = tmp_path / "small.xml"
    path.write_text(
        '<mujoco><worldbody><geom type="box" size=".04 .03 .001"/></worldbody></mujoco>'
    )
    settings = {"scene": {"path": str(path)}, "grid": {"cell_size": 0.01}}
    with pytest.raises(SceneError, match=r"no floor: the scene is only 0.08 m large: ") as error:
        run_bake(parse_config(settings))
    assert str(error.value).count("only 0.08 m large") == 1


def test_no_floor_beside_an_endless_plane_tells_of_the_margin(tmp_path):
    path = tmp_path / "plane.xml"
    path.write_text(
        '<mujoco><worldbody><geom name="ground" type="plane" size="0 0 1"/>'
        '<geom type="box" size=".4 .4 .4" pos="0 0 .4"/></worldbody></mujoco>'
    )
    with pytest.raises(
        SceneError, match=r"no floor: if .* 'ground', which is endless, `grid.margin=5`"
    ):
        run_bake(parse_config({"scene": {"path": str(path)}}))


def test_xml_text_in_place_of_a_file():
    with pytest.raises(ConfigError, match=r"got XML text: `mujoco.MjSpec.from_string`"):
        navbake.bake("\n<mujoco/>")
