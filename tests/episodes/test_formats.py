"""Sets of episodes in other programs' files: what comes back, what is lost, what is refused."""

from __future__ import annotations

import bz2
import csv
import gzip
import importlib.util
import json
import math
import sys
import types
from pathlib import Path

import msgspec
import pytest

from navbake.cli.episodes import SET_FORMATS
from navbake.episodes import (
    Agent,
    Episode,
    EpisodeSet,
    Goal,
    GridEntry,
    Header,
    ViewPoint,
    read_episodes,
    write_episodes,
)
from navbake.episodes.files import EPISODE_FORMATS, NAVBAKE_FORMATS
from navbake.errors import FormatError

HEADER = Header(
    agent=Agent(radius=0.2, height=1.2),
    grids=(GridEntry(scene="flat", digest="00", file="flat.grid.json"),),
    seed=3,
)
POINT = Episode(
    id="7", scene="flat", task="point", start=(0.05, -0.125, 3.0), heading=0.25,
    goals=(Goal(position=(1.0, 2.0, 3.0), radius=0.2),), distance=2.5, straight=2.25,
    split="train", room="1:1", levels=(1, 1), doors=("door", "gate"), rooms=("1:1", "1:2"),
    path=((0.05, -0.125, 3.0), (1.0, 2.0, 3.0)), instruction="go to the hall",
)  # fmt: skip
CUPS = tuple(
    Goal(position=(x, 1.0, 0.5), radius=0.1, name=f"cup_{x}", category="cup",
         view_points=(ViewPoint((x, 0.5, 0.0), 1.5), ViewPoint((x, 1.5, 0.0), -1.5, 0.25)))
    for x in (1, 2)
)  # fmt: skip
OBJECT = msgspec.structs.replace(POINT, task="object", goals=CUPS, path=(), instruction=None)
SETS = {
    "point": EpisodeSet(HEADER, (POINT, msgspec.structs.replace(POINT, id="8", heading=-3.0))),
    "object": EpisodeSet(HEADER, (OBJECT, msgspec.structs.replace(OBJECT, id="8", heading=2.0))),
}
EPISODE = {"episode_id": 1, "scene_id": "a", "start_position": [0, 0, 0],
           "start_rotation": [0, 0, 0, 1], "goals": [{"position": [0, 0, 0]}]}  # fmt: skip
NAMES = {
    "habitat-pointnav": ("point", "set.json.gz"),
    "habitat-vln": ("point", "set.json"),
    "habitat-objectnav": ("object", "set.json.gz"),
    "molmospaces": ("object", "set.json"),
    "minos": ("point", "set.csv.bz2"),
}


def plain(value):
    """As tests compare: numbers to nanometres."""
    return round_all(msgspec.to_builtins(value))


