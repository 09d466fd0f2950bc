"""The page in a real browser: it loads, and does what its reader asks for."""

import io
import os
import re
import time

import numpy as np
import pytest
from PIL import Image

import navbake
from browser import (
    errors_of,
    needs_browser,
    open_browser,
    requests_of,
    strangers_of,
    wait_until,
)
from navbake.views.viewer.controls import (
    HINT_GOAL,
    HINT_REACH,
    describe_inspection,
    escape_markdown,
)
from navbake.views.viewer.server import PageServer
from navbake.views.viewer.view_state import Inspection
from viewer_page import ViewerPage, run_view
from viewer_scenes import write_room

pytestmark = needs_browser
pytest.importorskip("viser")

PATIENCE = 120.0  # a busy machine draws slowly [s]


def free_cells(radius=None, **settings):
    """What the panel says of the room's free cells, by a bake of its own."""
    grid = navbake.bake(settings.pop("path"), **settings)
    grid = grid if radius is None else grid.inflate(radius)
    return f"{sum(np.count_nonzero(level.free) for level in grid.levels):,} free cells"


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """The room's page in a browser, its settings, and the process behind it."""
    path = write_room(tmp_path_factory.mktemp("room"))
    with run_view(str(path)) as (process, url), open_browser(900, 640) as driver:
        driver.set_page_load_timeout(PATIENCE)
        yield ViewerPage(driver, url), path, process


def picture_of(page):
    """The page's picture of the scene, as PNG."""
    return page.driver.find_elements("tag name", "canvas")[-1].screenshot_as_png


def wait_for_other(page, before):
    end = time.monotonic() + PATIENCE
    while picture_of(page) == before:
        assert time.monotonic() < end, "the picture stays as it is"
        time.sleep(0.2)


def test_the_page_shows_the_grid(shown):
    page, path, _ = shown
    page.wait_for(free_cells(path=path), PATIENCE)
    assert "room — one level, cells of 0.1 m" in page.text


def test_layers_switch(shown):
    page, *_ = shown
    before = picture_of(page)
    page.choose("Layer", "floor")
    page.wait_for("z [m]", PATIENCE)
    wait_for_other(page, before)
    page.choose("Layer", "occupancy")


def test_the_radius_slider_frees_what_inflate_frees(shown):
    page, path, _ = shown
    page.set_number("Radius [m]", 0.25)
    page.wait_for(free_cells(path=path, radius=0.25), PATIENCE)
    page.press("As baked")
    page.wait_for(free_cells(path=path), PATIENCE)


def test_two_clicks_make_a_path(shown):
    page, *_ = shown
    page.choose("A click", "sets start, then goal")
    page.wait_for("Click where the path starts.", PATIENCE)
    page.click_at(0.3, 0.4)
    page.wait_for(HINT_GOAL, PATIENCE)
    page.click_at(0.75, 0.7)
    text = page.wait_for("cost", PATIENCE)
    length = float(re.search(r"([\d.]+) m, cost", text).group(1))
    assert 0.5 < length < 6
    page.press("Clear")
    page.wait_for("Click where the path starts.", PATIENCE)


def test_a_click_shows_where_a_base_reaches_a_place(shown):
    page, *_ = shown
    page.choose("A click", "shows where a base reaches it")
    page.wait_for(HINT_REACH, PATIENCE)
    before = picture_of(page)
    page.click_at(0.3, 0.4)
    page.wait_for("is in reach from", PATIENCE)
    wait_for_other(page, before)
    page.press("Clear")
    page.wait_for(HINT_REACH, PATIENCE)


def test_a_click_tells_why(shown):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    page, *_ = shown
    page.choose("A click", "tells about the cell")
    page.wait_for("Click a cell or a thing", PATIENCE)
    page.click_at(0.3, 0.4)
    assert "free" in page.wait_for("Verdict", PATIENCE)
    assert page.driver.title == "room – navbake"
    ActionChains(page.driver).send_keys(Keys.ESCAPE).perform()
    page.wait_for("Click a cell or a thing", PATIENCE)


def test_the_page_is_dark_where_the_system_is(shown):
    page, *_ = shown
    scheme = "return document.documentElement.getAttribute('data-mantine-color-scheme')"
    assert page.driver.execute_script(scheme) == "light"
    dark = {"features": [{"name": "prefers-color-scheme", "value": "dark"}]}
    page.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", dark)
    page.driver.refresh()
    wait_until(lambda: page.driver.execute_script(scheme) == "dark", "a dark page", PATIENCE)
    # what a reader chose is that reader's alone, and outlasts a reload
    with open_browser(900, 640, dark=True) as other:
        other_page = ViewerPage(other, page.driver.current_url)
        wait_until(lambda: other.execute_script(scheme) == "dark", "a dark page", PATIENCE)
        page.press("Dark or light page")
        wait_until(lambda: page.driver.execute_script(scheme) == "light", "light", PATIENCE)
        page.driver.refresh()
        page.wait_for("room — one level", PATIENCE)
        time.sleep(1.0)  # what would darken it
        assert page.driver.execute_script(scheme) == "light"
        assert other.execute_script(scheme) == "dark"
        assert "room" in other_page.text


