"""The commands `navbake verify` and `navbake audit`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import navbake
from box_worlds import world
from navbake.baker.bake import pipeline
from navbake.navgrid.colors import MARKS
from verified_scenes import copy_of, stairs_house, write


@pytest.fixture
def room(folder):
    """The folder with the grid of room.yaml, and one with two faults."""
    grid = navbake.bake("room.yaml")
    grid.save("room.grid.json")
    (row, col) = cell = np.argwhere(grid.occupancy == 1)[0].tolist()
    grid.weights[row, col], grid.attributes["occupancy"][row, col] = 1.0, 0
    grid.attributes["floorHeight"][0, 0] += np.float32(0.02)
    grid.save("wrong.grid.json")
    Path("cell.json").write_text(json.dumps(cell))
    return folder


def test_verify_says_that_they_agree(room, run):
    status, out, err = run("verify", "room.grid.json", "--scene", "room.yaml", "--paths", 3)
    assert (status, err) == (0, "")
    assert "free, touches" in out and "3 paths of" in out
    assert out.endswith("grid and scene agree, at 96 of 96 cells\n")


def test_verify_finds_the_scene_by_its_name(room, run):
    assert run("verify", "room.grid.json")[0] == 0
    Path("room.xml").rename("elsewhere.xml")
    status, out, err = run("verify", "room.grid.json")
    assert (status, out) == (1, "") and err.count("\n") == 1
    assert "the scene room.xml that room was baked from isn't in the current folder" in err
    status, _, err = run("verify", "room.grid.json", "--scene", "gone.xml")
    assert status == 1 and "no scene at gone.xml: it may have moved" in err


def test_verify_names_what_is_wrong_and_draws_it(room, run):
    pytest.importorskip("matplotlib")
    status, out, _ = run("verify", "wrong.grid.json", "-o", "wrong.png")
    assert status == 1
    row, col = json.loads(Path("cell.json").read_text())
    assert (
        f"free cell touches: level 0, row {row}, col {col} (" in out and "'wall [b]' reaches" in out
    )
    assert "floor off: level 0, row 0, col 0" in out
    assert "disagree at 2 places" in out
    assert Path("wrong.png").read_bytes().startswith(b"\x89PNG")
    status, out, _ = run("verify", "wrong.grid.json", "--json", "--sample", 96)
    assert status == 1 and len(json.loads(out)["findings"]) == 2


def test_verify_draws_each_mark_on_its_level(folder, run):
    """A floor that is off below, a cell that touches above; the legend is below both."""
    image = pytest.importorskip("PIL.Image")
    path = write(folder, world(stairs_house()), "house.xml")
    wrong = copy_of(navbake.bake({"scene": {"path": str(path)}, "grid": {"cell_size": 0.2}}))
    lower, upper = wrong.levels
    row, col = np.argwhere(lower.free)[20].tolist()
    lower.attributes["floorHeight"][row, col] += np.float32(0.02)
    upper.weights[tuple(np.argwhere(upper.occupancy == 1)[0])] = 1.0
    wrong.save("wrong.grid.json")
    assert run("verify", "wrong.grid.json", "--scene", path, "-o", "wrong.png")[0] == 1
    pixels = np.asarray(image.open("wrong.png").convert("RGB")).astype(int)
    # the levels lie beside each other, and the legend below both
    legend, half, drawn = len(pixels) - 90, pixels.shape[1] // 2, []
    for text in MARKS[:2]:
        is_mark = np.abs(pixels - list(bytes.fromhex(text[1:]))).max(axis=-1) < 8
        maps = is_mark[:legend]
        assert is_mark[legend:].any()
        drawn.append((int(maps[:, :half].sum()), int(maps[:, half:].sum())))
    (off_below, off_above), (touching_below, touching_above) = drawn
    assert off_below > 0 and off_above == 0 and touching_below == 0 and touching_above > 0


def test_verify_looks_at_a_sample_or_at_all(room, run):
    for options, count in ((("--sample", 10), 10), (("--all",), 96), (("--sample", 1000), 96)):
        _, out, _ = run("verify", "room.grid.json", "--json", *options)
        assert json.loads(out)["checked"] == count
    status, out, err = run("verify", "room.grid.json", "--sample", 10, "--all")
    assert (status, out) == (2, "") and "expected one of them" in err


def test_verify_refuses_another_scene_unless_forced(room, run):
    text = Path("room.xml").read_text()
    Path("room.xml").write_text(text.replace('pos="1 0 1"', 'pos="0 0 1"'))
    status, _, err = run("verify", "room.grid.json")
    assert status == 1 and "isn't the scene that the grid was baked from" in err
    assert "--force, or force=True, compares them anyway" in err
    status, out, _ = run("verify", "room.grid.json", "--force")
    assert status == 1 and "free cell touches" in out


@pytest.mark.parametrize("how", ["yaml", "set"])
def test_a_bake_verifies_its_grid(folder, run, how):
    """By a setting in the YAML or by --set, with the same bytes each time, by Python as well."""
    more: tuple[str, ...] = ("--set", "verify.sample=50")
    if how == "yaml":
        text = Path("room.yaml").read_text() + "verify: {sample: 50}\n"
        Path("room.yaml").write_text(text)
        more = ()
    for name, jobs in (("one.json", 1), ("two.json", 2)):
        bake = ("bake", "room.yaml", "-o", name, "--no-timings", "--threads", jobs, *more)
        assert run(*bake)[0] == 0
    assert Path("one.json").read_bytes() == Path("two.json").read_bytes()
    grid = navbake.load("one.json")
    report = navbake.verify("one.json", "room.yaml", sample=50)
    verified = {"sample": 50, "cells": 50, "disagreements": 0, "digest": report.digest}
    assert grid.navbake["verified"] == verified
    settings = {"scene": {"path": "room.xml"}, "grid": {"cell_size": 0.5}, "verify": {"sample": 50}}
    baked = navbake.bake(settings)
    baked.timings = {}
    baked.save("three.json")
    assert Path("three.json").read_bytes() == Path("one.json").read_bytes()
    # and but for what was verified, they are the bytes of a bake without
    assert run("bake", "room.xml", "-o", "bare.json", "--set", "grid.cell_size=0.5")[0] == 0
    bare = navbake.load("bare.json")
    assert bare.navbake == {k: v for k, v in grid.navbake.items() if k != "verified"}
    np.testing.assert_array_equal(bare.weights, grid.weights)


def test_a_bake_says_where_it_disagrees(folder, run, monkeypatch, caplog):
    build = pipeline.build_grid

    def build_wrong(*given):
        grid = build(*given)
        row, col = np.argwhere(grid.occupancy == 1)[0].tolist()
        grid.weights[row, col], grid.attributes["occupancy"][row, col] = 1.0, 0
        return grid

    monkeypatch.setattr(pipeline, "build_grid", build_wrong)
    assert run("bake", "room.yaml", "--set", "verify.sample=200")[0] == 0
    (record,) = caplog.records
    text = "verify: MuJoCo and FCL disagree with the grid at 1 place, with 96 cells looked at"
    assert record.getMessage() == f"room: {text}; navbake verify lists them"
    grid = navbake.load("room.grid.json")
    assert grid.navbake["verified"]["disagreements"] == 1 and grid.warnings
    status, out, _ = run("verify", "room.grid.json")
    assert status == 1 and "free cell touches: level 0, row" in out
    status, out, err = run("bake", "room.yaml", "--set", "verify.sample=0")
    assert (status, out) == (1, "")
    assert "expected a whole number >= 1, or null, got 0 at `verify.sample`" in err


def test_audit_says_that_nothing_is_wrong(folder, run):
    # the wall parts two rooms that no door joins
    settings = {"scene": {"path": "room.xml"}, "grid": {"cell_size": 0.5}, "rooms": "none"}
    navbake.bake(settings).save("room.grid.json")
    status, out, err = run("audit", "room.grid.json")
    assert (status, err) == (0, "") and out == "22 checks: 0 errors, 0 remarks\n"


def test_audit_names_errors_and_remarks(room, run):
    pytest.importorskip("matplotlib")
    grid = navbake.load("room.grid.json")
    row, col = np.argwhere(grid.free)[5].tolist()
    grid.attributes["occupancy"][row, col] = 1
    grid.save("wrong.grid.json")
    status, out, _ = run("audit", "wrong.grid.json", "-o", "audit.png")
    assert status == 1 and "error: level 0 (" in out and "1 cell is free by weight" in out
    assert Path("audit.png").read_bytes().startswith(b"\x89PNG")
    grid.weights[:], grid.attributes["occupancy"][:] = 1.0, 0
    big = navbake.SceneGrid2D(
        width=20, height=20, cell_size=0.1, min_yup=(0.0, 0.0, 0.0), weights=np.ones((20, 20))
    )
    big.save("free.grid.json")
    status, out, _ = run("audit", "free.grid.json")
    assert status == 0 and "remark: all 400 cells are free" in out
    status, out, _ = run("audit", "free.grid.json", "--json")
    assert json.loads(out)["remarks"][0]["check"] == "all free"