def round_all(value):
    if isinstance(value, dict):
        return {k: round_all(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [round_all(v) for v in value]
    return round(value, 9) if isinstance(value, float) else value


def test_the_command_line_names_all_formats():
    assert set(SET_FORMATS) == EPISODE_FORMATS.keys() - NAVBAKE_FORMATS.keys() == NAMES.keys()


@pytest.mark.parametrize("form", sorted(NAMES.keys() - {"minos"}))
@pytest.mark.parametrize("scenes", [{}, {"flat": "data/scenes/flat/4"}])
def test_all_fields_come_back(form, scenes, tmp_path):
    task, name = NAMES[form]
    wanted = SETS[task]
    lost = write_episodes(wanted, tmp_path / name, form, scenes)
    read = read_episodes(tmp_path / name, scenes)
    assert plain(read.episodes) == plain(wanted.episodes)
    if form == "molmospaces":
        assert lost == ["agent"]
    else:
        assert (lost, read.header) == ([], HEADER)
    first = (tmp_path / name).read_bytes()
    write_episodes(wanted, tmp_path / name, form, scenes)
    assert (tmp_path / name).read_bytes() == first


def test_habitat_has_y_up_and_looks_along_minus_z(tmp_path):
    east = msgspec.structs.replace(POINT, heading=0.0)
    write_episodes(EpisodeSet(HEADER, (east,)), tmp_path / "a.json", None, {"flat": "x/flat.glb"})
    (found,) = json.loads((tmp_path / "a.json").read_text())["episodes"]
    assert found["scene_id"] == "x/flat.glb"
    assert found["start_position"] == [0.05, 3.0, 0.125]
    assert found["goals"] == [{"position": [1.0, 3.0, -2.0], "radius": 0.2}]
    # +90 degrees face -x there, so -90 degrees face +x
    half = math.sqrt(0.5)
    assert found["start_rotation"] == pytest.approx([0, -half, 0, half])
    assert found["info"]["geodesic_distance"] == 2.5


def read_minos_columns(path):
    return [(row["episodeId"], row["task"]) for row in csv.DictReader(path.open())]


def test_minos_tables_have_the_columns_that_it_reads_its_task_and_id_from(tmp_path):
    # in minos: EpisodeScheduler's int(r["episodeId"]); sstk's ssc/check-episode-states: p, o, r
    room = msgspec.structs.replace(
        POINT, task="room", goals=(Goal(position=(1.0, 2.0, 3.0), radius=0.0, room="1:2"),)
    )
    for content, letter in (*((SETS[task], task[0]) for task in SETS),
                            (EpisodeSet(HEADER, (room,)), "r")):  # fmt: skip
        write_episodes(content, tmp_path / "set.csv")
        ids = [episode.id for episode in content.episodes]
        assert read_minos_columns(tmp_path / "set.csv") == [(name, letter) for name in ids]
        read = read_episodes(tmp_path / "set.csv")
        assert [(episode.id, episode.task) for episode in read.episodes] == [
            (episode.id, episode.task) for episode in content.episodes
        ]
    for ids in (("a", "b"), ("01", "2"), ("-1", "2")):
        named = tuple(msgspec.structs.replace(POINT, id=name) for name in ids)
        write_episodes(EpisodeSet(HEADER, named), tmp_path / "set.csv")
        assert read_minos_columns(tmp_path / "set.csv") == [("0", "p"), ("1", "p")]


@pytest.mark.parametrize(
    ("task", "room", "name", "expected"),
    [
        ("o", "0_2", "0_5", ("object", "0_5", None, "door")),
        ("p", "0_2", "", ("point", None, None, "door")),
        ("r", "0_2", "0_5", ("room", "0_5", "0_2", "Toilet")),
        ("", "0_2", "0_5", ("room", "0_5", "0_2", "Toilet")),  # without the column, as before
        ("", "", "0_5", ("object", "0_5", None, "door")),
    ],
)
def test_minos_rows_are_of_the_task_that_they_state(tmp_path, task, room, name, expected):
    fields = {"task": task, "sceneId": "a", "goalRoomId": room, "goalRoomType": "Toilet",
              "goalObjectId": name, "goalObjectType": "door", "startAngle": "0"}  # fmt: skip
    fields |= {f"{end}{axis}": "0" for end in ("start", "goal") for axis in "XYZ"}
    (tmp_path / "set.csv").write_text(f"{','.join(fields)}\n{','.join(fields.values())}\n")
    (episode,) = read_episodes(tmp_path / "set.csv").episodes
    goal = episode.goals[0]
    assert (episode.task, goal.name, goal.room, goal.category) == expected
    for wrong in ("x", "point_goal"):
        fields["task"] = wrong
        (tmp_path / "set.csv").write_text(f"{','.join(fields)}\n{','.join(fields.values())}\n")
        with pytest.raises(FormatError, match=f"expected one of p, o, r as task, got '{wrong}'"):
            read_episodes(tmp_path / "set.csv")


def test_minos_has_a_row_an_episode(tmp_path):
    lost = write_episodes(SETS["point"], tmp_path / "set.csv.bz2", scenes={"flat": "17D"})
    assert lost == ["agent", "instruction", "path"]
    text = bz2.decompress((tmp_path / "set.csv.bz2").read_bytes()).decode()
    row = next(csv.DictReader(text.splitlines()))
    assert (row["sceneId"], row["roomId"], row["level"]) == ("17D", "1:1", "1")
    assert (row["startX"], row["startY"], row["startZ"]) == ("0.050", "3.000", "0.125")
    assert row["startAngle"] == f"{0.25 - math.pi / 2:.3f}"
    assert (row["pathDoorIds"], row["pathRoomIndices"]) == ("door:gate", "1:2")
    read = read_episodes(tmp_path / "set.csv.bz2", {"flat": "17D"})
    first, second = read.episodes
    assert first.heading == pytest.approx(0.25, abs=1e-3)
    assert second.heading == pytest.approx(-3.0, abs=1e-3)
    assert (first.id, second.id) == ("7", "8")
    kept = {"heading": 0.0, "path": (), "instruction": None}
    goals = (msgspec.structs.replace(POINT.goals[0], radius=0.25),)
    wanted = msgspec.structs.replace(POINT, goals=goals, **kept)
    assert plain(msgspec.structs.replace(first, heading=0.0)) == plain(wanted)
    unknown = msgspec.structs.replace(POINT, distance=None)
    write_episodes(EpisodeSet(HEADER, (unknown,)), tmp_path / "set.csv")
    assert ",-1.000," in (tmp_path / "set.csv").read_text()
    assert read_episodes(tmp_path / "set.csv").episodes[0].distance is None
    write_episodes(SETS["object"], tmp_path / "set.csv")
    (goal,) = read_episodes(tmp_path / "set.csv").episodes[0].goals
    assert (goal.name, goal.category, goal.view_points) == ("cup_1", "cup", ())


def test_a_file_of_vln_ce(tmp_path):
    foreign = {**EPISODE, "trajectory_id": 4, "reference_path": [[1, 2, 3]], "info": {"x": 1},
               "instruction": {"instruction_text": "go", "instruction_tokens": [1]}}  # fmt: skip
    (tmp_path / "a.json").write_text(json.dumps({"episodes": [foreign]}))
    (e,) = read_episodes(tmp_path / "a.json", {"flat": "a"}).episodes
    assert (e.id, e.scene, e.path, e.instruction) == ("1", "flat", ((1, -3, 2),), "go")
    assert e.extra == {"trajectory_id": 4, "x": 1}
    assert e.goals == (Goal(position=(0, 0, 0), radius=0.2),)


def test_an_episode_spec_of_molmospaces(tmp_path):
    spec = {
        "house_index": 5, "scene_dataset": "procthor-10k", "data_split": "test", "seed": 1,
        "robot": {"robot_name": "rby1", "init_qpos": {"arm": [0.0]}}, "img_resolution": [640, 480],
        "language": {"task_description": "find the cup"},
        "task": {
            "task_cls": "x.NavToObjTask", "robot_base_pose": [1, 2, 0, math.sqrt(0.5), 0, 0,
            math.sqrt(0.5)], "pickup_obj_name": "cup", "pickup_obj_candidates": ["mug", "cup"],
            "pickup_obj_start_pose": [3, 4, 0.5, 1, 0, 0, 0],
        },
    }  # fmt: skip
    (tmp_path / "a.json").write_text(json.dumps([spec]))
    (e,) = read_episodes(tmp_path / "a.json", {"five": "procthor-10k/5"}).episodes
    assert (e.scene, e.split, e.start, e.instruction) == ("five", "test", (1, 2, 0), "find the cup")
    assert e.heading == pytest.approx(math.pi / 2)
    assert [(g.name, g.position, g.radius) for g in e.goals] == [
        ("cup", (3, 4, 0.5), 1.5), ("mug", None, 1.5)
    ]  # fmt: skip
    assert e.extra == {"success": "planar"}  # as scores take it
    spec["task"]["task_cls"] = "x.PickTask"
    (tmp_path / "a.json").write_text(json.dumps([spec]))
    with pytest.raises(FormatError, match=r"expected a way to an object, got 'x\.PickTask'"):
        read_episodes(tmp_path / "a.json")


@pytest.mark.parametrize(
    ("form", "name", "content", "message"),
    [
        (None, "a.txt", SETS["point"], r"ends in \.jsonl, .*got .*a\.txt"),
        ("minos", "a.json", SETS["point"], r"ends in \.csv, got .*a\.json"),
        ("minosse", "a.csv", SETS["point"], "no format 'minosse': did you mean 'minos'"),
        ("habitat-pointnav", "a.json", SETS["object"], "no task 'object' in habitat-pointnav, as"),
        ("molmospaces", "a.json", SETS["point"], "no task 'point' in molmospaces"),
        ("habitat-vln", "a.json", EpisodeSet(HEADER, (
            msgspec.structs.replace(POINT, path=()),)), "needs paths, episode '7' has none"),
        ("habitat-objectnav", "a.json", EpisodeSet(HEADER, (OBJECT, msgspec.structs.replace(
            OBJECT, id="8", goals=CUPS[1:]))), "one list of goals for 'flat_cup', episode '8'"),
        ("habitat-pointnav", "a.json", EpisodeSet(HEADER, (msgspec.structs.replace(
            POINT, goals=(Goal(),)),)), "expected positions of all goals, one has none"),
    ],
)  # fmt: skip
def test_what_a_format_cannot_hold_is_one_line(form, name, content, message, tmp_path):
    with pytest.raises(FormatError, match=message) as caught:
        write_episodes(content, tmp_path / name, form)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / name).exists()


ROW = "sceneId,startX,startY,startZ,startAngle,goalX,goalY,goalZ\na,0,0,0,{},1,0,0\n"


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.json.gz", gzip.compress(b"[" * 99, mtime=0)[:-9],
         r"broken gzip data in .*a\.json\.gz: .*; the file is incomplete"),
        ("a.csv.bz2", bz2.compress(b"x" * 99)[:-9], r"broken bzip2 data in .*a\.csv\.bz2"),
        ("a.json", b"{}", "missing required field `episodes`"),
        ("a.json", json.dumps({"episodes": [{**EPISODE, "goals": []}]}), "episode '1' has no goal"),
        ("a.json", json.dumps({"episodes": [{**EPISODE, "start_position": [0, 0]}]}),
         r"length 3 - at `\$\.episodes\[0\]\.start_position` in .*a\.json"),
        ("a.json", json.dumps({"episodes": [EPISODE, EPISODE]}), "unique ids, got '1' twice"),
        ("a.json", json.dumps({"episodes": [{**EPISODE, "info": {"navbake": 3}}]}), "mapping"),
        ("a.json", json.dumps({"episodes": [{**EPISODE, "info": {"geodesic_distance": "x"}}]}),
         r"Expected `float \| null`, got `str`"),
        ("a.json", b"[{}]", r"missing required field `scene_dataset`"),
        ("a.csv", ROW.format("x"), r"a number as startAngle, got 'x' in row 1 in .*a\.csv"),
        ("a.csv", ROW.format("nan"), "a number as startAngle, got 'nan'"),
        ("a.csv", b"a,b\n1,2\n", "a number as startX, got None in row 1"),
        ("a.csv", b"\xff\xfe", "can't decode byte"),
    ],
)  # fmt: skip
def test_broken_files_are_one_line(name, data, message, tmp_path):
    (tmp_path / name).write_bytes(data.encode() if isinstance(data, str) else data)
    with pytest.raises(FormatError, match=message) as caught:
        read_episodes(tmp_path / name)
    assert "\n" not in str(caught.value) and name in str(caught.value)


