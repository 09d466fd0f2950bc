"""docs/ become a site: every link and anchor leads somewhere, and no page loads from elsewhere."""

from __future__ import annotations

import json
import re
import subprocess
import sys

import pytest

from browser import needs_browser, open_browser
from project_paths import ROOT

pytest.importorskip("material", reason="mkdocs-material is not installed")
LOADED = re.compile(r"<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)=[\"']?([^\"' >]+)")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    done = build(ROOT / "mkdocs.yml", folder)
    assert done.returncode == 0, done.stderr
    return folder


def build(config, folder):
    """Build the site; strict: what mkdocs warns of, such as a broken link, is an error.

    Not quiet: mkdocs counts no warnings then.
    """
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-f", str(config)]
    command += ["-d", str(folder)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True)


def test_a_page_that_is_left_out_is_noticed(tmp_path):
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    text = text.replace("docs_dir: docs", f"docs_dir: {ROOT / 'docs'}").replace("limits.md, ", "")
    text = text.replace("scripts/docs_pages", str(ROOT / "scripts" / "docs_pages"))
    (tmp_path / "mkdocs.yml").write_text(text, encoding="utf-8")
    done = build(tmp_path / "mkdocs.yml", tmp_path / "site")
    assert done.returncode != 0 and "limits.md" in done.stderr


def test_every_page_of_docs_is_on_the_site(site):
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")} - {"README"}
    pages |= {"index", "pages", "contributing", "changelog", "examples", "404"}
    assert {path.stem for path in site.glob("*.html")} == pages


def test_nothing_is_loaded_from_elsewhere(site):
    for page in site.glob("*.html"):
        loaded = LOADED.findall(page.read_text(encoding="utf-8"))
        assert loaded, page
        assert [url for url in loaded if "//" in url] == [], page


def test_links_to_files_of_the_project_lead_to_pages(site):
    text = (site / "pages.html").read_text(encoding="utf-8")
    for target in ("index.html", "contributing.html", "examples.html"):
        assert target in text
    assert "../README.md" not in text


def test_the_landing_page_is_the_readme_with_its_picture(site):
    text = (site / "index.html").read_text(encoding="utf-8")
    assert "pictures/house.png" in text and "Try it" in text


def test_pages_are_in_six_groups():
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:\n")[2]
    groups = re.findall(r"^  - (\w+): \[", text, re.M)
    assert groups == ["Start", "Bake", "Use", "Export", "Operate", "Reference"]
    listed = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    assert re.findall(r"^## (\w+)", listed, re.M) == groups


@pytest.mark.parametrize(
    ("word", "page"),
    [
        ("OccupancyGrid", "convert.html"),
        ("PointNav", "episodes.html"),
        ("SPL", "episodes.html"),
        ("episode", "episodes.html"),
    ],
)
def test_the_search_finds_the_words_of_the_field(site, word, page):
    entries = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))[
        "docs"
    ]
    assert page in {e["location"].partition("#")[0] for e in entries if word in e["text"]}


@needs_browser
def test_code_fits_the_page_of_a_small_screen(site):
    wider = "return [...document.querySelectorAll('pre code')].map((e) => e.scrollWidth - "
    wider += "e.clientWidth)"
    with open_browser(1280, 900) as driver:
        for page in ("index", "learning", "run_time", "episodes", "live", "viewer"):
            driver.get((site / f"{page}.html").as_uri())
            assert max(driver.execute_script(wider)) <= 1, page
