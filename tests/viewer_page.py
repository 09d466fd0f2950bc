"""The page of `navbake view` in a browser, by what a reader sees of it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from browser import wait_until

READ = """return [...document.querySelectorAll('.mantine-Text-root, table, .mantine-Title-root')]
    .filter(e => e.offsetParent).map(e => e.innerText).join('\\n')"""


class ViewerPage:
    """A page that is open in a browser."""

    def __init__(self, driver: Any, url: str) -> None:
        self.driver = driver
        driver.get(url)
        wait_until(lambda: "free cells" in self.text, "the panel")

    @property
    def text(self) -> str:
        """All that can be read on the panel."""
        return str(self.driver.execute_script("return document.body?.innerText ?? ''"))

    def wait_for(self, text: str, seconds: float = 30.0) -> str:
        """Wait until the panel says something, and return all of it."""
        wait_until(lambda: text in self.text, f"{text!r} in {self.text!r}", seconds)
        return self.text

    def input(self, label: str) -> Any:
        """What belongs to a label."""
        path = f"//label[normalize-space()={label!r}]"
        target = self.driver.find_element("xpath", path).get_attribute("for")
        return self.driver.find_element("id", target)

    def choose(self, label: str, option: str) -> None:
        """Choose an option of a drop-down list."""
        self.input(label).click()
        path = f"//*[@role='option'][normalize-space()={option!r}]"
        found = wait_until(lambda: self.driver.find_elements("xpath", path), option)
        self.driver.execute_script("arguments[0].click()", found[-1])

    def set_number(self, label: str, value: float) -> None:
        """Write a number beside a slider."""
        from selenium.webdriver.common.keys import Keys

        slider = self.input(label)
        number = slider.find_element("xpath", "./..//input[@type='text']")
        number.send_keys(Keys.CONTROL, "a")
        number.send_keys(str(value), Keys.TAB)

    def tick(self, label: str) -> None:
        """Tick a box, or untick it."""
        self.driver.execute_script("arguments[0].click()", self.input(label))

    def press(self, label: str) -> None:
        """Press a button."""
        path = f"//button[normalize-space()={label!r}]"
        found = wait_until(lambda: self.driver.find_elements("xpath", path), label)
        self.driver.execute_script("arguments[0].click()", found[0])

    def open_folder(self, name: str) -> None:
        """Unfold a part of the panel."""
        path = f"//*[normalize-space(text())={name!r}]"
        self.driver.find_elements("xpath", path)[-1].click()

    def click_at(self, x: float, y: float) -> None:
        """Click at a place of the picture, from 0, 0 at its upper left to 1, 1."""
        from selenium.webdriver.common.action_chains import ActionChains

        canvas = self.driver.find_element("tag name", "canvas")
        size = canvas.size
        right, down = (x - 0.5) * size["width"], (y - 0.5) * size["height"]
        ActionChains(self.driver).move_to_element_with_offset(canvas, right, down).click().perform()


@contextmanager
def run_view(*arguments: str, folder: Path | None = None) -> Iterator[tuple[Any, str]]:
    """Run `navbake view` until the end of the block: its process, and the link that it prints."""
    command = [sys.executable, "-m", "navbake", "view", *arguments, "--no-open", "--port", "0"]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("http"), process.communicate()[1]
        yield process, line.split()[0]
    finally:
        if process.poll() is None:
            process.kill()
        process.communicate()