# ---------------------------------------------------------------- habitat-lab's own classes


@pytest.fixture
def habitat(monkeypatch):
    """habitat-lab without its simulator: the packages that import it are bare, with their paths."""
    spec = importlib.util.find_spec("habitat")
    if spec is None:
        pytest.skip("needs habitat-lab: pip install --no-deps habitat-lab")
    root = Path(spec.origin).parent
    for name in ("habitat", "habitat.sims.habitat_simulator"):
        package = types.ModuleType(name)
        package.__path__ = [str(root.joinpath(*name.split(".")[1:]))]
        monkeypatch.setitem(sys.modules, name, package)
    for name in ("attr", "gym", "quaternion", "omegaconf", "hydra", "cv2"):
        pytest.importorskip(name)


def loaded(module, name, path):
    dataset = getattr(importlib.import_module(f"habitat.datasets.{module}"), name)()
    dataset.from_json(gzip.decompress(path.read_bytes()).decode(), scenes_dir="scenes")
    return dataset.episodes


@pytest.mark.usefixtures("habitat")
def test_habitat_lab_loads_our_files(tmp_path):
    path, scenes = tmp_path / "set.json.gz", {"flat": "flat.glb"}
    for form, module, name in (
        ("habitat-pointnav", "pointnav.pointnav_dataset", "PointNavDatasetV1"),
        ("habitat-vln", "vln.r2r_vln_dataset", "VLNDatasetV1"),
        ("habitat-objectnav", "object_nav.object_nav_dataset", "ObjectNavDatasetV1"),
    ):
        content = SETS[NAMES[form][0]]
        write_episodes(content, path, form, scenes)
        found = loaded(module, name, path)
        assert len(found) == len(content)
        for k, (e, ours) in enumerate(zip(found, content.episodes, strict=True)):
            # ObjectNav numbers its episodes
            assert e.episode_id == (str(k) if form == "habitat-objectnav" else ours.id)
            assert e.scene_id == "scenes/flat.glb"
            x, y, z = ours.start
            assert e.start_position == pytest.approx([x, z, -y])
            half = (ours.heading - math.pi / 2) / 2
            assert e.start_rotation == pytest.approx([0, math.sin(half), 0, math.cos(half)])
            assert (e.start_room, e.info["geodesic_distance"]) == (ours.room, ours.distance)
            assert len(e.goals) == len(ours.goals)
            for goal, own in zip(e.goals, ours.goals, strict=True):
                x, y, z = own.position
                assert (goal.position, goal.radius) == ([x, z, -y], own.radius)
                if form == "habitat-objectnav":
                    assert (goal.object_name, goal.object_category) == (own.name, own.category)
                    assert [view.iou for view in goal.view_points] == [None, 0.25]
                    x, y, z = own.view_points[0].position
                    assert goal.view_points[0].agent_state.position == [x, z, -y]
            if form == "habitat-vln":
                assert e.instruction.instruction_text == ours.instruction
                assert e.reference_path == [[x, z, -y] for x, y, z in ours.path]
                assert e.trajectory_id == k
