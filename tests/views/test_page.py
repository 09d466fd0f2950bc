"""The page in a browser: it shows what the grid holds, asks for nothing, and nothing fails."""

from __future__ import annotations

import pytest

import navbake
from browser import (
    errors_of,
    needs_browser,
    open_browser,
    requests_of,
    resize,
    strangers_of,
    wait_until,
)
from grid_maps import level_from
from navbake.auditor.audit import audit
from navbake.views.report import write_report
from project_paths import GOLDEN

POINT = """
  const box = canvas.getBoundingClientRect(), [px, py] = toPixels(arguments[0], arguments[1]);
  const at = { clientX: box.left + px, clientY: box.top + py };
  canvas.dispatchEvent(new PointerEvent("pointermove", at));
"""
# the colour of the canvas where a world position is, without the pointer's cross
LOOK = """
  state.pointed = null;
  draw();
  const [px, py] = toPixels(arguments[0], arguments[1]), ratio = window.devicePixelRatio || 1;
  return [...pen.getImageData(px * ratio, py * ratio, 1, 1).data].slice(0, 3);
"""


@pytest.fixture(scope="module")
def house():
    return navbake.load(GOLDEN / "house.grid.json.gz")


@pytest.fixture(scope="module")
def page(house, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    wider = house.inflate(0.4)
    write_report([house, wider], path, names=["house", "wider"], audits=[audit(house), None])
    return path


def press(driver, box, text):
    [button] = [b for b in driver.find_elements("css selector", f"#{box} button") if b.text == text]
    button.click()
    wait_until(lambda: driver.execute_script("return pictureOf(layer()).complete"), "the picture")


def told(driver, x, y):
    driver.execute_script(POINT, x, y)
    return driver.find_element("id", "pointed").text


@needs_browser
@pytest.mark.parametrize(("width", "dark"), [(1280, False), (390, True)])
def test_a_reader_looks_at_two_grids(page, house, width, dark):
    with open_browser(width, 900, dark=dark) as driver:
        driver.get(page.as_uri())
        wait_until(lambda: driver.execute_script("return Boolean(level().unpacked)"), "the cells")
        assert driver.title == "house, wider"
        # nothing is wider than the page
        assert driver.execute_script("return document.documentElement.scrollWidth") <= width
        for number, level in enumerate(house.levels):
            press(driver, "levels", house.level_names[number])
            wait_until(lambda: driver.execute_script("return Boolean(level().unpacked)"), "cells")
            cell = house.describe_cell(at_blocked(house, number), number)
            words = told(driver, *cell["center"])
            assert f"row {cell['row']}, col {cell['col']}, cell {cell['cell']}" in words
            assert "blocked" in words
            assert all(name in words for name in cell["blockers"])
            free = house.describe_cell(at_free(level), number)
            words = told(driver, *free["center"])
            assert f"floor {free['floor']:.3f} m, free" in words
        colors = {}
        for layer in ("occupancy", "rooms", "clearance"):
            press(driver, "layers", layer)
            colors[layer] = tuple(driver.execute_script(LOOK, *free["center"]))
        assert len(set(colors.values())) == 3
        press(driver, "grids", "difference")
        press(driver, "levels", house.level_names[0])
        assert driver.find_element("id", "pointed").text.startswith("Point at a cell")
        wait_until(lambda: driver.execute_script("return Boolean(level().unpacked)"), "changes")
        x, y = at_changed(house)
        words = told(driver, x, y)
        assert "became blocked" in words
        assert "house: row" in words
        assert "wider: row" in words
        assert errors_of(driver) == []
        assert strangers_of(requests_of(driver)) == []
        # what is read of a cell and the legend are beside the map where there is room
        tops = """return ['canvas', 'pointed', 'legend'].map((id) =>
            find(id).getBoundingClientRect().top)"""
        canvas, pointed, legend = driver.execute_script(tops)
        assert (pointed - canvas < 50) == (width > 900)
        assert (legend - canvas < 300) == (width > 900)
        # free cells are light and occupied ones dark, whatever the page is
        press(driver, "grids", "house")
        press(driver, "layers", "occupancy")
        assert driver.execute_script("return getComputedStyle(canvas).filter") == "none"
        assert sum(driver.execute_script(LOOK, *free["center"])[:3]) > 600
        blocked = house.describe_cell(at_blocked(house, 0), 0)
        assert sum(driver.execute_script(LOOK, *blocked["center"])[:3]) < 300


@needs_browser
def test_settings_in_warnings_are_code(tmp_path):
    level = level_from("..")
    level.metadata["navbake"] = {"warnings": ["set `grid.cell_size` or `<b>`, or 1 ` more"]}
    write_report(level, tmp_path / "report.html")
    with open_browser() as driver:
        driver.get((tmp_path / "report.html").as_uri())
        code = driver.find_elements("css selector", "#warnings code")
        assert [each.text for each in code] == ["grid.cell_size", "<b>"]
        assert driver.find_element("id", "warnings").text.endswith("or 1 ` more")


@needs_browser
def test_the_map_zooms_and_moves(page):
    with open_browser() as driver:
        driver.get(page.as_uri())
        before = driver.execute_script("return {...view}")
        press(driver, "zoom", "+")
        assert driver.execute_script("return view.scale") == pytest.approx(1.5 * before["scale"])
        # what is under the pointer stays there when one scrolls
        stays = """
          const box = canvas.getBoundingClientRect(), at = toWorld(40, 60);
          const turn = { clientX: box.left + 40, clientY: box.top + 60, deltaY: -300 };
          canvas.dispatchEvent(new WheelEvent("wheel", turn));
          const now = toWorld(40, 60);
          return Math.hypot(now[0] - at[0], now[1] - at[1]) * view.scale;
        """
        assert driver.execute_script(stays) < 1  # pixel: events have whole ones
        press(driver, "zoom", "all")
        assert driver.execute_script("return {...view}") == pytest.approx(before)


@needs_browser
def test_the_map_fits_a_window_that_changes_until_it_is_moved(page):
    corners = """
      const own = level(), right = own.xMin + own.width * own.cellSize;
      const [x0, y0] = toPixels(own.xMin, own.yMax);
      const [x1, y1] = toPixels(right, own.yMax - own.height * own.cellSize);
      return Math.min(x0, y0, canvas.clientWidth - x1, canvas.clientHeight - y1);
    """
    with open_browser(1280, 900) as driver:
        driver.get(page.as_uri())
        assert driver.execute_script(corners) >= 0
        resize(driver, 500, 900)
        is_fitted = lambda: driver.execute_script(corners) >= 0  # noqa: E731
        wait_until(is_fitted, "the map to fit the narrow window")
        press(driver, "zoom", "+")
        before = driver.execute_script("return view.scale")
        width = driver.execute_script("return canvas.width")
        resize(driver, 900, 900)
        wait_until(lambda: driver.execute_script("return canvas.width") != width, "a wider map")
        assert driver.execute_script("return view.scale") == before


@needs_browser
def test_names_in_the_page_are_text(tmp_path, house):
    level = house.levels[0].with_layers(metadata={"sceneId": "<img src=x onerror=alert(1)>"})
    path = tmp_path / "report.html"
    write_report(level, path)
    with open_browser() as driver:
        driver.get(path.as_uri())
        assert driver.find_element("id", "title").text == "<img src=x onerror=alert(1)>"
        assert driver.find_elements("css selector", "img") == []
        assert errors_of(driver) == []


@needs_browser
def test_grids_without_a_common_level_have_an_empty_difference(tmp_path):
    path = tmp_path / "report.html"
    low, high = level_from("..\n.."), level_from("..\n..", ground=10.0)
    write_report([low, high], path, names=["low", "high"])
    with open_browser() as driver:
        driver.get(path.as_uri())
        find = lambda name: driver.find_element("xpath", f"//nav/button[.={name!r}]")  # noqa: E731
        find("difference").click()
        assert "Levels that only one has" in driver.find_element("id", "tables").text
        find("high").click()
        assert "outside" not in told(driver, 0.05, -0.05)
        assert errors_of(driver) == []


@needs_browser
def test_doors_have_their_names_on_the_map(page, house):
    with open_browser() as driver:
        driver.get(page.as_uri())
        press(driver, "layers", "doors")
        drawn = driver.execute_script("""
          const write = pen.fillText.bind(pen), texts = [];
          pen.fillText = (text, x, y) => { texts.push(text); write(text, x, y); };
          draw();
          return texts;
        """)
        shown = {door.id for door in house.doors if 0 in door.levels}
        assert any(text.startswith(name) for text in drawn for name in shown)
        legend = driver.find_element("id", "legend").text.splitlines()
        for entry in ("door leaf", "doorway", "door, open", "free", "occupied"):
            assert entry in legend
        press(driver, "layers", "floor")
        assert "door" not in driver.find_element("id", "legend").text


@needs_browser
def test_the_readout_is_above_the_fold_and_the_free_area_first(page, house):
    with open_browser(1280, 800) as driver:
        driver.get(page.as_uri())
        wait_until(lambda: driver.execute_script("return Boolean(level().unpacked)"), "the cells")
        told(driver, *at_blocked(house, 0))
        bottom = "return find('pointed').getBoundingClientRect().bottom"
        assert driver.execute_script(bottom) < 700
        assert driver.find_element("css selector", "#facts dt").text == "free area"


@needs_browser
def test_names_of_doors_stand_off_their_leaves(page):
    with open_browser() as driver:
        driver.get(page.as_uri())
        press(driver, "layers", "doors")
        overlaps = driver.execute_script("""
          const write = pen.fillText.bind(pen), boxes = [];
          pen.fillText = (text, x, y) => {
            const half = pen.measureText(text).width / 2;
            boxes.push([x - half, y - 6, x + half, y + 6]);
            write(text, x, y);
          };
          draw();
          const leaves = layer().keepClear.map(([x0, y0, x1, y1]) =>
            [...toPixels(x0, y1), ...toPixels(x1, y0)]);
          return [boxes.length, boxes.filter((a) => leaves.some((b) =>
            a[0] < b[2] && a[2] > b[0] && a[1] < b[3] && a[3] > b[1])).length];
        """)
        assert overlaps[0] >= 4 and overlaps[1] == 0


def at_blocked(grid, number):
    """A position in a blocked cell whose blocker is known."""
    level = grid.levels[number]
    cell = next(cell for cell in level.user_data if not level.free.flat[cell])
    return level.lattice.positions(*divmod(cell, level.width)).tolist()


def at_free(level):
    cell = int(level.free.ravel().argmax())
    return level.lattice.positions(*divmod(cell, level.width)).tolist()


def at_changed(house):
    level = house.levels[0]
    closed = level.free & ~house.inflate(0.4).levels[0].free
    return level.lattice.positions(*divmod(int(closed.ravel().argmax()), level.width)).tolist()
