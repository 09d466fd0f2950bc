"""The command `navbake fly`."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from PIL import Image

import navbake
from navbake.episodes import read_episodes

# out of the arena's box, over its wall and down again
OVER = ("--from", "0.75,-0.5,0.3", "--to", "0.75,1.4,0.7", "--radius", 0.1)


def test_writes_a_path_and_distances(arena, run):
    pytest.importorskip("matplotlib")
    files = ["a.json", "a.png", "a.npz"]
    status, out, err = run("fly", "arena.xml", *OVER, *(w for f in files for w in ("-o", f)))
    assert (status, err) == (0, "")
    lines = out.splitlines()
    assert lines[0].startswith("length  ") and lines[2].split() == ["x", "y", "z"]
    assert lines[3].split() == ["0.750", "-0.500", "0.300"] and lines[-3:] == files
    facts = json.loads((arena / "a.json").read_text())
    points = np.array(facts["positions"])
    assert points[-1].tolist() == [0.75, 1.4, 0.7]
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    assert facts["length"] == pytest.approx(length)
    picture = np.asarray(Image.open(io.BytesIO((arena / "a.png").read_bytes())).convert("RGB"))
    is_tube = (picture[..., 2] - picture[..., 0].astype(int)) > 60
    assert min(picture.shape[:2]) > 600 and is_tube.sum() > 500
    with np.load(arena / "a.npz") as archive:
        assert archive["is_signed"] and archive["distances"].min() < 0


def test_voxels_that_are_in_a_file_give_the_same_path(arena, run):
    run("voxelize", "arena.xml", "-o", "a.bt", "-o", "a.npz")
    inside = ("--from", "0.5,0.9,0.3", "--to", "1.3,1.7,0.3", "--radius", 0.08)
    status, out, _ = run("fly", "a.npz", *inside, "--json")
    facts = json.loads(out)
    assert status == 0 and facts["reason"] is None
    from_scene = json.loads(run("fly", "arena.xml", *inside, "--margin", 0, "--json")[1])
    assert from_scene["path"] == facts["path"]
    # an octree does not say what is free, unless it is asked to
    status, out, _ = run("fly", "a.bt", *inside)
    assert status == 1 and "unknown" in out
    status, out, _ = run("fly", "a.bt", *inside, "--unknown", "free", "--json")
    assert json.loads(out)["path"] == facts["path"]


def test_says_why_there_is_no_path_and_exits_with_1(arena, run):
    status, out, err = run("fly", "arena.xml", *OVER[:-1], 0.6, "-o", "a.json", "-o", "a.npz")
    assert (status, err) == (1, "")
    assert out.startswith("no path: the start (0.75, -0.5, 0.3) is")
    assert not (arena / "a.json").exists() and (arena / "a.npz").exists()
    status, out, _ = run("fly", "arena.xml", *OVER, "--max-height", -5, "--json")
    assert status == 1 and "fits nowhere" in json.loads(out)["reason"]


@pytest.mark.parametrize(
    ("words", "status", "text"),
    [
        (("--from", "1,2", "--to", "1,2,1", "--radius", 0.1), 2, "expected X,Y,Z"),
        ((*OVER[:-1], -1), 1, "expected `radius` > 0 m, got -1.0"),
        ((*OVER, "-o", "a.txt"), 2, "expected a name that ends in .json, .png, .mcap, .npz"),
        ((*OVER, "-o", "-"), 2, "its ending says which format"),
        ((*OVER, "--res", 0), 1, "expected `res`"),
        ((*OVER, "--episodes", 3, "-o", "a.jsonl"), 2, "it is for one path, not for --episodes"),
        (("--radius", 0.1), 2, "expected --from X,Y,Z, or --episodes N"),
        (("--radius", 0.1, "--episodes", 3), 2, "expected one file for the episodes"),
        (("--radius", 0.1, "--episodes", 3, "-o", "a.json"), 2, "a name that ends in .jsonl"),
        (("--radius", 0.1, "--episodes", 0, "-o", "a.jsonl"), 2, "expected a number >= 1"),
        ((*OVER, "--seed", 3), 2, "it is for --episodes"),
        (
            ("--radius", 0.1, "--episodes", 3, "-o", "a.jsonl", "--rule", "far=1"),
            1,
            "no rule 'far' of flights",
        ),
    ],
)
def test_wrong_words_are_told_in_a_line(arena, run, words, status, text):
    answer = run("fly", "arena.xml", *words)
    assert answer[0] == status and text in answer[2]


def test_options_of_scenes_do_nothing_for_voxels(arena, run):
    navbake.create_voxel_grid(arena / "arena.xml", of="a.npz")
    status, _, err = run("fly", "a.npz", *OVER, "--margin", 1)
    assert status == 2 and "does nothing here" in err


@pytest.mark.parametrize(
    "files", [("a.png",), ("a.png", "a.json"), ("a.npz", "a.mcap", "a.png")], ids=" ".join
)
def test_json_lists_each_file_once(arena, run, files):
    pytest.importorskip("matplotlib")
    if "a.mcap" in files:
        pytest.importorskip("mcap")
    words = [word for file in files for word in ("-o", file)]
    status, out, _ = run("fly", "arena.xml", *OVER, "--json", *words)
    assert status == 0 and json.loads(out)["files"] == list(files)


@pytest.mark.parametrize("goal", ["object:mug", "room:0:1", "1,1", "1,1,L0", "mug"])
def test_goals_of_paths_on_grids_are_told_what_a_flight_takes(arena, run, goal):
    status, _, err = run("fly", "arena.xml", "--from", "0,0,1", "--to", goal, "--radius", 0.1)
    assert status == 2 and f"expected X,Y,Z as in 1.5,-2,1.2, got {goal!r}" in err
    assert "room:NAME" not in err and "1.5,-2,L1" not in err


def test_a_margin_makes_room_for_a_flight_round_the_outside(tmp_path, monkeypatch, run):
    """A roof over a wall with a way out on both sides, none through."""
    (tmp_path / "wall.xml").write_text("""<mujoco><worldbody>
  <geom type="box" size="1 1 .1" pos="0 0 -.1"/> <geom type="box" size="1 1 .1" pos="0 0 1.1"/>
  <geom type="box" size=".1 1 .5" pos="0 0 .5"/>
