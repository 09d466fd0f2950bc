"""Sets of episodes of a batch: one of each scene, and one of all beside the index."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest

import navbake
from batch_in_process import run_sources, stay_in_process
from batch_scenes import draw_room
from navbake.batch.index import INDEX_NAME
from navbake.batch.page import describe_batch
from navbake.batch.workers import DONE, JobEnd
from navbake.episodes import digest_of, make_episodes, read_episodes
from navbake.errors import ConfigError

run = partial(run_sources, settings={"grid": {"cell_size": 0.2}})
SET = "episodes-point-habitat-7-3.jsonl"
MAKE = ["episodes:point:habitat:07:3"]


@pytest.fixture
def scenes(tmp_path, monkeypatch):
    """The current folder, with three scenes and one that is broken."""
    monkeypatch.chdir(tmp_path)
    for number, name in enumerate(("a", "b", "c")):
        Path(f"{name}.xml").write_text(draw_room(number))
    Path("bad.xml").write_text("<mujoco>")
    return ["c.xml", "bad.xml", "a.xml", "b.xml"]


def test_one_set_of_all_scenes_is_beside_the_index(scenes, monkeypatch):
    stay_in_process(monkeypatch)
    _, result = run(*scenes, products=MAKE)
    made = read_episodes(Path("out", SET))
    assert [entry.scene for entry in made.header.grids] == ["c", "a", "b"]
    assert [episode.id for episode in made.episodes[:8]] == [*(f"c/{n}" for n in range(7)), "a/0"]
    assert len(made) == made.header.sampler["count"] == 21 and made.header.seed == 3
    for entry in made.header.grids:
        grid = navbake.load(Path("out", entry.file))
        made.check_grid(grid)
        own = read_episodes(Path("out", entry.scene, SET))
        alone = make_episodes(grid, "point", "habitat", count=7, seed=3)
        assert own.header.grids[0].digest == entry.digest == digest_of(grid)
        assert [(e.start, e.goals) for e in own.episodes] == [
            (e.start, e.goals) for e in alone.episodes
        ]
    rows = [row for row in result.rows if row["status"] == "ok"]
    assert [sum(row["episodes"]["levels"]) for row in rows] == [7, 7, 7]
    described = json.loads(json.dumps(describe_batch(result.rows, lambda id: False)))
    assert [scene["episodes"] is not None for scene in described["scenes"]] == [1, 0, 1, 1]
    assert {key: len(edges) for key, edges in described["classes"].items()} == {
        key: len(counts) for key, counts in rows[0]["episodes"].items()
    }


def test_the_order_in_which_scenes_end_changes_no_byte(scenes, monkeypatch):
    def backwards(jobs, work, count, **options):
        for number, job in reversed([*enumerate(jobs)]):
            yield JobEnd(number, DONE, result=work(job))

    stay_in_process(monkeypatch)
    run(*scenes, products=MAKE, executor=backwards)
    content = Path("out", SET).read_bytes()
    run(*scenes, products=MAKE, out="other")
    assert Path("other", SET).read_bytes() == content
    Path("other", SET).unlink()
    names, _ = run(*scenes, products=MAKE, out="other")  # the scenes are done
    assert names == ["bad"] and Path("other", SET).read_bytes() == content


def test_a_scene_without_episodes_keeps_its_grid_and_says_why(scenes, monkeypatch):
    stay_in_process(monkeypatch)
    make = ["episodes:object:uniform:4"]
    floor = '<mujoco><worldbody><geom type="box" size="2 2 .1"/></worldbody></mujoco>'
    Path("b.xml").write_text(floor)
    _, result = run("a.xml", "b.xml", products=make)
    made = read_episodes(Path("out/episodes-object-uniform-4-0.jsonl"))
    assert result.count("ok") == 2 and [entry.scene for entry in made.header.grids] == ["a"]
    assert "no episodes of object: no object in 'b' to set as a goal" in result.rows[1]["warnings"]
    assert run("a.xml", "b.xml", products=make)[0] == []


def test_scenes_that_make_no_set_are_one_error(scenes, monkeypatch):
    stay_in_process(monkeypatch)
    Path("list.csv").write_text("scene,agent.radius\na.xml,0.1\nb.xml,0.2\n")
    _, result = run("list.csv", products=MAKE)
    sizes = "agents differ in size (0.1 x 1.14 m in 'a' and 0.2 x 1.14 m in 'b'): "
    assert sizes + "`--set agent.radius=… --set agent.height=…`" in result.stop_reason
    assert result.count("ok") == 2
    assert Path("out", INDEX_NAME).exists() and Path("out/a", SET).exists()
    for name in ("one", "two"):
        Path(f"{name}.yaml").write_text(f"scene: {{path: {name[0]}.xml, id: same}}\n")
    for name in ("o", "t"):
        Path(f"{name}.xml").write_text(draw_room(1))
    _, result = run("one.yaml", "two.yaml", products=MAKE, out="other")
    assert (
        "no common set of episodes was written, as two scenes are called 'same'"
        in result.stop_reason
    )


@pytest.mark.parametrize(
    ("product", "message"),
    [
        ("episodes", r"expected episodes:TASK\[:SAMPLER"),
        ("episodes:points", "got 'points'"),
        ("episodes:point:habit", "no sampler 'habit'"),
        ("episodes:point:uniform:0", "expected a count >= 1 and a seed >= 0, got 'episodes:po"),
        ("episodes:point:uniform:5:-1", "expected a count >= 1 and a seed >= 0"),
    ],
)
def test_wrong_episodes_are_refused_before_anything_is_baked(scenes, product, message):
    with pytest.raises(ConfigError, match=message):
        run("a.xml", products=[product])
    assert not Path("out").exists()
