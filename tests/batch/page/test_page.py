"""The page of a batch in a browser: it shows, sorts and filters, and asks for nothing else."""

from __future__ import annotations

import json
import os
import re
import sys
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import pytest

from browser import errors_of, needs_browser, open_browser, requests_of, strangers_of, wait_until
from grid_maps import level_from
from navbake.batch.index import NAME as INDEX
from navbake.batch.page import content
from navbake.batch.page.page import draw_thumbnails, write_page, write_page_beside
from navbake.batch.products import GRID, THUMBNAIL
from navbake.errors import FormatError
from report_pages import check_policy, content_of_batch, content_of_page

COUNT = 300
HOSTILE_ID = "odd #1 & 100% 'é'"  # may be the name of a folder
STRANGE_ID = "../<img src=x onerror=alert(1)>"  # can't be one of a batch's
HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>$SCRIPT"
# press a bar of the free areas; gives what is said of it
CLICK = """
  const figure = document.querySelector("#charts figure");
  const bar = figure.querySelectorAll(".bars button")[arguments[0]];
  bar.dispatchEvent(new PointerEvent("pointerenter"));
  const text = figure.querySelector("p").textContent;
  bar.dispatchEvent(new MouseEvent("click", { shiftKey: arguments[1] }));
  return text;
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
            made |= {"files": {GRID: {}, "report.html": {}}, "stages": {"scene": 0.1}}
            yield {**row, "status": "ok", **made, "ended": f"2026-01-01T00:00:{number % 60:02}Z"}
    yield {"id": HOSTILE_ID, "status": "ok", "free_area": 5.5, "files": {GRID: {}}}
    for name in (STRANGE_ID, "javascript:alert(3)"):
        yield {"id": name, "status": "failed", "how": HOSTILE, "error": HOSTILE, "source": HOSTILE}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder as a batch leaves it; some scenes have grids."""
    folder = tmp_path_factory.mktemp("batch") / "100% of $SCRIPT & <b>"
    folder.mkdir()
    lines = "".join(json.dumps(row) + "\n" for row in rows())
    (folder / INDEX).write_text(lines + "null\n")
    for name in ("scene-000", "scene-001", HOSTILE_ID):
        (folder / name).mkdir()
        level_from("..#\n...").save(folder / name / GRID)
    assert draw_thumbnails(folder, lambda share: None) == 271 - 3  # of those that are ok
    write_page(folder)
    return folder


@pytest.fixture(scope="module")
def server(folder):
    """Serves the folder; its URL."""

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_):
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=folder)) as server:
        threading.Thread(target=server.serve_forever).start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()


def open_page(driver, url):
    driver.get("about:blank")  # another hash alone would load nothing
    driver.get(url)
    wait_until(lambda: driver.execute_script("return document.body.dataset.ready"), "the page")


def press(driver, box, text):
    found = driver.find_elements("css selector", f"#{box} button")
    next(each for each in found if text in each.text).click()


def count(driver):
    return driver.find_element("id", "count").text


def first_row(driver):
    return driver.find_element("css selector", "#table .name").text


def test_the_policy_allows_the_pages_own_script_and_style_and_pictures_beside_it(folder):
    page = (folder / "index.html").read_text("utf-8")
    assert page.count("</script>") == 2 and "alert" not in page and "<b>" not in page
    rules = check_policy(page)
    assert rules.keys() == {
        *("default-src", "img-src", "style-src", "script-src", "base-uri", "form-action")
    }
    assert {rules[name] for name in ("default-src", "base-uri", "form-action")} == {"'none'"}
    assert rules["img-src"] == "'self' file: data:"
    shown = content_of_batch(folder / "index.html")
    assert shown["scenes"][-1]["failures"] and shown["noRows"] == 0


def test_thumbnails_are_drawn_where_grids_are_and_nowhere_else(folder):
    drawn = {path.parent.name for path in folder.rglob(THUMBNAIL)}
    assert drawn == {"scene-000", "scene-001", HOSTILE_ID}
    made = content_of_batch(folder / "index.html")["scenes"]
    assert {scene["id"] for scene in made if scene["thumbnail"]} == drawn


def test_no_thumbnail_is_drawn_outside_of_the_folder(tmp_path):
    for name in ("batch", "outside"):
        (tmp_path / name).mkdir()
    level_from("..").save(tmp_path / "outside" / GRID)
    row = {"id": "../outside", "status": "ok", "files": {GRID: {}}}
    (tmp_path / "batch" / INDEX).write_text(json.dumps(row) + "\n")
    assert draw_thumbnails(tmp_path / "batch", lambda share: None) == 0
    assert [path.name for path in (tmp_path / "outside").iterdir()] == [GRID]


