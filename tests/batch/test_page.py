"""The page of a batch: what it says follows from the index, and a browser shows, sorts, filters."""

from __future__ import annotations

import json
import os
import sys
from functools import partial
from itertools import combinations, pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from batch_in_process import Told, stay_in_process
from batch_scenes import draw_room
from browser import errors_of, needs_browser, open_browser, requests_of, strangers_of, wait_until
from grid_maps import level_from
from navbake.batch.index import INDEX_NAME as INDEX
from navbake.batch.job import Plan
from navbake.batch.page import (
    LivePage,
    describe_batch,
    draw_thumbnails,
    fold_text,
    measure_work,
    write_page,
)
from navbake.batch.products import GRID_NAME, THUMBNAIL_NAME
from navbake.batch.run import run_batch
from navbake.batch.scenes import list_jobs
from navbake.batch.store import list_file_sizes, read_file, remove_files
from report_pages import check_policy, content_of_batch, content_of_page

OK = {
    "id": "houses/a",
    "status": "ok",
    "source": "../a.xml",
    "version": "0.1.0",
    "free_area": 12.5,
    "cells": 400,
    "warnings": ["door 'x' is shut"],
    "audit": ["2 patches"],
    "files": {"grid.json.gz": {}, "report.html": {}},
    "stages": {"scene": 0.5, "rooms": 0.25},
    "seconds": 1.0,
    "ended": "2026-01-01T00:00:10.000Z",
}
BAD = {"id": "b", "status": "failed", "source": "../b", "how": "error", "error": "no file b.xml"}
LEFT = {"id": "c", "status": "left", "source": "../c.xml"}


def describe(*rows):
    return json.loads(json.dumps(describe_batch(rows, lambda id: True)))


def test_a_scene_is_what_its_row_says():
    made = describe(OK, BAD, LEFT, {"id": "d", "status": "fine"})
    ok, bad, left = made["scenes"]
    assert [scene["id"] for scene in made["scenes"]] == ["houses/a", "b", "c"]
    assert (ok["free_area"], bad["free_area"], left["seconds"]) == (12.5, None, None)
    assert (ok["thumbnail"], bad["thumbnail"], left["thumbnail"]) == (True, False, False)
    assert ok["files"] == ["grid.json.gz", "report.html"] and bad["files"] == []
    assert ok["stages"] == OK["stages"] and ok["ended"] == OK["ended"]
    assert (bad["failures"], ok["failures"]) == (["error: no file b.xml"], [])
    assert (ok["warnings"], ok["audit"]) == (["door 'x' is shut"], ["2 patches"])
    assert made["groups"]["failures"] == {"error: no file b.xml": "error: no file b.xml"}
    assert made["work"] == 1.0


def test_time_is_that_in_which_any_scene_was_baked():
    def row(ended, seconds):
        return {"ended": ended and f"2026-01-01T{ended}Z", "seconds": seconds}

    spans = [("00:00:10.000", 4), ("00:00:12.500", 4), ("00:00:08.000", 1), ("09:00:00", 2)]
    spans += [(None, 3), ("00:00:10", None)]
    assert measure_work(row(*span) for span in spans) == pytest.approx(6.5 + 2)
    assert measure_work([]) == 0


@pytest.mark.parametrize(
    ("text", "folded"),
    [
        ("no scene file at scenes/a b.xml", "no scene file at … …"),
        ("broken XML in x/b.xml: line 1, column 19", "broken XML in …: line #, column #"),
        ("cannot load a.mjb: Element 'gemo', line 3", "cannot load …: Element …, line #"),
        ('got "5cm" at `grid.cell_size` in house.yaml', "got … at `grid.cell_size` in …"),
        ("a grid of 3.24e+10 cells: 18,000 x 18000 m", "a grid of # cells: # x # m"),
        ("0.5 m² of 30% at -3, +4.", "# m² of # at #, #."),
        ("geom12 and geom_7 can't meet", "… and … can't meet"),
        ("doesn't and isn't stay", "doesn't and isn't stay"),
        ("its process ended by SIGSEGV", "its process ended by SIGSEGV"),
        (r"cannot read C:\scenes\a.xml", "cannot read C:…"),
        ("expected <mujoco> or <robot> in model.xml", "expected <mujoco> or <robot> in …"),
        ("", ""),
    ],
)
def test_names_and_numbers_are_folded_and_settings_stay(text, folded):
    assert fold_text(text) == folded