</worldbody></mujoco>""")
    monkeypatch.chdir(tmp_path)
    words = ("wall.xml", "--from", "-.6,0,.5", "--to", ".6,0,.5", "--radius", 0.2)
    status, out, _ = run("fly", *words, "--margin", 0.2)
    assert status == 1 and out.startswith("no path: no way for a radius of 0.2 m")
    assert run("fly", *words, "--margin", 0.5)[0] == 0


def test_an_open_door_lets_a_flight_through(tmp_path, monkeypatch, run):
    """A box of walls and a roof, whose one door is closed in the file."""
    (tmp_path / "hut.xml").write_text("""<mujoco><compiler angle="radian"/><worldbody>
  <geom type="box" size="1 1 .1" pos="0 0 -.1"/> <geom type="box" size="1 1 .1" pos="0 0 2.1"/>
  <geom type="box" size=".1 1 1" pos="-.9 0 1"/> <geom type="box" size=".1 1 1" pos=".9 0 1"/>
  <geom type="box" size="1 .1 1" pos="0 .9 1"/>
  <body pos="-.8 -.95 1">
    <joint name="hinge" axis="0 0 1"/> <geom type="box" size=".8 .05 1" pos=".8 0 0"/>
  </body>
</worldbody></mujoco>""")
    monkeypatch.chdir(tmp_path)
    words = ("hut.xml", "--from", "0,0,1", "--to", "0.2,-1.6,1", "--radius", 0.2)
    assert run("fly", *words)[0] == 1
    assert run("fly", *words, "--set", "scene.joints.hinge=-1.57")[0] == 0


def test_episodes_are_drawn_in_voxels_and_scored(arena, run):
    run("voxelize", "arena.xml", "-o", "a.npz", "--res", 0.05)
    words = ("fly", "a.npz", "--radius", 0.05, "--episodes", 12, "--seed", 3, "-o", "set.jsonl")
    status, out, err = run(*words, "--rule", "min_distance=0.4", "--rule", "reach=0.1")
    assert (status, err) == (0, "") and out.startswith("set.jsonl: 12 episodes, ")
    content = read_episodes("set.jsonl")
    assert content.header.grids[0].file == "a.npz" and content.header.seed == 3
    assert {episode.scene for episode in content.episodes} == {"a"}
    assert min(episode.distance for episode in content.episodes) >= 0.4
    lines = [{"episode": e.id, "positions": e.path} for e in content.episodes]
    lines[0] = {"episode": "0", "positions": []}  # never took off
    (arena / "runs.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    for voxels in ((), ("a.npz",)):
        status, out, _ = run("score", "set.jsonl", "runs.jsonl", *voxels, "--json")
        [group] = json.loads(out)["groups"]
        assert status == 0 and group["success"]["mean"] == pytest.approx(11 / 12)
        assert group["spl"]["mean"] == pytest.approx(11 / 12) and group["collisions"]["mean"] == 0
    run("voxelize", "arena.xml", "-o", "b.npz", "--res", 0.1)
    status, _, err = run("score", "set.jsonl", "runs.jsonl", "b.npz")
    assert status == 1 and "the set was made in other voxels" in err


def test_episodes_in_a_scene_name_no_voxels_and_few_are_told(arena, run):
    words = ("fly", "arena.xml", "--radius", 0.1, "--episodes", 3, "-o", "set.jsonl")
    assert run(*words)[0] == 0
    (arena / "runs.jsonl").write_text('{"episode": "0", "positions": []}\n')
    status, _, err = run("score", "set.jsonl", "runs.jsonl", "--partial")
    assert status == 1 and "expected the voxels of set.jsonl, which names none" in err
    status, _, err = run(*words, "--rule", "min_distance=100")
    assert status == 1 and "no flight in 'arena' keeps the rules: " in err