def test_nothing_is_written_through_links_that_lead_out(tmp_path):
    for name in ("batch/b", "outside", "batch/c"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "batch" / "a").symlink_to(tmp_path / "outside", target_is_directory=True)
    (tmp_path / "batch" / "b" / THUMBNAIL).symlink_to(tmp_path / "outside" / "b.png")
    (tmp_path / "batch" / "d").symlink_to("c", target_is_directory=True)
    for name in ("outside", "batch/b", "batch/c"):
        level_from("..").save(tmp_path / name / GRID)
    rows = [{"id": name, "status": "ok", "files": {GRID: {}}} for name in "abd"]
    text = "".join(json.dumps(row) + "\n" for row in rows)
    (tmp_path / "batch" / INDEX).write_text(text)
    assert draw_thumbnails(tmp_path / "batch", lambda share: None) == 2
    assert (tmp_path / "batch" / "c" / THUMBNAIL).is_file()
    (tmp_path / "batch" / "index.html").symlink_to(tmp_path / "outside" / "index.html")
    with pytest.raises(FormatError, match=r"leads to .*outside.*: remove the link"):
        write_page(tmp_path / "batch")
    assert [path.name for path in (tmp_path / "outside").iterdir()] == [GRID]


@pytest.mark.skipif(os.name == "nt", reason="links may be refused")
def test_links_lead_through_links_of_the_file_system_as_browsers_follow_them(tmp_path):
    (tmp_path / "far" / "away" / "out").mkdir(parents=True)
    (tmp_path / "far" / "away" / "out" / INDEX).write_text("")
    (tmp_path / "out").symlink_to(tmp_path / "far" / "away" / "out")
    (tmp_path / "pages").symlink_to(tmp_path / "far" / "away")
    write_page_beside(tmp_path / "out", tmp_path / "pages" / "page.html")
    page = (tmp_path / "far" / "away" / "page.html").read_bytes()
    assert content_of_page(page)["base"] == "../out"


@needs_browser
@pytest.mark.skipif(sys.platform != "linux", reason="names are Unicode there")
def test_links_lead_to_a_folder_whose_name_is_no_utf_8(tmp_path):
    folder = tmp_path / "b\udcff %20#ä"
    try:
        (folder / "a").mkdir(parents=True)
    except OSError:
        pytest.skip("this file system takes UTF-8 only")
    level_from("..").save(folder / "a" / GRID)
    (folder / INDEX).write_text('{"id": "a", "status": "ok", "files": {"grid.json.gz": {}}}\n')
    draw_thumbnails(folder, lambda share: None)
    (tmp_path / "pages").mkdir()
    write_page_beside(folder, tmp_path / "pages" / "page.html")
    with open_browser() as driver:
        open_page(driver, (tmp_path / "pages" / "page.html").as_uri())
        driver.execute_script("openScene(0)")
        picture = driver.find_element("css selector", "#scene img")
        wait_until(partial(driver.execute_script, LOADED, picture), "its picture")
        link = driver.find_element("css selector", "#scene a").get_attribute("href")
        assert link == f"{folder.as_uri()}/a/{GRID}"
        assert errors_of(driver) == []


@needs_browser
@pytest.mark.parametrize(("width", "dark"), [(1280, False), (390, True)])
def test_a_reader_filters_sorts_and_opens_scenes(folder, width, dark):
    from selenium.webdriver.common.keys import Keys

    with open_browser(width, 900, dark=dark) as driver:
        url = (folder / "index.html").as_uri()
        open_page(driver, url)
        assert driver.execute_script("return document.documentElement.scrollWidth") <= width
        assert count(driver) == f"{COUNT + 3} scenes"
        press(driver, "failures", "crashed: line #: no element …")
        assert count(driver) == f"15 of {COUNT + 3} scenes"
        press(driver, "statuses", "ok")
        assert count(driver) == f"0 of {COUNT + 3} scenes"
        press(driver, "chosen", "Show all")
        press(driver, "warnings", "door … is shut")
        assert count(driver) == f"6 of {COUNT + 3} scenes"
        press(driver, "chosen", "door … is shut")
        # bars: the second holds areas from 20 to 40
        assert driver.execute_script(CLICK, 1, False) == "20 to below 40\u00a0m²: 18 scenes"
        assert count(driver) == f"18 of {COUNT + 3} scenes"
        driver.execute_script(CLICK, 2, True)
        assert count(driver) == f"36 of {COUNT + 3} scenes"
        press(driver, "table", "free area")
        assert first_row(driver) == "scene-058"
        press(driver, "table", "free area")
        assert first_row(driver) == "scene-020"
        text = driver.find_element("id", "text")
        text.send_keys("SCENE-03")
        assert count(driver) == f"9 of {COUNT + 3} scenes"
        # a copied link shows the same
        chosen = driver.current_url
        open_page(driver, chosen)
        assert count(driver) == f"9 of {COUNT + 3} scenes" and first_row(driver) == "scene-030"
        driver.find_element("css selector", "#table .name").click()
        box = driver.find_element("id", "scene")
        assert driver.find_element("id", "scene-name").text == "scene-030" and "30 m²" in box.text
        driver.find_element("id", "after").click()
        assert driver.find_element("id", "scene-name").text == "scene-031"
        box.send_keys(Keys.ARROW_RIGHT)
        box.send_keys(Keys.ARROW_LEFT)
        assert driver.find_element("id", "scene-name").text == "scene-031"
        links = [each.get_attribute("href") for each in box.find_elements("css selector", "a")]
        assert links == [f"{folder.as_uri()}/scene-031/{name}" for name in ("report.html", GRID)]
        driver.find_element("id", "close").click()
        assert not box.is_displayed()
        assert errors_of(driver) == [] and strangers_of(requests_of(driver)) == []


