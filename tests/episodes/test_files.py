"""Sets of episodes: what they refuse, and files that hold them."""

from __future__ import annotations

import gzip

import msgspec
import numpy as np
import pytest

from grid_maps import level_from
from navbake.episodes import (
    Agent,
    Episode,
    EpisodeSet,
    Goal,
    GridEntry,
    Header,
    ViewPoint,
    digest_of,
    read_episodes,
    write_episodes,
)
from navbake.errors import FormatError, MissingDependencyError, QueryError

SEEN = ViewPoint((1.0, 2.0, 0.0), 0.5)
EPISODES = (
    Episode(
        id="a", scene="flat", task="point", start=(0.05, -0.05, 0.0), heading=0.25,
        goals=(Goal(position=(1.0, 2.0, 0.0), radius=0.2),), distance=2.5, straight=2.0,
        split="train", room="0:1", levels=(0, 0), doors=(), rooms=("0:1", "0:2"),
    ),
    Episode(
        id="b", scene="flat", task="object", start=(0.1, 1 / 3, 0.0), heading=-1.0,
        goals=(Goal(name="cup_1", category="cup", view_points=(SEEN,), radius=0.1),),
        instruction="find the cup", path=((0.0, 0.0, 0.0), (1.0, 2.0, 0.0)), extra={"n": [1, "x"]},
    ),
)  # fmt: skip
HEADER = Header(
    agent=Agent(radius=0.2, height=1.2),
    grids=(GridEntry(scene="flat", digest="00", file="flat.grid.json"),),
    sampler={"name": "uniform", "min_distance": 1.0},
    seed=3,
    rejected={"too near": 4},
)
SET = EpisodeSet(HEADER, EPISODES)


@pytest.mark.parametrize("name", ["set.jsonl", "set.jsonl.gz", "set.parquet"])
def test_a_set_comes_back_and_has_the_same_bytes_twice(tmp_path, name):
    if name.endswith("parquet"):
        pytest.importorskip("pyarrow")
    path, again = tmp_path / name, tmp_path / f"again_{name}"
    write_episodes(SET, path)
    read = read_episodes(path)
    assert read == SET
    write_episodes(read, again)
    assert path.read_bytes() == again.read_bytes()


def test_a_line_is_an_episode_and_the_first_the_header(tmp_path):
    write_episodes(SET, tmp_path / "set.jsonl")
    lines = (tmp_path / "set.jsonl").read_bytes().splitlines()
    assert [msgspec.json.decode(line).get("id") for line in lines] == [None, "a", "b"]


def test_parquet_without_pyarrow_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(MissingDependencyError, match=r"pip install .navbake\[batch\]"):
        write_episodes(SET, tmp_path / "set.parquet")


@pytest.mark.parametrize(
    ("line", "change", "message"),
    [
        (0, (b"navbake-episodes", b"other"), "expected 'navbake-episodes'"),
        (0, (b'"version":1', b'"version":9'), "of version 9"),
        (1, (b"0.25", b'"x"'), r"Expected `float`, got `str` - at `\$.heading` in .*, line 2"),
        (1, (b'"radius":0.2', b'"radius":-1'), r"goals\[0\].radius"),
        (1, (b"heading", b"haeding"), "unknown field `haeding`"),
        (1, (b'"point"', b'"swim"'), "expected one of point, .* as task, got 'swim'"),
        (2, (b'"b"', b'"a"'), "expected unique ids, got 'a' twice"),
        (2, (b"{", b""), "line 3"),
    ],
)
def test_a_broken_line_is_named(tmp_path, line, change, message):
    path = tmp_path / "set.jsonl"
    write_episodes(SET, path)
    lines = path.read_bytes().splitlines()
    assert change[0] in lines[line]
    lines[line] = lines[line].replace(*change, 1)
    path.write_bytes(b"\n".join(lines))
    with pytest.raises(FormatError, match=message):
        read_episodes(path)


@pytest.mark.parametrize(
    "content", [b"", b"\x1f\x8bxx", gzip.compress(b"x" * 99, mtime=0)[:-9], b"[]"]
)
def test_what_is_no_set_is_refused(tmp_path, content):
    (tmp_path / "set.jsonl.gz").write_bytes(content)
    with pytest.raises(FormatError, match=r"set\.jsonl\.gz"):
        read_episodes(tmp_path / "set.jsonl.gz")


def test_other_endings_are_refused(tmp_path):
    with pytest.raises(FormatError, match=r"ends in .jsonl, .parquet, .json, .csv, got .*set.txt"):
        write_episodes(SET, tmp_path / "set.txt")


def flat(**fields):
    level = level_from("....\n.##.\n....")
    level.metadata = {"traversableFloorHeight": 0.25, "sceneId": "flat", "agentRadius": 0.2}
    level.metadata |= fields
    return level


def set_of(grid, **fields):
    entry = GridEntry(scene="flat", digest=digest_of(grid))
    header = msgspec.structs.replace(HEADER, grids=(entry,), **fields)
    return EpisodeSet(header, EPISODES)


def test_the_digest_is_of_what_distances_depend_on():
    grid = flat()
    assert digest_of(flat(timings={"x": 1})) == digest_of(grid)
    moved = flat()
    moved.weights[1, 1] = 1.0
    for other in (moved, flat(agentRadius=0.3), flat(agentHeight=2.0), flat(
        traversableFloorHeight=0.1
    )):  # fmt: skip
        assert digest_of(other) != digest_of(grid)


def test_a_set_of_another_grid_or_agent_is_refused():
    grid = flat()
    set_of(grid).check_grid(grid)
    other = flat()
    other.weights = np.where(other.weights == 1.0, 1.0, 1.0)
    with pytest.raises(QueryError, match="another grid of 'flat'"):
        set_of(grid).check_grid(other)
    with pytest.raises(QueryError, match=r"agent of radius 0.2 m, the grid of 'flat' for 0.3 m"):
        set_of(grid).check_grid(flat(agentRadius=0.3))
    with pytest.raises(QueryError, match="no episodes of 'flut'"):
        set_of(grid).check_grid(flat(sceneId="flut"))
    with pytest.raises(QueryError, match="doesn't say which grid"):
        EpisodeSet(Header(), EPISODES).check_grid(grid)
