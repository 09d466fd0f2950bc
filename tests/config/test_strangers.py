"""Settings from a stranger read the files that they name, and nothing else happens."""

import json
import subprocess
import sys

import pytest

import navbake

ROOM = '{"type": "Feature", "geometry": {"type": "Polygon", "coordinates": [[[0,0],[1,0],[1,1]]]}}'
SCENE = '<mujoco><worldbody><geom type="box" size="1 1 1"/></worldbody></mujoco>'
CASES = [  # settings, and what is said of them
    (
        "scene: {path: scene.xml, id: house}\nrooms: {polygons: rooms.geojson}\n"
        "output: /tmp/never-written.json\nagent: &a {height: 1.5}\n",
        "",
    ),
    ("scene: !!python/object/apply:os.system ['touch gone']", "python/object/apply"),
    ("scene: !!python/name:os.system ", "python/name"),
    ("scene: {path: scene.xml}\nagent: !include secret.yaml", "!include"),
    ("scene: {path: scene.xml, id: ../../gone}", "scene.id"),
    ("<<: secret.yaml\nscene: {path: scene.xml}", "unknown key"),
]
# Python reports (sys.addaudithook) what happens as settings are read and their scene is opened
WATCH = """
import json, os, pathlib, sys, tempfile
import trimesh
import navbake.baker.scene.scene as scene
from navbake.config.settings import load_config
from navbake.errors import NavbakeError

cases = json.load(sys.stdin)
LIBRARIES = tuple(map(os.path.realpath, (sys.prefix, sys.base_prefix, sys.argv[1], *sys.path[1:])))
AS_ALWAYS = ("object.", "sys._getframe", "import", "code.__new__", "compile", "exec", "os.listdir",
             "os.scandir", "marshal.", "ctypes.", "builtins.id", "gc.")
OWN = os.path.realpath(tempfile.gettempdir())  # MuJoCo's messages go by a file there
happened = None

def watch(event, arguments):
    if happened is None or event.startswith((*AS_ALWAYS, "tempfile.")):
        return
    if isinstance(arguments[0], str) and OWN in (arguments[0], os.path.dirname(arguments[0])):
        return
    if event == "open":
        name, mode, flags = arguments
        if isinstance(name, int) or os.path.realpath(name).startswith(LIBRARIES):
            return
        write = flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT) if isinstance(flags, int) else 0
        happened.append([os.path.basename(name), bool(write)])
    else:
        happened.append([event, repr(arguments)[:100]])

def use(path):
    try:
        scene.open_file(load_config(path).scene)
    except NavbakeError as refused:
        return str(refused)
    return ""

told = []
use("none.yaml")  # loads what is loaded lazily
sys.addaudithook(watch)
for number, settings in enumerate(cases):
    path = pathlib.Path(f"stranger-{number}.yaml")
    path.write_text(settings)
    happened = []
    error = use(path)
    told.append((happened, error))
    happened = None
print(json.dumps(told))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("strangers")
    (folder / "scene.xml").write_text(SCENE)
    (folder / "rooms.geojson").write_text(ROOM)
    (folder / "secret.yaml").write_text("agent: {height: 1.0}")
    return folder


@pytest.fixture(scope="module")
def told(folder):
    """What happened, and the error's message, of each case."""
    done = subprocess.run(
        [sys.executable, "-c", WATCH, next(iter(navbake.__path__))],
        input=json.dumps([settings for settings, _ in CASES]),
        cwd=folder, capture_output=True, text=True, timeout=120, check=True,
    )  # fmt: skip
    return json.loads(done.stdout.splitlines()[-1])


def test_what_they_name_is_read_and_nothing_is_written(told):
    happened, error = told[0]
    assert not error
    assert {name for name, _ in happened} <= {"stranger-0.yaml", "scene.xml", "rooms.geojson"}
    assert ["stranger-0.yaml", False] in happened and ["rooms.geojson", False] in happened
    assert not any(is_written for _, is_written in happened)  # no event but reading, either


@pytest.mark.parametrize("number", range(1, len(CASES)))
def test_nothing_else_happens(told, number):
    happened, error = told[number]
    assert CASES[number][1] in error
    assert happened == [[f"stranger-{number}.yaml", False]]


def test_no_file_is_left(told, folder):
    own = {"rooms.geojson", "scene.xml", "secret.yaml"}
    assert {path.name for path in folder.iterdir()} == own | {
        f"stranger-{number}.yaml" for number in range(len(CASES))
    }