def test_a_phones_panel_is_folded_until_its_bar_is_pressed(shown):
    page, *_ = shown
    with open_browser(420, 800) as phone:
        phone.get(page.driver.current_url)
        bar = wait_until(
            lambda: phone.find_elements("css selector", '[style*="height: 3.5em"]'), "the bar"
        )[0]
        top = "return arguments[0].getBoundingClientRect().top"
        wait_until(lambda: phone.execute_script(top, bar) > 700, "a folded panel", PATIENCE)
        bar.click()
        wait_until(lambda: phone.execute_script(top, bar) < 500, "the panel", PATIENCE)
        assert "free cells" in phone.find_element("tag name", "body").text


def test_a_button_saves_a_picture(shown, tmp_path):
    page, *_ = shown
    behavior = {"behavior": "allow", "downloadPath": str(tmp_path)}
    page.driver.execute_cdp_cmd("Browser.setDownloadBehavior", behavior)
    page.press("Save a picture")
    wait_until(lambda: [*tmp_path.glob("*.png")], "the picture", PATIENCE)
    picture = Image.open(tmp_path / "room.png")
    assert min(picture.size) > 300
    assert len(picture.getcolors(1 << 24)) > 20


def rewrite(path, text):
    """Write a file as a later second would."""
    path.write_text(text)
    state = path.stat()
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns + 2_000_000_000))


def test_changed_settings_and_scenes_are_baked_again(shown):
    page, path, _ = shown
    text = path.read_text()
    rewrite(path, text.replace("0.1", "0.2"))
    page.wait_for("cells of 0.2 m", PATIENCE)
    page.wait_for(free_cells(path=path), PATIENCE)
    # broken settings are told, and the last grid stays
    rewrite(path, text + "agnt: {}\n")
    told = page.wait_for("Error", PATIENCE)
    assert "agnt" in told and "cells of 0.2 m" in told
    rewrite(path, text)
    page.wait_for("cells of 0.1 m", PATIENCE)
    scene = path.parent / "room.xml"
    rewrite(scene, scene.read_text().replace('size=".3 .35"', 'size=".5 .35"'))
    page.wait_for(free_cells(path=path), PATIENCE)


def test_nothing_leaves_the_machine_and_nothing_fails(shown):
    page, *_ = shown
    assert errors_of(page.driver) == []
    assert strangers_of(requests_of(page.driver)) == []


def test_voxels_are_cut_and_a_flight_is_a_tube(tmp_path):
    path = write_room(tmp_path)
    voxels = navbake.create_voxel_grid(path, res=0.1)
    voxels.save(tmp_path / "room.npz")
    finder = navbake.VoxelFinder(voxels, 0.15)
    finder.find_path((-1.0, -1.0, 0.5), (1.0, -1.0, 1.0)).save(tmp_path / "flight.json")
    navbake.bake(path).save(tmp_path / "room.grid.json")
    words = ("room.grid.json", "--voxels", "room.npz", "--flight", "flight.json")
    with run_view(*words, folder=tmp_path) as (_, url), open_browser(1280, 800) as driver:
        page = ViewerPage(driver, url)
        assert "goal and path" in page.wait_for("Voxels", PATIENCE)
        seen = [picture_of(page)]
        page.set_number("Cut height [m]", 0.4)
        wait_for_other(page, seen[0])
        page.tick("Scene")
        time.sleep(2.0)
        seen.append(picture_of(page))
        page.tick("Voxels")
        wait_for_other(page, seen[1])
        # the tube stays: no other blue is on the page
        pixels = np.asarray(Image.open(io.BytesIO(picture_of(page))).convert("RGB")).astype(int)
        is_tube = (pixels[..., 2] > 100) & (pixels[..., 2] - pixels[..., 0] > 60)
        assert is_tube.sum() > 500
        assert errors_of(driver) == [] and strangers_of(requests_of(driver)) == []


# what ends a table's cell, a paragraph or code in Markdown, and HTML that would run then
IMAGE = "<img src=x onerror=alert(1)>"
NASTY = (f"a\\|{IMAGE}", f"b\r\r{IMAGE}", f"c`` {IMAGE}", f"d\n\n{IMAGE}", f"e|{IMAGE}", "f&lt;g")


def test_names_from_files_do_not_run():
    facts = dict.fromkeys(("floor", "weight", "island", "level", "cell", "row", "col"), 0)
    facts |= {"free": False, "occupied": True, "center": (0.0, 0.0), "room": NASTY[0]}
    facts |= {"blockers": list(NASTY), "objects": list(NASTY), "walls": [], "doors": []}
    facts |= {"area": NASTY[1], "links": list(NASTY)}
    nothing = np.empty((0, 3))
    inspection = Inspection(facts, NASTY[0], highlighted=nothing, outline=nothing)
    server = PageServer(port=0)
    try:
        server.viser.gui.add_markdown(describe_inspection(inspection, None))
        server.viser.gui.add_markdown(f"**{escape_markdown(NASTY[1])}** shown")
        with open_browser(900, 640) as driver:
            driver.get(server.url)
            text = lambda: driver.execute_script("return document.body.innerText")  # noqa: E731
            wait_until(lambda: "shown" in text(), "the panel", PATIENCE)
            assert driver.find_elements("css selector", "img[src=x]") == []
            for name in NASTY:
                assert " ".join(name.split()) in text()
    finally:
        server.close()
