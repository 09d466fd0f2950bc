"""docs/ become a site: every link and anchor leads somewhere, and no page loads from elsewhere."""

from __future__ import annotations

import json
import re
import shutil
import subprocess

import pytest

import make_docs
import navbake
from browser import needs_browser, open_browser
from make_docs import CONFIG, FILES, OUTSIDE, REFERENCE, build_site
from project_paths import ROOT

pytest.importorskip("zensical", reason="zensical is not installed")
LOADED = re.compile(r"<(?:script|link|img|iframe)\b[^>]*\b(?:src|href)=[\"']?([^\"' >]+)")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("docs")
    build_site(copy_sources(folder), folder / "site")
    return folder / "site"


def copy_sources(folder):
    """A copy of the files that the site is made of, as tests of other processes build it, too."""
    root = folder / "root"
    for name in ("docs", "examples"):
        shutil.copytree(ROOT / name, root / name)
    for name in (CONFIG.name, *FILES, *OUTSIDE):
        (root / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, root / name)
    (root / "navbake").symlink_to(ROOT / "navbake")
    return root


def test_a_broken_link_is_an_error(tmp_path, monkeypatch):
    """Without docstrings on the pages of the reference, which take most of the time."""
    empty_pages = {page: (title, ()) for page, (title, _) in make_docs.REFERENCE.items()}
    monkeypatch.setattr(make_docs, "REFERENCE", empty_pages)
    monkeypatch.setattr(navbake, "__all__", [])
    root = copy_sources(tmp_path)
    with (root / "docs" / "limits.md").open("a", encoding="utf-8") as page:
        page.write("[broken](nowhere.md)")
        page.write("[broken](paths.md#nonsense)")
    with pytest.raises(SystemExit) as error:
        build_site(root, tmp_path / "site")
    assert "nowhere.md" in str(error.value)
    assert "nonsense" in str(error.value)
    assert "2 issues found" in str(error.value)


def test_a_page_that_is_left_out_is_an_error(tmp_path):
    root = copy_sources(tmp_path)
    (root / "docs" / "extra.md").write_text("# Extra", encoding="utf-8")
    with pytest.raises(SystemExit, match=r"`nav` lacks extra\.md"):
        build_site(root, tmp_path / "site")


def test_every_page_of_docs_is_on_the_site(site):
    pages = {path.stem for path in (ROOT / "docs").glob("*.md")} - {"README"}
    pages |= {"index", "pages", "contributing", "changelog", "security"}
    pages |= {"examples", "reference", "404", *(page.partition(".")[0] for page in REFERENCE)}
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
    entries = json.loads((site / "search.json").read_text(encoding="utf-8"))["items"]
    assert page in {e["location"].partition("#")[0] for e in entries if word in e["text"]}


def test_the_changelog_is_no_hit_of_the_search(site):
    entries = json.loads((site / "search.json").read_text(encoding="utf-8"))["items"]
    pages = {entry["location"].partition("#")[0] for entry in entries}
    assert "changelog.html" not in pages
    assert {"index.html", "tensors.html", "reference_tensors.html"} <= pages


def test_the_reference_has_every_public_name(site):
    for page, name in (
        ("agents", "PathFinder.find_path"),
        ("bake", "bake"),
        ("grids", "SceneGrid2D"),
        ("episodes", "spl"),
        ("errors", "ConfigError"),
    ):
        text = (site / f"reference_{page}.html").read_text(encoding="utf-8")
        assert f'{name}"' in text, name
        assert f"reference_{page}.html" in (site / "reference.html").read_text(encoding="utf-8")


def test_the_reference_has_the_text_of_fields_and_no_special_methods(site):
    texts = [path.read_text(encoding="utf-8") for path in site.glob("reference_*.html")]
    assert any("Heading at the start" in text for text in texts)  # a comment beside the field
    for text in texts:
        assert not re.search(r'id="navbake\.[\w.]*\.__\w+__"', text)


def test_a_public_name_that_is_on_no_page_of_the_reference_is_an_error(tmp_path, monkeypatch):
    monkeypatch.setitem(make_docs.REFERENCE, "reference_tensors.md", ("Tensors", ()))
    with pytest.raises(SystemExit, match="`REFERENCE` lacks tensors"):
        build_site(copy_sources(tmp_path), tmp_path / "site")


@needs_browser
def test_code_fits_the_page_of_a_small_screen(site):
    wider = "return [...document.querySelectorAll('pre code')].map((e) => e.scrollWidth - "
    wider += "e.clientWidth)"
    with open_browser(1280, 900) as driver:
        for page in ("index", "learning", "run_time", "episodes", "live", "viewer"):
            driver.get((site / f"{page}.html").as_uri())
            assert max(driver.execute_script(wider)) <= 1, page


def test_versions_are_published_after_each_other(tmp_path, monkeypatch):
    """Each from a checkout that doesn't have the branch, as a workflow's."""
    pytest.importorskip("mike", reason="mike is not installed")

    def git(*words):
        return subprocess.run(["git", *words], check=True, capture_output=True, text=True).stdout

    def build(root, folder):
        folder.mkdir(parents=True)
        (folder / "index.html").write_text("a page")

    for name in ("HOME", "XDG_CONFIG_HOME"):  # no settings of git that name a committer
        monkeypatch.setenv(name, str(tmp_path))
    for name in make_docs.BOT:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(make_docs, "build_site", build)
    bare, author = str(tmp_path / "origin.git"), ("-c", "user.name=a", "-c", "user.email=a@b.c")
    git("init", "--bare", "-q", bare)
    for number, tag in enumerate(("v0.2.1", "v0.3.0", "main")):
        root = tmp_path / str(number)
        git("clone", "-q", bare, str(root))
        monkeypatch.chdir(root)
        monkeypatch.setattr(make_docs, "ROOT", root)
        git(*author, "commit", "-q", "--allow-empty", "-m", "a commit")
        make_docs.publish(tag, push=True)
    versions = json.loads(git("-C", bare, "show", "gh-pages:versions.json"))
    found = {each["version"]: each["aliases"] for each in versions}
    assert found == {"dev": [], "0.3": ["latest"], "0.2": []}
    assert "latest/" in git("-C", bare, "show", "gh-pages:index.html")
    assert git("-C", bare, "log", "-1", "--format=%cn", "gh-pages") == "github-actions[bot]\n"
