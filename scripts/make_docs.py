"""Makes the documentation's site in build/site, by zensical, and publishes versions, by mike.

    pip install -e ".[docs]"
    python scripts/make_docs.py                  # as CI does: a broken link is an error
    python scripts/make_docs.py --publish v0.3.0 # commits it to the branch gh-pages, as 0.3
    python scripts/make_docs.py --publish v0.3.0 --push

zensical takes pages of one folder, so docs/ is copied to build/docs beside the README and its like,
the examples, and the reference, which mkdocstrings makes of docstrings. The README is the landing
page, and the list of pages in docs/README.md a page of its own. The links of those others lead from
the project's root, and links of docs/ lead out to them; both become links from page to page.
"""

from __future__ import annotations

import argparse
import os
import posixpath
import re
import shutil
import subprocess
import sys
from pathlib import Path

import yaml

import navbake

ROOT = Path(__file__).resolve().parents[1]
CONFIG = Path("mkdocs.yml")
OUTSIDE = {
    "README.md": "index.md",
    "docs/README.md": "pages.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "SECURITY.md": "security.md",
}
FILES = ("CITATION.cff", "CODE_OF_CONDUCT.md")  # that pages link to, and that are no pages
EXAMPLES = "examples.md"
LINK = re.compile(r"\]\((?!\w+:|#)([^)#\s]+)(#[^)\s]*)?\)")
BOT = {
    "GIT_COMMITTER_NAME": "github-actions[bot]",
    "GIT_COMMITTER_EMAIL": "41898282+github-actions[bot]@users.noreply.github.com",
}
# pages of the reference: title, and the public names on it; of modules, all that they have
REFERENCE = {
    "reference_bake.md": (
        "Bake and verify",
        ("bake", "Baker", "BakeConfig", "samples", "verify", "audit", "report", "view", "draw"),
    ),
    "reference_grids.md": (
        "Grids",
        (
            "load", "from_grscenes", "from_nav2", "from_npz", "from_omnigibson", "from_procthor",
            "SceneGrid2D", "MultiLevelGrid", "InflationWarning",
            "DoorStateWarning",
        ),
    ),
    "reference_agents.md": ("Paths and places", ("PathFinder", "Agent")),
    "reference_voxels.md": (
        "Voxels and flights",
        (
            "load_voxels", "create_voxel_grid", "Voxelizer", "VoxelGrid", "VoxelFinder",
            "LocalFlight", "ExploredMap",
        ),
    ),
    "reference_episodes.md": ("Episodes and scores", ("episodes", "scores")),
    "reference_tensors.md": ("Tensors", ("tensors",)),
    "reference_errors.md": ("Errors and tests", ("errors", "testing")),
}  # fmt: skip
HIDDEN_FROM_SEARCH = "---\nsearch:\n  exclude: true\n---\n\n"


def collect_pages(root: Path, target: Path) -> None:
    """Write all pages of a checkout, and what they show, into a folder that is made anew.

    Raises:
        SystemExit: a page is not in the navigation of mkdocs.yml.
    """
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(root / "docs", target, ignore=shutil.ignore_patterns("README.md"))
    for name in FILES:
        shutil.copy(root / name, target / (name if name.endswith(".cff") else f"{name}.txt"))
    pages = {f"docs/{path.name}": path.name for path in (root / "docs").glob("*.md")} | OUTSIDE
    for name, page in pages.items():
        text = (root / name).read_text(encoding="utf-8")
        (target / page).write_text(_lead_to_pages(text, posixpath.dirname(name)), encoding="utf-8")
    (target / EXAMPLES).write_text(_list_examples(root), encoding="utf-8")
    # the newest changes name all words of the field, and would be the first hit for each of them
    changelog = (target / "changelog.md").read_text(encoding="utf-8")
    (target / "changelog.md").write_text(HIDDEN_FROM_SEARCH + changelog, encoding="utf-8")
    for page, text in _make_reference().items():
        (target / page).write_text(text, encoding="utf-8")
    listed = (root / CONFIG).read_text(encoding="utf-8").partition("\nnav:\n")[2]
    left_out = [path.name for path in sorted(target.glob("*.md")) if path.name not in listed]
    if left_out:
        sys.exit(f"{CONFIG}: `nav` lacks {', '.join(left_out)}")


def _lead_to_pages(text: str, folder: str) -> str:
    """Turn links between files of the project into links between pages."""

    def replace(link: re.Match[str]) -> str:
        target, anchor = link[1], link[2] or ""
        path = posixpath.normpath(posixpath.join(folder, target))
        if path == "examples" or path.startswith("examples/"):
            return f"]({EXAMPLES}{_anchor_of(path)})"
        if path in FILES and path.endswith(".md"):
            return f"]({path}.txt)"
        return f"]({OUTSIDE.get(path, path.removeprefix('docs/'))}{anchor})"

    return LINK.sub(replace, text)


