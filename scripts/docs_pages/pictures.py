"""Takes pictures of navbake's pages in Debian's chromium, for scripts/make_pictures.py."""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "tests")]

import navbake  # noqa: E402
from browser import open_browser, wait_until, why_no_browser  # noqa: E402 (of the tests)
from viewer_page import ViewerPage  # noqa: E402 (of the tests)

# notices, as that chromium draws without a graphics card
HIDE_NOTICES = """
  const style = document.createElement("style");
  style.textContent = ".mantine-Notification-root { display: none }";
  document.head.append(style);
"""
STILL = 4.0  # how long a scene has to look the same [s]
SIZE = (1000, 720)  # of the page [pixels]
__all__ = ["take_report", "take_viewer", "why_no_browser"]


def take_viewer() -> bytes:
    """The house in the viewer: its ground floor, looked into, with its rooms."""
    settings = ROOT / "configs" / "house.yaml"
    grid = navbake.bake(settings)
    with (
        navbake.view(grid, settings, port=0, open_page=False) as viewer,
        open_browser(*SIZE) as web,
    ):
        page = ViewerPage(web, viewer.url)
        web.execute_script(HIDE_NOTICES)
        page.choose("Level", grid.level_names[0])
        page.choose("Layer", "rooms")
        _wait_until_still(web)
        taken: bytes = web.get_screenshot_as_png()
        return taken


def _wait_until_still(web: Any) -> None:
    """Wait until the scene looks the same for a while: it comes piece by piece."""
    canvas = web.find_elements("tag name", "canvas")[-1]
    last, since = b"", time.monotonic()

    def is_still() -> bool:
        nonlocal last, since
        now = canvas.screenshot_as_png
        if now != last:
            last, since = now, time.monotonic()
        return time.monotonic() - since > STILL

    wait_until(is_still, "the picture", 120.0)


def take_report() -> bytes:
    """A report on the house, and on the house for a wider agent: what differs."""
    grid = navbake.bake(ROOT / "configs" / "house.yaml")
    with tempfile.TemporaryDirectory() as folder, open_browser(*SIZE) as web:
        path = Path(folder, "report.html")
        navbake.report([grid, grid.inflate(0.3)], path, names=["as baked", "0.3 m"])
        web.get(path.as_uri())
        web.find_elements("css selector", "#grids button")[2].click()
        wait_until(lambda: web.execute_script("return Boolean(level().unpacked)"), "changes")
        web.execute_script("window.scrollTo(0, 0)")
        taken: bytes = web.get_screenshot_as_png()
        return taken