@given(st.text(max_size=200))
def test_any_text_is_folded_once(text):
    assert fold_text(fold_text(text)) == fold_text(text)


def test_texts_of_a_kind_are_one_group_and_one_alone_is_itself():
    texts = ["error: line 1", "error: line 2", "crashed: line 1"]
    made = describe(*({**BAD, "how": t.split(": ")[0], "error": t.split(": ")[1]} for t in texts))
    groups = ["error: line 1 to 2", "error: line 1 to 2", "crashed: line 1"]
    assert made["groups"]["failures"] == dict(zip(texts, groups, strict=True))


@pytest.mark.parametrize(
    ("texts", "name"),
    [
        (
            [
                "hint: level 0 (1.00, 2.00, 0.00): a gap of 0.31 m between two rooms",
                "hint: level 2 (-1.50, 2.00, 6.10): a gap of 0.25 m between two rooms",
                "hint: level 1 (0.00, 0.00, 3.00): a gap of 0.4 m between two rooms",
            ],
            "hint: a gap of 0.25 to 0.4 m between two rooms",
        ),
        (["hint: level 0: 3 stairs", "hint: level 1: 3 stairs"], "hint: 3 stairs"),
        (["no file a.xml, line 3.", "no file b.xml, line 12."], "no file …, line 3 to 12."),
        (["1,200 cells of 5cm", "900 cells of 10cm"], "900 to 1200 cells of 5cm to 10cm"),
        (["line #", "line 3"], "line #"),
        (["door 'a' is stuck", "door 'a' is  stuck "], None),
    ],
)
def test_groups_of_texts_have_names_in_words(texts, name):
    made = describe(*({**BAD, "id": str(n), "warnings": [t]} for n, t in enumerate(texts)))
    names = made["groups"]["warnings"]
    assert list(names) == texts
    if name is None:
        assert names == {text: text for text in texts}
    else:
        assert set(names.values()) == {name}


def test_groups_that_differ_have_names_that_differ():
    texts = ["level 0: 3 stairs", "level 1: 3 stairs", "3 stairs", "4 stairs"]
    made = describe(*({**BAD, "id": str(n), "warnings": [t]} for n, t in enumerate(texts)))
    names = [made["groups"]["warnings"][text] for text in texts]
    assert names[0] == names[1] and names[2] == names[3] and names[0] != names[2]


@given(st.lists(st.text(alphabet="a1.#…'\"`, :()-level", max_size=12), max_size=8))
def test_any_texts_have_names_by_what_is_folded(texts):
    made = describe(*({**BAD, "id": str(n), "warnings": [t]} for n, t in enumerate(texts)))
    names = made["groups"]["warnings"]
    for one, other in combinations(names, 2):
        assert (names[one] == names[other]) == (fold_text(one) == fold_text(other))


@pytest.mark.parametrize(
    ("areas", "edges"),
    [
        ([], []),
        ([3, 3], [3, 4]),
        ([0, 280], [20 * k for k in range(16)]),
        ([0.5, 0.9], [0.5 + 0.02 * k for k in range(22)]),
    ],
)
def test_bars_have_round_edges(areas, edges):
    made = describe(*({**OK, "free_area": area} for area in areas))
    assert made["edges"]["free_area"] == pytest.approx(edges)


def test_bars_of_skewed_numbers_have_equal_ratios():
    made = describe(*({**OK, "free_area": area} for area in (1, 1, 1, 4096)))
    edges = made["edges"]["free_area"]
    assert (edges[0], edges[-1]) == (1, 4096)
    assert all(b / a == pytest.approx(2**0.5) for a, b in pairwise(edges))