def _list_examples(root: Path) -> str:
    """The scripts of examples/ as one page."""
    parts = ["# Examples\n"]
    for path in sorted((root / "examples").glob("*.py")):
        code = path.read_text(encoding="utf-8")
        parts.append(f"## {path.name}\n\n```python\n{code}```\n")
    return "\n".join(parts)


def _anchor_of(path: str) -> str:
    """The anchor that the heading of an example has, as the site makes it."""
    name = posixpath.basename(path)
    return f"#{name.lower().replace('.', '')}" if name.endswith(".py") else ""


def _make_reference() -> dict[str, str]:
    """The pages of public names, whose docstrings mkdocstrings fills in, and a list of the pages.

    Raises:
        SystemExit: a public name is on no page.
    """
    errors = {name for name in navbake.__all__ if name in vars(navbake.errors)}
    listed = {name for _, names in REFERENCE.values() for name in names}
    left_out = sorted({*navbake.__all__} - errors - listed - {"__version__"})
    if left_out:
        sys.exit(f"scripts/make_docs.py: `REFERENCE` lacks {', '.join(left_out)}")
    overview = ["# Reference", "", "All public names, from their docstrings.", ""]
    pages = {}
    for page, (title, names) in REFERENCE.items():
        overview.append(f"- [{title}]({page}): {', '.join(f'`{name}`' for name in names)}")
        parts = [f"# {title}\n"]
        for name in names:
            made = getattr(navbake, name, None)
            place = f"navbake.{name}"  # of a module
            if hasattr(made, "__qualname__"):
                place = f"{made.__module__}.{made.__qualname__}"
            parts.append(f"::: {place}\n    options: {{ heading: navbake.{name} }}\n")
        pages[page] = "\n".join(parts)
    pages["reference.md"] = "\n".join(overview) + "\n"
    return pages


def build_site(root: Path, folder: Path) -> None:
    """Build the site of a checkout into a folder; a warning, as of a broken link, is an error."""
    settings = yaml.safe_load((root / CONFIG).read_text(encoding="utf-8"))
    collect_pages(root, root / settings["docs_dir"])
    program = [sys.executable, "-m", "zensical", "build", "--strict", "--clean", "-f", str(CONFIG)]
    # mkdocs.yml names an extension beside this script
    search_path = os.pathsep.join(
        [str(Path(__file__).parent), *filter(None, [os.environ.get("PYTHONPATH")])]
    )
    done = subprocess.run(
        program,
        cwd=root,
        env={**os.environ, "PYTHONPATH": search_path},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        text = re.sub(r"\x1b\[[\d;]*m", "", f"{done.stdout}{done.stderr}")  # colours
        sys.exit(text.partition("Traceback")[0])
    if folder != root / settings["site_dir"]:
        shutil.copytree(root / settings["site_dir"], folder, dirs_exist_ok=True)


def publish(tag: str, push: bool) -> None:
    """Commit the site to the branch gh-pages: a tag as its version and `latest`, main as `dev`.

    The commit follows the published branch, and is pushed if `push`. It is of the bot of GitHub's
    actions where git knows no committer.
    """
    from mike import commands  # only who publishes needs it

    def git(*words: str, check: bool = False) -> int:
        return subprocess.run(["git", *words], cwd=ROOT, check=check).returncode

    git("fetch", "--quiet", "origin", "gh-pages:gh-pages")  # not there before the first version
    if git("config", "--get", "user.email"):
        os.environ |= BOT
    found = re.fullmatch(r"v(\d+\.\d+)\.\d+", tag)
    version, aliases = (found[1], ["latest"]) if found else ("dev", [])
    site = ROOT / "build" / "site"
    with commands.deploy({"site_dir": str(site)}, version, aliases=aliases, update_aliases=True):
        build_site(ROOT, site)
    if found:
        commands.set_default("latest", allow_empty=True)
    if push:
        git("push", "--quiet", "origin", "gh-pages", check=True)
    print(f"gh-pages has {version}{'' if push else ': git push origin gh-pages publishes it'}")


def main() -> None:
    """Read the arguments."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--publish", metavar="TAG", help="a tag (v0.3.0), or main")
    parser.add_argument("--push", action="store_true", help="push the branch that has it")
    arguments = parser.parse_args()
    if arguments.push and not arguments.publish:
        parser.error("expected --publish TAG with --push")
    if arguments.publish:
        publish(arguments.publish, arguments.push)
    else:
        build_site(ROOT, ROOT / "build" / "site")
        print(ROOT / "build" / "site" / "index.html")


if __name__ == "__main__":
    main()
