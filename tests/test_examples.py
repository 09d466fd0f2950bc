"""Each example runs as it stands, and prints what it is for."""

from __future__ import annotations

import os
import runpy
import subprocess
import sys

import pytest
from PIL import Image

from project_paths import ROOT

EXAMPLES = ROOT / "examples"
PRINTED = {
    "bake_and_look": ["level 1: 102 x 83 cells, ground 3.00 m", "['dining_table']"],
    "doors": ["door: joint hinge, modelled", "door 'door' (closed) is in the way", "open: 4.00 m"],
    "draw_in_mujoco": ["arrived after 1", " frames in film.gif"],
    "fly_through_a_house": [
        "cost of clearance 0 m: 11.08 m, 0.47 m from things",
        "no way for a radius of 0.6 m from island 1",
    ],
    "follow_a_path": ["arrived after ", " m from the person, contacts: 0"],
    "gymnasium_env": ["50 episodes, four at a time: ", "a step ahead is worth "],
    "larger_robot": [
        "radius 0.30 m: 16.2 m2 free, path of",
        "door 'door_bedroom' is closed for a radius of 0.4 m, and 0.35 m passes",
    ],
    "reach_a_mug": [
        "stand at 2.95, 2.75, face +2.06 rad, after 4.04 m",
        "through door_kitchen: 3.91 m",
        "no cell at 0.3 to 0.75 m from dining_lamp, measured from a shoulder",
    ],
    "spawn_and_plan": ["start at ", " m to room 1:1 through", "(50.00, 0.00, 0.00) lies beside"],
    "voxels_round_a_robot": ["in reach: beanbag, ", "apartment.bt: (200, 160, 52) voxels"],
}
NEEDS = {
    "fly_through_a_house": ("matplotlib",),
    "gymnasium_env": ("array_api_compat", "gymnasium"),
}
# in processes of their own, since MuJoCo chooses how it renders when it is imported
FILMS = ("draw_in_mujoco",)


def test_all_examples_are_here():
    assert sorted(PRINTED) == sorted(path.stem for path in EXAMPLES.glob("*.py"))


@pytest.mark.parametrize("name", FILMS)
def test_example_films(name, tmp_path):
    environment = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    command = [sys.executable, str(EXAMPLES / f"{name}.py")]
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    if any(word in done.stderr for word in ("gl_context", "OpenGL", "EGL", "GLFW", "FatalError")):
        pytest.skip(f"MuJoCo can't render here: {done.stderr.strip().splitlines()[-1]}")
    assert done.returncode == 0, done.stderr
    for text in PRINTED[name]:
        assert text in done.stdout
    with Image.open(tmp_path / "film.gif") as film:
        assert film.n_frames > 30


@pytest.mark.parametrize("name", [name for name in PRINTED if name not in FILMS])
def test_example_runs(name, tmp_path, monkeypatch, capsys):
    for package in NEEDS.get(name, ()):
        pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    copied = tmp_path / f"{name}.py"  # an example runs wherever it is copied to
    copied.write_bytes((EXAMPLES / copied.name).read_bytes())
    runpy.run_path(str(copied), run_name="__main__")
    printed = capsys.readouterr().out
    for text in PRINTED[name]:
        assert text in printed


@pytest.mark.parametrize("name", PRINTED)
def test_example_is_short_and_says_how_to_run_it(name):
    source = (EXAMPLES / f"{name}.py").read_text()
    assert len(source.splitlines()) <= 50
    assert f"python examples/{name}.py" in source