def test_a_store_has_thumbnails_and_the_page(tmp_path, monkeypatch):
    pytest.importorskip("fsspec")
    stay_in_process(monkeypatch)
    store = "memory://pages/out"
    for name in ("first", "second"):
        (tmp_path / f"{name}.xml").write_text(draw_room(1))
    jobs = list_jobs([str(tmp_path / "*.xml")])
    plan = Plan(store, {"grid": {"cell_size": 0.2}}, thumbnail=True)
    run_batch(plan, jobs, Told())
    thumbnail = f"{store}/first/thumbnail.png"
    drawn = read_file(thumbnail)
    remove_files(store, ["first/thumbnail.png"])
    assert run_batch(plan, jobs, Told()).num_skipped == 2
    assert draw_thumbnails(store, lambda share: None) == 0
    assert read_file(thumbnail) == drawn
    remove_files(store, ["second/thumbnail.png"])
    write_page(store)
    shown = content_of_page(read_file(f"{store}/index.html"))
    made = [(scene["id"], scene["thumbnail"]) for scene in shown["scenes"]]
    assert made == [("first", True), ("second", False)]
    assert shown["base"] == "."
    remove_files(store, ["index.html"])
    LivePage(store, 2).refresh(1)
    assert "index.html" not in list_file_sizes(store)
    # what is baked anew without a page has no old thumbnail
    run_batch(Plan(store, {}), jobs, Told())
    assert not any(Path(name).name == "thumbnail.png" for name in list_file_sizes(store))


# --- the page of some hundred scenes, in a browser ----------------------------------------------

COUNT = 300
HOSTILE_ID = "odd #1 & 100% 'é'"  # may be the name of a folder
HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>$SCRIPT"
# press a bar of the free areas; gives what is said of it
CLICK = """
  const bar = document.querySelectorAll("#charts figure:first-child button")[arguments[0]];
  bar.dispatchEvent(new MouseEvent("click", { shiftKey: arguments[1] }));
  return bar.title;
"""
LOADED = "return arguments[0].naturalWidth"


