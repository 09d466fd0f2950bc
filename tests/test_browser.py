"""The browser that pages are tried in sees what they ask for and what fails in them."""

import pytest

from browser import errors_of, needs_browser, open_browser, requests_of, strangers_of, wait_until

PAGE = """<!doctype html><title>a page</title><body>
<script>
  document.title = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
  const gl = document.createElement("canvas").getContext("webgl2");
  document.body.textContent = `${innerWidth} ${innerHeight} ${gl !== null}`;
  fetch("http://192.0.2.1:9/asked").catch(() => {});
  console.error("planted");
</script>"""


@needs_browser
def test_the_browser_tells_what_a_page_does(tmp_path):
    page = tmp_path / "page.html"
    page.write_text(PAGE)
    with open_browser(390, 700, dark=True) as driver:
        driver.get(page.as_uri())
        assert driver.title == "dark"
        assert driver.find_element("tag name", "body").text == "390 700 true"
        asked = requests_of(driver)
        assert page.as_uri() in asked
        assert strangers_of(asked) == ["http://192.0.2.1:9/asked"]
        assert any("planted" in line for line in errors_of(driver))


def test_waiting_says_what_for():
    assert wait_until(lambda: 3, "three") == 3
    with pytest.raises(AssertionError, match="the moon: not within 0"):
        wait_until(lambda: None, "the moon", 0.0)
