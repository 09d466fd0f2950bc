"""The commands `episodes` and `score`."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import pytest

from grid_maps import level_from
from navbake import PathFinder, load
from navbake.episodes import Episode, EpisodeSet, Goal, Header, read_episodes, write_episodes
from project_paths import GOLDEN


@pytest.fixture(autouse=True)
def house(tmp_path, monkeypatch):
    """The current folder, with a house in it."""
    shutil.copy(GOLDEN / "house.grid.json.gz", tmp_path / "house.json.gz")
    monkeypatch.chdir(tmp_path)


def drive(name="set.jsonl"):
    """The follower's trajectories: the shortest paths."""
    content, finder = read_episodes(name), PathFinder(load("house.json.gz"))
    lines = []
    for e in content.episodes:
        places = [view.position for goal in e.goals for view in goal.view_points]
        path = finder.find_path(e.start, places or e.goals[0].position)
        lines.append({"episode": e.id, "positions": path.positions.tolist()})
    Path("runs.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))


def test_a_set_is_made_and_scored(run):
    args = ("episodes", "house.json.gz", "-o", "set.jsonl", "--count", "20", "--seed", "4")
    status, out, err = run(*args, "--sampler", "habitat", "--rule", "max_distance=12")
    assert (status, err) == (0, "") and "20 episodes" in out and "too far" in out
    content = read_episodes("set.jsonl")
    assert len(content) == 20 and content.header.sampler["rules"]["max_distance"] == 12.0
    assert content.header.grids[0].file == "house.json.gz"
    drive()
    status, out, err = run("score", "set.jsonl", "runs.jsonl", "-o", "scores.csv")
    assert (status, err) == (0, "") and "all: 20 episodes" in out
    with open("scores.csv") as file:
        rows = list(csv.DictReader(file))
    assert [row["episode"] for row in rows] == [e.id for e in content.episodes]
    assert {row["success"] for row in rows} == {"1.0"} and rows[0]["time"] == ""
    status, out, err = run("score", "set.jsonl", "runs.jsonl", "-o", "-")
    assert status == 0 and "all: 20 episodes" in err
    assert out.encode() == Path("scores.csv").read_bytes()
    status, out, _ = run("score", "set.jsonl", "runs.jsonl", "house.json.gz", "--json")
    (found,) = json.loads(out)["groups"]
    assert found["spl"]["mean"] > 0.95 and found["time"]["mean"] is None


def test_a_set_with_other_doors_is_scored_with_them(run):
    args = ("episodes", "house.json.gz", "-o", "set.jsonl", "--count", "4")
    assert run(*args, "--doors", "closed")[0] == 0
    closed = load("house.json.gz").with_doors("closed")
    read_episodes("set.jsonl").check_grid(closed)
    content = read_episodes("set.jsonl")
    finder = PathFinder(closed)
    lines = []
    for episode in content.episodes:
        path = finder.find_path(episode.start, episode.goals[0].position)
        lines.append({"episode": episode.id, "positions": path.positions.tolist()})
    Path("runs.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    status, _, err = run("score", "set.jsonl", "runs.jsonl")
    assert status == 1 and "another grid" in err
    status, out, _ = run("score", "set.jsonl", "runs.jsonl", "--doors", "closed")
    assert status == 0 and "4 episodes" in out


def test_objects_are_reached_by_poses_and_scored_with_headings(run):
    args = ("episodes", "house.json.gz", "-o", "set.jsonl", "--task", "reach", "--radius", "0.2")
    size = ("--reach", "0.25,0.9", "--footprint", "0.5,0.3")
    status, out, err = run(*args, *size, "--count", "12")
    assert (status, err) == (0, "") and "12 episodes" in out
    content = read_episodes("set.jsonl")
    stance = content.episodes[0].goals[0].stance
    assert stance.reach == (0.25, 0.9) and set(map(len, stance.footprint)) == {2}
    lines = []
    for number, e in enumerate(content.episodes):
        view = e.goals[-1].view_points[-1]
        turn = 3.0 if number < 6 else 0.0
        lines.append(
            {"episode": e.id, "positions": [view.position], "headings": [view.heading + turn]}
        )
    Path("runs.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    status, _, err = run("score", "set.jsonl", "runs.jsonl", "-o", "scores.csv")
    assert (status, err) == (0, "")
    with open("scores.csv") as file:
        successes = [row["success"] for row in csv.DictReader(file)]
    assert successes == ["0.0"] * 6 + ["1.0"] * 6
    for options, message in (
        (("--reach", "0.5"), "--reach: expected two lengths in metres as in 0.3,0.8"),
        (("--task", "point", "--footprint", "1,1"), "--footprint: does nothing here"),
        (("--task", "point", "--reach", "-1"), "--reach: expected a length in metres as in 0.5"),
        (("--task", "point", "--reach", "near"), "--reach: expected a length in metres as in 0.5"),
    ):
        status, _, err = run(*args, *options)
        assert status == 2 and message in err


def test_options_that_the_task_does_not_read_are_refused(run):
    args = ("episodes", "house.json.gz", "-o", "refused.jsonl", "--count", "2")
    for task, option, value in (
        ("point", "--object", "bed_1"),
        ("room", "--object", "bed_1"),
        ("point", "--room", "0:1"),
        ("reach", "--room", "0:1"),
        ("explore", "--categories", "categories.yaml"),
        ("object", "--of", "room"),
        ("point", "--length", "3"),
        ("point", "--share", "0.9"),
        ("point", "--split-by", "scene"),
    ):
        status, _, err = run(*args, "--task", task, option, value)
        assert status == 2 and f"{option}: does nothing here" in err, (task, option)
    assert not Path("refused.jsonl").exists()
    assert (
        run(*args, "--task", "sequence", "--of", "room", "--room", "0:*", "--length", "2")[0] == 0
    )
    goals = read_episodes("refused.jsonl").episodes[0].goals
    assert len(goals) == 2 and all(goal.room.startswith("0:") for goal in goals)


def test_objects_by_a_file_of_categories_and_splits(run):
    Path("categories.yaml").write_text("seat: [chair*, sofa*]\ntable: '*table*'\n")
    args = ("episodes", "house.json.gz", "-o", "set.jsonl.gz", "--task", "object", "-q")
    split = ("--split", "train=2", "--split", "val=1", "--split-by", "room")
    status, out, err = run(*args, "--per-scene", "30", *split, "--categories", "categories.yaml")
    if status:
        assert "no object of category" in err
        pytest.skip("the house has no such objects")
    content = read_episodes("set.jsonl.gz")
    assert {e.split for e in content.episodes} <= {"train", "val"}
    assert {e.goals[0].category for e in content.episodes} <= {"seat", "table"}
    assert (status, out, err) == (0, "", "")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--rule", "min_dist=1"), "no rule 'min_dist' of a sampler: did you mean 'min_distance'?"),
        (("--split", "train=0"), "shares"),
        (("--categories", "none.yaml", "--task", "object"), "no such file: none.yaml"),
        (("--task", "object", "--object", "unicorn"), "no object 'unicorn' in 'house'"),
        (("--height", "9"), "agents up to"),
    ],
)
def test_wrong_options_are_one_line(run, arguments, message):
    status, _, err = run("episodes", "house.json.gz", "-o", "set.jsonl", *arguments)
    assert status == 1 and message in err and err.count("\n") == 1
    assert not Path("set.jsonl").exists()


@pytest.mark.parametrize("given", [("--split", "train"), ("--rule", "paths")])
def test_pairs_need_both_parts(run, given):
    status, _, err = run("episodes", "house.json.gz", "-o", "set.jsonl", *given)
    assert status == 2 and given[0] in err and f"got '{given[1]}'" in err


def test_sets_are_converted(run):
    args = ("episodes", "house.json.gz", "-o", "set.jsonl", "--count", "5", "-q")
    assert run(*args, "--sampler", "minos")[0] == 0
    status, out, err = run("convert", "set.jsonl", "a.json.gz", "--scene", "house=x/house.glb")
    assert (status, out, err) == (0, "a.json.gz\n", "")
    assert run("convert", "a.json.gz", "b.jsonl", "--scene", "house=x/house.glb", "-q")[0] == 0
    assert Path("b.jsonl").read_bytes().count(b'"scene":"house"') == 1 + 5
    status, _, err = run("convert", "a.json.gz", "o.jsonl", "--scene", "house=WRONG")
    assert status == 1 and "house=WRONG fits no scene of a.json.gz" in err and "x/house.glb" in err
    # one list of scenes may serve files that have one of them each
    scenes = ("--scene", "house=x/house.glb", "--scene", "flat=x/flat.glb", "-q")
    assert run("convert", "a.json.gz", "e.jsonl", *scenes)[0] == 0
    assert Path("e.jsonl").read_bytes() == Path("b.jsonl").read_bytes()
    status, _, err = run("convert", "a.json.gz", "c.csv", "--to", "minos")
    assert status == 0 and "c.csv doesn't hold: agent, path" in err
    assert run("convert", "c.csv", "d.json", "--to", "habitat-vln")[2].count("needs paths") == 1
    for wrong in (
        ("set.jsonl", "o.json", "--level", "0"),
        ("house.json.gz", "o.npz", "--scene", "a=b"),
    ):
        status, _, err = run("convert", *wrong)
        assert status == 2 and "does nothing here" in err


def test_scenes_are_named_by_a_template(run):
    shutil.copy(GOLDEN / "tower.grid.json.gz", "tower.json.gz")
    args = ("episodes", "house.json.gz", "tower.json.gz", "-o", "set.jsonl", "--count", "6", "-q")
    assert run(*args)[0] == 0
    template = ("--scene", "{id}=data/{id}/it.glb")
    status, out, err = run("convert", "set.jsonl", "a.json.gz", *template)
    assert (status, out, err) == (0, "a.json.gz\n", "")
    names = {e.scene for e in read_episodes("a.json.gz").episodes}
    assert names == {"data/house/it.glb", "data/tower/it.glb"}
    assert run("convert", "a.json.gz", "b.jsonl", *template, "-q")[0] == 0
    assert {e.scene for e in read_episodes("b.jsonl").episodes} == {"house", "tower"}
    one_more = (*template, "--scene", "house=h.glb")  # a scene's own name comes first
    assert run("convert", "set.jsonl", "c.json.gz", *one_more)[0] == 0
    names = {e.scene for e in read_episodes("c.json.gz").episodes}
    assert names == {"h.glb", "data/tower/it.glb"}
    assert run("convert", "c.json.gz", "d.jsonl", *one_more, "-q")[0] == 0
    assert {e.scene for e in read_episodes("d.jsonl").episodes} == {"house", "tower"}
    status, _, err = run("convert", "a.json.gz", "e.jsonl", "--scene", "{id}=scenes/{id}.glb")
    assert status == 1 and "is called as scenes/{id}.glb: one is 'data/house/it.glb'" in err
    status, out, _ = run("convert", "set.jsonl", "f.json.gz")
    assert status == 0 and "as 'house': `--scene '{id}=data/{id}.glb'` names them anew" in out


def test_other_programs_sets_are_made_by_convert(run):
    status, _, err = run("episodes", "house.json.gz", "-o", "pn.json.gz")
    assert status == 2 and "`navbake convert SET.jsonl pn.json.gz`" in err


def test_another_grid_is_refused(run):
    assert run("episodes", "house.json.gz", "-o", "set.jsonl", "--count", "5")[0] == 0
    drive()
    grid = load("house.json.gz")
    level = grid.levels[0]
    free = level.free.nonzero()
    level.weights[free[0][0], free[1][0]] = float("inf")
    grid.save("other.json")
    status, _, err = run("score", "set.jsonl", "runs.jsonl", "other.json")
    assert status == 1 and "another grid of 'house'" in err and err.count("\n") == 1
    assert run("score", "set.jsonl", "runs.jsonl", "other.json", "--force", "-q")[0] == 0
    lines = Path("runs.jsonl").read_text().splitlines()
    Path("runs.jsonl").write_text("\n".join(lines[1:]))
    status, _, err = run("score", "set.jsonl", "runs.jsonl")
    assert status == 1 and "1 of 5 episodes have no trajectory, as '0'" in err
    assert "--partial" in err
    assert run("score", "set.jsonl", "runs.jsonl", "--partial")[0] == 0


def test_scenes_of_other_programs_are_named(run):
    assert run("episodes", "house.json.gz", "-o", "set.jsonl", "--count", "5", "-q")[0] == 0
    drive()
    scene = ("--scene", "house=x/house.glb")
    assert run("convert", "set.jsonl", "a.json.gz", *scene, "-q")[0] == 0
    status, _, err = run("score", "a.json.gz", "runs.jsonl", "house.json.gz")
    assert status == 1 and "no grid of 'x/house.glb'" in err
    assert "among those of 'house'" in err and "`--scene house=x/house.glb`" in err
    status, out, err = run("score", "a.json.gz", "runs.jsonl", "house.json.gz", *scene)
    assert (status, err) == (0, "") and "all: 5 episodes" in out


def test_a_forced_score_says_for_which_radius_it_is(run):
    args = ("episodes", "house.json.gz", "-o", "set.jsonl", "--count", "5", "--radius", "0.3")
    assert run(*args, "-q")[0] == 0
    drive()
    status, _, err = run("score", "set.jsonl", "runs.jsonl", "--force")
    assert status == 0 and "and the set's agent has a radius of 0.3 m" in err
    assert run("convert", "set.jsonl", "set.csv", "-q")[0] == 0
    status, _, err = run("score", "set.csv", "runs.jsonl", "house.json.gz", "--force")
    assert status == 0 and "and the set names no agent" in err


def test_episodes_without_a_path_are_named_and_counted(run):
    grid = level_from("..#..\n..#..\n")
    grid.metadata["sceneId"] = "plan"
    grid.save("plan.json")
    goals = (Goal(position=(0.05, -0.05, 0.0), radius=0.1),)
    ends = {"near": (0.15, -0.05, 0.0), "cut off": (0.45, -0.05, 0.0)}
    content = EpisodeSet(
        Header(),
        tuple(
            Episode(id=name, scene="plan", task="point", start=start, heading=0.0, goals=goals)
            for name, start in ends.items()
        ),
    )
    write_episodes(content, "set.jsonl")
    lines = [{"episode": name, "positions": [(0.05, -0.05, 0.0)]} for name in ends]
    Path("runs.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    status, out, err = run("score", "set.jsonl", "runs.jsonl", "plan.json", "--force")
    assert status == 0
    assert "1 of 2 episodes has no path to a goal" in err and "episode 'cut off': " in err
    assert "RuntimeWarning" not in err
    count_by_measure = {line.split()[0]: line.split()[-1] for line in out.splitlines()[2:]}
    assert count_by_measure["success"] == "2" and count_by_measure["soft_spl"] == "1"


def test_an_unknown_field_of_a_trajectory_is_named_with_the_known_ones(run):
    assert run("episodes", "house.json.gz", "-o", "set.jsonl", "--count", "1", "-q")[0] == 0
    Path("runs.jsonl").write_text('{"id": "0", "positions": []}')
    status, _, err = run("score", "set.jsonl", "runs.jsonl")
    known_names = "expected episode, positions, stop, times, headings, in"
    assert status == 1 and f"unknown field `id`, {known_names}" in err


def test_grids_in_folders_are_found_from_the_set_and_in_a_folder(run, tmp_path):
    for scene in ("house", "tower"):
        (tmp_path / "grids" / scene).mkdir(parents=True)
        file = tmp_path / "grids" / scene / "grid.json.gz"
        shutil.copy(GOLDEN / f"{scene}.grid.json.gz", file)
    (tmp_path / "sets").mkdir()
    files = [f"grids/{scene}/grid.json.gz" for scene in ("house", "tower")]
    status, _, err = run("episodes", *files, "-o", "sets/set.jsonl", "--count", "4")
    assert (status, err) == (0, "")
    content = read_episodes("sets/set.jsonl")
    assert [entry.file for entry in content.header.grids] == [f"../{file}" for file in files]
    lines = [{"episode": e.id, "positions": [e.start]} for e in content.episodes]
    Path("runs.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    status, out, err = run("score", "sets/set.jsonl", "runs.jsonl")
    assert (status, err) == (0, "") and "all: 4 episodes" in out
    (tmp_path / "grids").rename(tmp_path / "moved")
    status, _, err = run("score", "sets/set.jsonl", "runs.jsonl")
    assert status == 1 and "house/grid.json.gz, which" in err.replace("\\", "/")
    assert "give the grids, or the folder that they are in" in err
    status, out, err = run("score", "sets/set.jsonl", "runs.jsonl", "moved")
    assert (status, err) == (0, "") and "all: 4 episodes" in out
    status, _, err = run("score", "sets/set.jsonl", "runs.jsonl", "sets")
    assert status == 1 and "no grid of 'house' in sets: expected " in err