def rows():
    """Rows of scenes whose free area is their number; each tenth failed, the last is left."""
    for number in range(COUNT):
        row = {"id": f"scene-{number:03}", "source": f"../scene-{number:03}.xml"}
        if number == COUNT - 1:
            yield {**row, "status": "left"}
        elif number % 10 == 9:
            how = "crashed" if number % 20 == 9 else "error"
            error = f"line {number}: no element 'x{number}'"
            yield {**row, "status": "failed", "how": how, "error": error, "seconds": 0.1}
        else:
            warnings = [f"door 'd{number}' is shut"] if number % 50 == 0 else []
            made = {"free_area": float(number), "cells": 10 * number, "levels": 1, "doors": 0}
            made |= {"rooms": number % 4, "seconds": 0.5, "warnings": warnings, "audit": []}
            made |= {"files": {GRID_NAME: {}, "report.html": {}}, "stages": {"scene": 0.1}}
            yield {**row, "status": "ok", **made, "ended": f"2026-01-01T00:00:{number % 60:02}Z"}
    yield {"id": HOSTILE_ID, "status": "ok", "free_area": 5.5, "files": {GRID_NAME: {}}}
    yield {"id": "a", "status": "failed", "how": HOSTILE, "error": HOSTILE, "source": HOSTILE}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder as a batch leaves it; some scenes have grids."""
    folder = tmp_path_factory.mktemp("batch") / "100% of $SCRIPT & <b>"
    folder.mkdir()
    (folder / INDEX).write_text("".join(json.dumps(row) + "\n" for row in rows()) + "null\n")
    for name in ("scene-000", "scene-001", HOSTILE_ID):
        (folder / name).mkdir()
        level_from("..#\n...").save(folder / name / GRID_NAME)
    assert draw_thumbnails(folder, lambda share: None) == 271 - 3  # of those that are ok
    write_page(folder)
    return folder


@pytest.fixture(scope="module")
def driver():
    with open_browser(1280, 900) as driver:
        yield driver


def open_page(driver, url):
    driver.get("about:blank")  # another hash alone would load nothing
    driver.get(url)
    wait_until(lambda: driver.execute_script("return document.body.dataset.ready"), "the page")


def press(driver, box, text):
    found = driver.find_elements("css selector", f"#{box} button")
    next(each for each in found if text in each.text).click()


def test_the_policy_allows_the_pages_own_script_and_style_and_pictures_beside_it(folder):
    page = (folder / "index.html").read_text("utf-8")
    assert page.count("</script>") == 2 and "alert" not in page and "<b>" not in page
    rules = check_policy(page)
    names = ("default-src", "img-src", "style-src", "script-src", "base-uri", "form-action")
    assert rules.keys() == {*names}
    assert {rules[name] for name in ("default-src", "base-uri", "form-action")} == {"'none'"}
    assert rules["img-src"] == "'self' file: data:"


def test_thumbnails_are_drawn_where_grids_are(folder):
    drawn = {path.parent.name for path in folder.rglob(THUMBNAIL_NAME)}
    assert drawn == {"scene-000", "scene-001", HOSTILE_ID}
    made = content_of_batch(folder / "index.html")["scenes"]
    assert {scene["id"] for scene in made if scene["thumbnail"]} == drawn


@pytest.mark.skipif(os.name == "nt", reason="links may be refused")
def test_links_lead_through_links_of_the_file_system_as_browsers_follow_them(tmp_path):
    (tmp_path / "far" / "away" / "out").mkdir(parents=True)
    (tmp_path / "far" / "away" / "out" / INDEX).write_text("")
    (tmp_path / "out").symlink_to(tmp_path / "far" / "away" / "out")
    (tmp_path / "pages").symlink_to(tmp_path / "far" / "away")
    write_page(tmp_path / "out", tmp_path / "pages" / "page.html")
    page = (tmp_path / "far" / "away" / "page.html").read_bytes()
    assert content_of_page(page)["base"] == "../out"


@needs_browser
@pytest.mark.skipif(sys.platform != "linux", reason="names are Unicode there")
def test_links_lead_to_a_folder_whose_name_is_no_utf_8(driver, tmp_path):
    folder = tmp_path / "b\udcff %20#ä"
    try:
        (folder / "a").mkdir(parents=True)
    except OSError:
        pytest.skip("this file system takes UTF-8 only")
    level_from("..").save(folder / "a" / GRID_NAME)
    (folder / INDEX).write_text('{"id": "a", "status": "ok", "files": {"grid.json.gz": {}}}\n')
    draw_thumbnails(folder, lambda share: None)
    (tmp_path / "pages").mkdir()
    write_page(folder, tmp_path / "pages" / "page.html")
    open_page(driver, (tmp_path / "pages" / "page.html").as_uri())
    driver.execute_script("openScene(scenes[0])")
    picture = driver.find_element("css selector", "#scene img")
    wait_until(partial(driver.execute_script, LOADED, picture), "its picture")
    link = driver.find_element("css selector", "#scene a").get_attribute("href")
    assert link == f"{folder.as_uri()}/a/{GRID_NAME}"


@needs_browser
def test_a_reader_filters_sorts_and_opens_scenes(driver, folder):
    from selenium.webdriver.common.keys import Keys

    def check_count(number):
        of = "" if number == COUNT + 2 else f"{number} of "
        assert driver.find_element("id", "count").text == f"{of}{COUNT + 2} scenes"

    def first_row():
        return driver.find_element("css selector", "#table .name").text

    open_page(driver, (folder / "index.html").as_uri())
    check_count(COUNT + 2)
    facts = driver.find_element("id", "facts").text.split("\n")
    assert facts[facts.index("free area") + 1] == "40,236 m²"
    rows = "return document.querySelectorAll('#table tbody tr').length"
    assert driver.execute_script(rows) == 100
    press(driver, "table", f"Show more: {COUNT + 2 - 100} left")
    assert driver.execute_script(rows) == COUNT + 2
    press(driver, "failures", "crashed: line ")
    check_count(15)
    press(driver, "status", "ok")
    check_count(0)
    press(driver, "chosen", "Show all")
    press(driver, "warnings", "door … is shut")
    check_count(6)
    press(driver, "chosen", "door … is shut")
    # bars: the second holds areas from 20 to 40
    assert driver.execute_script(CLICK, 1, False) == "20 to below 40\u00a0m²: 18 scenes"
    check_count(18)
    driver.execute_script(CLICK, 2, True)
    check_count(36)
    press(driver, "table", "free area")
    assert first_row() == "scene-058"
    press(driver, "table", "free area")
    assert first_row() == "scene-020"
    driver.find_element("id", "text").send_keys("SCENE-03")
    check_count(9)
    # a copied link shows the same
    open_page(driver, driver.current_url)
    check_count(9)
    assert first_row() == "scene-030"
    driver.find_element("css selector", "#table .name").click()
    box, name = driver.find_element("id", "scene"), lambda: box.find_element("tag name", "h2").text
    assert name() == "scene-030" and "30 m²" in box.text
    press(driver, "scene", "→")
    assert name() == "scene-031"
    box.send_keys(Keys.ARROW_RIGHT)
    box.send_keys(Keys.ARROW_LEFT)
    assert name() == "scene-031"
    links = [each.get_attribute("href") for each in box.find_elements("css selector", "a")]
    assert links == [f"{folder.as_uri()}/scene-031/{name}" for name in ("report.html", GRID_NAME)]
    press(driver, "scene", "✕")
    assert not box.is_displayed()
    assert errors_of(driver) == [] and strangers_of(requests_of(driver)) == []


@needs_browser
def test_names_and_reasons_are_text_on_a_narrow_dark_page(folder):
    with open_browser(390, 900, dark=True) as driver:
        open_page(driver, (folder / "index.html").as_uri())
        assert driver.execute_script("return document.documentElement.scrollWidth") <= 390
        title = driver.find_element("id", "title").text
        assert title == f"Batch {folder.name}: {COUNT + 2} scenes"
        # rows are stacked: a cell stands under the other, with its column's name
        cells = driver.find_elements("css selector", "#table tbody tr:nth-child(2) td")
        left = {cell.location["x"] for cell in cells if cell.is_displayed()}
        assert len(left) == 1
        before = "return getComputedStyle(arguments[0], '::before').content"
        assert driver.execute_script(before, cells[-1]).startswith('"time in s')
        for name in (HOSTILE_ID, "a"):
            driver.execute_script("openScene(scenes.find((s) => s.id === arguments[0]))", name)
            box = driver.find_element("id", "scene")
            assert driver.find_element("id", "scene-name").text == name
            pictures = box.find_elements("css selector", "img")
            links = box.find_elements("css selector", "a")
            assert len(pictures) == len(links) == (name == HOSTILE_ID)
            assert (HOSTILE in box.text) == (name == "a")
            if links:
                wait_until(partial(driver.execute_script, LOADED, pictures[0]), "its picture")
                href = links[0].get_attribute("href")
                assert href.endswith("/odd%20%231%20%26%20100%25%20'%C3%A9'/grid.json.gz")
            press(driver, "scene", "✕")
        assert driver.execute_script("return document.scripts.length") == 2
        assert errors_of(driver) == [] and strangers_of(requests_of(driver)) == []


@needs_browser
def test_a_page_of_few_scenes_has_no_empty_parts(driver, tmp_path):
    (tmp_path / INDEX).write_text("")
    write_page(tmp_path)
    open_page(driver, (tmp_path / "index.html").as_uri())
    assert driver.find_element("id", "count").text == "0 scenes"
    assert not driver.find_element("id", "distributions").is_displayed()
    (tmp_path / INDEX).write_text('{"id": "a", "status": "failed", "seconds": 1}\n')
    write_page(tmp_path)
    open_page(driver, (tmp_path / "index.html").as_uri())
    size = "return find('charts').getBoundingClientRect().height"
    assert 50 < driver.execute_script(size) < 200  # one as wide as four is too high
    assert errors_of(driver) == []
