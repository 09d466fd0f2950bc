"""Debian's chromium without a screen, as tests of pages use it.

`open_browser` gives a selenium driver whose browser asks for nothing by itself, and
`requests_of` and `errors_of` tell what a page asked for and what went wrong in it.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import urlsplit

import pytest

CHROMIUM, CHROMEDRIVER = Path("/usr/bin/chromium"), Path("/usr/bin/chromedriver")
LOOPBACK = ("127.0.0.1", "localhost", "::1")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-dev-shm-usage",
    "--disable-gpu",
    # three-dimensional pages are drawn by the processor
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    # nothing is asked for but what the page asks for
    "--disable-quic",
    "--no-first-run",
    "--no-default-browser-check",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-default-apps",
    "--disable-domain-reliability",
    "--disable-extensions",
    "--disable-sync",
    "--metrics-recording-only",
    "--no-pings",
    "--hide-scrollbars",
)


def why_no_browser() -> str | None:
    """What is missing for `open_browser`, None if nothing."""
    try:
        import selenium  # noqa: F401
    except ImportError:
        return "selenium is not installed"
    missing = [str(path) for path in (CHROMIUM, CHROMEDRIVER) if not path.exists()]
    return f"no {' and no '.join(missing)} (Debian's chromium-driver)" if missing else None


needs_browser = pytest.mark.skipif(why_no_browser() is not None, reason=str(why_no_browser()))
"""Marks tests that are skipped where there is no browser."""


@contextmanager
def open_browser(
    width: int = 1280, height: int = 800, *, dark: bool = False, flags: tuple[str, ...] = ()
) -> Iterator[Any]:
    """A browser with an empty profile of its own.

    Args:
        width, height: of the page [pixels].
        dark: whether the reader prefers dark pages (`prefers-color-scheme`).
        flags: more of chromium's own.

    Yields:
        A selenium.webdriver.Chrome.
    """
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    with TemporaryDirectory(prefix="browser-", ignore_cleanup_errors=True) as profile:
        options = webdriver.ChromeOptions()
        options.binary_location = str(CHROMIUM)
        for flag in (*FLAGS, *flags, f"--user-data-dir={profile}"):
            options.add_argument(flag)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        # the path of the driver is given, so that selenium looks for none on the net
        driver = webdriver.Chrome(options=options, service=Service(str(CHROMEDRIVER)))
        try:
            resize(driver, width, height)
            scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
            driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
            yield driver
        finally:
            driver.quit()


def resize(driver: Any, width: int, height: int) -> None:
    """Give the page another size [pixels]."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)


def requests_of(driver: Any) -> list[str]:
    """The URLs that the browser asked for since this was called last, websockets included.

    What a page carries in itself (``data:``, ``blob:``) is no request.
    """
    found = []
    for entry in driver.get_log("performance"):
        message = json.loads(entry["message"])["message"]
        url = {
            "Network.requestWillBeSent": lambda sent: sent["request"]["url"],
            "Network.webSocketCreated": lambda sent: sent["url"],
        }.get(message["method"], lambda sent: None)(message["params"])
        if url is not None and not url.startswith(
            ("data:", "blob:", "chrome:", "chrome-untrusted:", "about:")
        ):
            found.append(url)
    return found


def strangers_of(urls: list[str]) -> list[str]:
    """Those of some URLs that lead off this machine."""
    return [
        url
        for url in urls
        if urlsplit(url).scheme != "file" and urlsplit(url).hostname not in LOOPBACK
    ]


def errors_of(driver: Any) -> list[str]:
    """What the console called an error since this was called last."""
    return [entry["message"] for entry in driver.get_log("browser") if entry["level"] == "SEVERE"]


def wait_until(condition: Callable[[], Any], what: str, seconds: float = 30.0) -> Any:
    """Ask until the answer is true, and return it; a failure says what was waited for."""
    end = time.monotonic() + seconds
    while True:
        found = condition()
        if found:
            return found
        assert time.monotonic() < end, f"{what}: not within {seconds:g} s"
        time.sleep(0.05)
