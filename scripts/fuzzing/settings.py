"""Settings, room outlines, lists of scenes, indexes of batches, verifications."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from random import Random
from typing import Any

import orjson

from fuzzing import texts
from fuzzing.kind import Input, attempt
from fuzzing.mutations import WORDS, cut, dump_tree, mutate_bytes, mutate_tree, odd_value
from navbake.batch.done import find_done
from navbake.batch.index import Index, read_index
from navbake.batch.job import Job
from navbake.batch.manifest import list_jobs
from navbake.batch.page.content import describe_batch
from navbake.batch.settings import settings_of
from navbake.batch.table import encode_rows
from navbake.batch.work import Order
from navbake.config.settings import BakeConfig, settings_digest, settings_to_state
from navbake.types import Json
from navbake.verifier.report import FREE_TOUCHES, Finding, LevelCounts, SweepCounts, VerifyReport
from navbake.views.report.report import verify_marks, verify_tables

POLYGONS = ("rooms.geojson", "rooms.geojson", "no.geojson", ".", "/dev/zero", "input.yaml", "\0")
FEW = 20  # jobs of a list that are looked at


def make_yaml(rng: Random) -> Input:
    """Settings with other words, lines, tags, anchors, depths, or bombs of these."""
    text = rng.choice(texts.SETTINGS)
    beside: dict[str, bytes] = {}
    for _ in range(rng.choice((1, 1, 2, 4))):
        lines = text.split("\n")
        at = rng.randrange(len(lines))
        key, colon, value = lines[at].partition(":")
        kind = rng.randrange(8)
        if kind < 4:
            tag = rng.choice(texts.TAGS) if rng.random() < 0.4 else ""
            odd = rng.choice((*texts.SCALARS, json.dumps(odd_value(rng)), value.strip()))
            lines[at] = f"{key}{colon} {tag} {odd}"
        elif kind == 4:
            lines[at] = f"{key}{colon} &a {value}\nmore: *a"
        elif kind == 5:
            lines[at] = rng.choice(("", " ", "  ", "\t", "- ", "? ", "    ")) + lines[at].lstrip()
        elif kind == 6:
            lines.insert(at, rng.choice(lines))
        else:
            del lines[at]
        text = "\n".join(lines)
    chance = rng.random()
    if chance < 0.03:
        text = rng.choice((f"{text}\nlevels: {_bomb(rng)}", f"{_bomb(rng)}\n"))
    elif chance < 0.2:
        text = f"scene: {{path: a.xml}}\nrooms:\n  polygons: {json.dumps(rng.choice(POLYGONS))}\n"
        beside["rooms.geojson"] = make_geojson(rng).data
    data = text.encode(errors="surrogatepass")
    return Input(mutate_bytes(data, rng) if rng.random() < 0.1 else cut(data, rng), ".yaml", beside)


def _bomb(rng: Random) -> str:
    """YAML that stands for more, or is deeper, than anybody should follow."""
    kind, count = rng.randrange(6), rng.choice((5, 9, 30))
    if kind == 0:  # "billion laughs"
        rows = [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, count)]
        return "\n" + "\n".join(["a0: &a0 [x, x]", *rows])
    if kind == 1:
        rows = [f"a{k}: &a{k} {{<<: [*a{k - 1}, *a{k - 1}], k{k}: 1}}" for k in range(1, count)]
        return "\n" + "\n".join(["a0: &a0 {x: 1}", *rows])
    if kind == 2:
        return rng.choice(("[", "{a: ", "- ", "? ")) * rng.choice((50, 99, 101, 5000))
    if kind == 3:
        return "&a [" + ", ".join(["*a"] * count) + "]"
    if kind == 4:
        return rng.choice(("[{}]", '"{}"', "'{}'", "!!{} x", "&{} x")).format("x" * 100_000)
    return "[" + ", ".join(map(str, range(rng.choice((1000, 20_000))))) + "]"


def check_config(config: BakeConfig) -> None:
    """Ask for what a bake asks of settings."""
    _ = config.inputs, settings_digest(config), settings_to_state(config)


def make_geojson(rng: Random) -> Input:
    """Room outlines with changes in their JSON; some have very many corners."""
    if rng.random() < 0.002:
        count = rng.choice((1000, 9000, 10_000, 20_000))
        ring = [[k, k * k % 7 if rng.random() < 0.1 else k * k] for k in range(count)]
        return Input(json.dumps(_polygons([ring] * rng.choice((1, 2)))).encode(), ".geojson")
    data = dump_tree(mutate_tree(rng.choice(texts.OUTLINES), rng), rng)
    return Input(cut(data, rng), ".geojson")


def _polygons(rings: Sequence[Any]) -> Json:
    return {
        "type": "FeatureCollection",
        "features": [
            {"type": "Feature", "geometry": {"type": "Polygon", "coordinates": [ring]}}
            for ring in rings
        ],
    }


# ---------------------------------------------------------------- batches

ROWS: tuple[Json, ...] = (
    {"scene": "input.xml", "id": "hall"},
    {"scene": "b/input.xml", "agent.radius": 0.2, "grid.cell_size": 0.1},
    {"config": "a.yaml", "id": "x/y", "settings": {"agent": {"radius": 0.3}}},
    {"scene": "c.xml", "id": 5, "rooms": {"polygons": "rooms.geojson"}},
)
IDS = (
    *("../x", "/etc/x", "a/../../x", ".", "..", "a\\..\\x", "C:x", "nul", "index.jsonl", "\u202e"),
    *("a" * 300, "a/", "//", "~", "$HOME", "a\0b", "a\nb", " ", "A", "a", "ａ/．．/x", "%2e%2e/x"),
)


def make_manifest(rng: Random) -> Input:
    """A list of scenes with odd ids, keys, values, quotes and bytes."""
    rows = [dict(row) for row in rng.choices(ROWS, k=rng.choice((1, 2, 3, 8)))]
    for _ in range(rng.choice((1, 1, 2, 3))):
        row = rng.choice(rows)
        kind = rng.randrange(4)
        if kind == 0:
            row["id"] = rng.choice(IDS)
        elif kind == 1:
            row[rng.choice((*row, *WORDS, "agent", "agent.radius.x", "scene.path", "a.b"))] = (
                odd_value(rng)
            )
        elif kind == 2:
            row[rng.choice(("scene", "config"))] = rng.choice((*IDS, odd_value(rng), "a.xml"))
        elif row:
            del row[rng.choice(list(row))]
    suffix = rng.choice((".csv", ".jsonl", ".jsonl", ".txt"))
    if suffix == ".csv":
        file = io.StringIO()
        keys = list(dict.fromkeys(key for row in rows for key in row if isinstance(key, str)))
        csv.writer(file).writerows([keys, *([row.get(key, "") for key in keys] for row in rows)])
        data = file.getvalue().encode(errors="surrogatepass")
        data = data.replace(
            *rng.choice(((b",", b'"'), (b"\n", b"\r"), (b",", b",,"), (b"a", b"a")))
        )
    elif suffix == ".txt":
        data = "\n".join(str(row.get("scene")) for row in rows).encode(errors="surrogatepass")
    else:
        data = b"\n".join(dump_tree(mutate_tree(row, rng), rng) for row in rows)
    return Input(mutate_bytes(data, rng) if rng.random() < 0.1 else cut(data, rng), suffix)


def read_manifest(path: Path) -> list[Job]:
    """List the scenes of a list."""
    return list_jobs([str(path)])


def check_jobs(jobs: list[Job]) -> None:
    """Outputs stay in their folder, each in its own; settings are taken or refused."""
    folder = Path("/output")
    for job in jobs:
        place = Path(os.path.normpath(folder / job.id))
        if folder not in place.parents or "\0" in job.id:
            raise AssertionError(f"{job.id!r} leads out of the folder")
    if len({os.path.normcase(job.id).casefold() for job in jobs}) < len(jobs):
        raise AssertionError("two scenes have one folder")
    for job in jobs[:FEW]:
        attempt(lambda job=job: settings_of(job, {}, ()))


@cache
def _rows() -> tuple[Json, ...]:
    state = {"size": 3, "modified": 0, "sha256": "0" * 64}
    row = {
        "id": "input", "status": "ok", "source": "input.xml", "version": "0.1.0", "key": "0" * 64,
        "levels": 1, "cells": 100, "free_area": 1.5, "rooms": 1, "doors": 0, "warnings": ["a"],
        "audit": [], "inputs": {"input.xml": state}, "named": ["input.xml"],
        "sought": {"folders": ["."], "names": ["a.obj"]},
        "files": {"grid.json.gz": state}, "stages": {"scene": 0.1}, "seconds": 1.0,
    }  # fmt: skip
    failed = {"id": "b", "status": "failed", "how": "error", "error": "no file", "source": "b.xml"}
    return row, failed


def make_index(rng: Random) -> Input:
    """The index of a batch with changes in its rows."""
    rows = [mutate_tree(rng.choice(_rows()), rng) for _ in range(rng.choice((1, 2, 3)))]
    data = b"\n".join(dump_tree(row, rng) for row in rows) + b"\n"
    return Input(mutate_bytes(data, rng) if rng.random() < 0.2 else cut(data, rng), ".jsonl")


def read_rows(path: Path) -> dict[str, Json]:
    """Read the index, as it is and as a batch that goes on does."""
    place = path.with_name("index.jsonl")
    os.replace(path, place)
    index = Index(path.parent)
    try:
        if read_index(path.parent) != index.known:
            raise AssertionError("a batch that goes on sees other rows")
        index.finish(index.known, set(index.known), lambda id: {"id": id})
        if read_index(path.parent) != index.known:
            raise AssertionError("rows are others after they are written and read")
    finally:
        index.close()
        place.unlink()
    return index.known


def check_rows(rows: dict[str, Json]) -> None:
    """A row says that a scene is done, or does not; the page and the table of a batch show all."""
    folder = Path("/output")
    orjson.dumps(describe_batch(rows.values(), lambda id: True))
    if find_spec("pyarrow") is not None:
        attempt(lambda: encode_rows(rows.values()))
    for row in rows.values():
        order = Order(Job("input", __file__, {}, "a list"), {}, (), (), folder)
        attempt(lambda order=order, row=row: find_done([order], {"input": row}))


# ---------------------------------------------------------------- verifications


@cache
def _verification() -> Json:
    report = VerifyReport(
        scene_id="a", num_cells=100, seed=0, tolerance=0.001, radius=0.1,
        levels=[LevelCounts("ground", cells=50, free_free=40)], sweeps=SweepCounts(0.1, 3, 5.0),
        findings=[Finding(FREE_TOUCHES, 0, (1, 2), (0.5, 1.0, 0.0), "a table", "geom", 0.01)] * 2,
        notes=["nothing"],
    )  # fmt: skip
    parsed: Json = json.loads(json.dumps(report.to_json()))
    return parsed


def make_verification(rng: Random) -> Input:
    """A verification with changes in its JSON."""
    return Input(cut(dump_tree(mutate_tree(_verification(), rng), rng), rng), ".json")


def check_verification(report: Json) -> None:
    """Show it on the page of a report."""
    attempt(lambda: list(verify_marks(report, 2)))
    attempt(lambda: list(verify_tables(report)))
