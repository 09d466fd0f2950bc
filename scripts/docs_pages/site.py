"""Makes a site of docs/, see mkdocs.yml, with pages of the README and its like and the examples.

The README is the landing page, and the list of pages in docs/README.md a page of its own. mkdocs
takes files of docs/ only. The links of those others lead from the project's root, and links
of docs/ lead out to them; both are turned into links from page to page.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[2]
OUTSIDE = {
    "README.md": "index.md",
    "docs/README.md": "pages.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
}
FILES = ("CITATION.cff",)  # that pages link to, and that are no pages
EXAMPLES = "examples.md"
LINK = re.compile(r"\]\((?!\w+:|#)([^)#\s]+)(#[^)\s]*)?\)")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are not in docs/, or have another name there."""
    listed = files.get_file_from_path("README.md")
    if listed is not None:
        files.remove(listed)
    for name, page in OUTSIDE.items():
        text = (ROOT / name).read_text(encoding="utf-8")
        files.append(File.generated(config, page, content=text))
    for name in FILES:
        files.append(File.generated(config, name, abs_src_path=str(ROOT / name)))
    files.append(File.generated(config, EXAMPLES, content=_list_examples()))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn links between files of the project into links between pages."""
    own = {page: name for name, page in OUTSIDE.items()}
    folder = posixpath.dirname(own.get(page.file.src_uri, "docs/"))

    def replace(link: re.Match[str]) -> str:
        target, anchor = link[1], link[2] or ""
        path = posixpath.normpath(posixpath.join(folder, target))
        if path == "examples" or path.startswith("examples/"):
            return f"]({EXAMPLES}{_anchor_of(path)})"
        return f"]({OUTSIDE.get(path, path.removeprefix('docs/'))}{anchor})"

    return LINK.sub(replace, markdown)


def _list_examples() -> str:
    """The scripts of examples/ as one page."""
    parts = ["# Examples\n"]
    for path in sorted((ROOT / "examples").glob("*.py")):
        code = path.read_text(encoding="utf-8")
        parts.append(f"## {path.name}\n\n```python\n{code}```\n")
    return "\n".join(parts)


def _anchor_of(path: str) -> str:
    """The anchor that the heading of an example has, as mkdocs makes it."""
    name = posixpath.basename(path)
    return f"#{name.lower().replace('.', '')}" if name.endswith(".py") else ""