@needs_browser
def test_a_part_of_many_scenes_is_shown_until_more_are_asked_for(folder):
    with open_browser() as driver:
        open_page(driver, (folder / "index.html").as_uri())
        rows = "return document.querySelectorAll('#table tbody tr').length"
        assert driver.execute_script(rows) == 100
        press(driver, "table", f"Show more: {COUNT + 3 - 100} left")
        assert driver.execute_script(rows) == COUNT + 3
        press(driver, "table", "scene-001")
        assert driver.find_element("id", "scene-name").text == "scene-001"
        picture = driver.find_element("css selector", "#scene img")
        wait_until(partial(driver.execute_script, LOADED, picture), "its picture")
        assert errors_of(driver) == []


@needs_browser
def test_a_page_of_few_scenes_has_no_empty_parts(tmp_path):
    (tmp_path / INDEX).write_text("")
    write_page(tmp_path)
    size = "const box = find(arguments[0]).getBoundingClientRect(); return box.height"
    with open_browser() as driver:
        open_page(driver, (tmp_path / "index.html").as_uri())
        assert count(driver) == "0 scenes"
        assert not driver.find_element("id", "distributions").is_displayed()
        (tmp_path / INDEX).write_text('{"id": "a", "status": "failed", "seconds": 1}\n')
        write_page(tmp_path)
        open_page(driver, (tmp_path / "index.html").as_uri())
        assert 50 < driver.execute_script(size, "charts") < 200  # one as wide as four is too high
        assert errors_of(driver) == []


@needs_browser
def test_a_page_of_too_many_scenes_has_the_sums_of_all_and_says_so(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(content, "MAX_SCENES", 40)
    (tmp_path / INDEX).write_bytes((folder / INDEX).read_bytes())
    write_page(tmp_path)
    with open_browser() as driver:
        open_page(driver, (tmp_path / "index.html").as_uri())
        facts = driver.find_element("id", "facts").text.split("\n")
        assert facts[facts.index("free area") + 1] == "40,236 m²"
        assert facts[facts.index("with warnings") + 1] == "6 scenes"
        notes = driver.find_element("id", "notes").text
        assert "all 303 scenes" in notes and "shows 40 of them" in notes
        assert count(driver) == "40 scenes"
        made = driver.find_element("id", "made").text
        assert re.fullmatch(r"as of \d{4}-\d\d-\d\d \d\d:\d\d:\d\d UTC", made)
        assert errors_of(driver) == []


@needs_browser
def test_names_and_reasons_are_text_and_a_server_may_serve_the_page(folder, server):
    with open_browser(390, 900) as driver:
        open_page(driver, server)
        assert driver.find_element("id", "title").text == folder.name
        for name in (HOSTILE_ID, STRANGE_ID, "javascript:alert(3)"):
            find = "openScene(scenes.findIndex((scene) => scene.id === arguments[0]))"
            driver.execute_script(find, name)
            assert driver.find_element("id", "scene-name").text == name
            pictures = driver.find_elements("css selector", "#scene img")
            links = driver.find_elements("css selector", "#scene a")
            assert len(pictures) == len(links) == (name == HOSTILE_ID)
            if links:
                wait_until(partial(driver.execute_script, LOADED, pictures[0]), "its picture")
                href = "odd%20%231%20%26%20100%25%20'%C3%A9'/grid.json.gz"
                assert links[0].get_attribute("href") == server + href
            else:
                assert HOSTILE in driver.find_element("id", "scene").text
            driver.find_element("id", "close").click()
        assert driver.execute_script("return document.scripts.length") == 2
        assert errors_of(driver) == [] and strangers_of(requests_of(driver)) == []
