"""axe-core finds nothing serious on the pages: contrast, names of controls, keyboard.

Skipped unless `npm install axe-core` was run in the checkout, or AXE names its `axe.min.js`.
"""

import json
import os
from pathlib import Path

import pytest

import navbake
from browser import needs_browser, open_browser, wait_until
from navbake.auditor.audit import audit
from navbake.batch.index import INDEX_NAME
from navbake.batch.page import write_page
from navbake.views.report import write_report
from project_paths import GOLDEN, ROOT

AXE = Path(os.environ.get("AXE") or ROOT / "node_modules" / "axe-core" / "axe.min.js")
pytestmark = [
    needs_browser,
    pytest.mark.skipif(not AXE.is_file(), reason="no axe-core: npm install axe-core"),
]
RUN = """
const done = arguments[0];
axe.run({ resultTypes: ["violations"] }).then((found) => done(found.violations
  .filter((each) => ["serious", "critical"].includes(each.impact))
  .map((each) => `${each.id}: ${each.help}: ${each.nodes.map((n) => n.html).join(" | ")}`)));
"""


def serious(url, ready, dark):
    with open_browser(1280, 900, dark=dark) as driver:
        driver.get(url)
        wait_until(lambda: driver.execute_script(f"return Boolean({ready})"), "the page")
        # by the browser's own door: the pages' policy allows no other script
        driver.execute_script(AXE.read_text(encoding="utf-8"))
        return driver.execute_async_script(RUN)


@pytest.mark.parametrize("dark", [False, True])
def test_a_report(tmp_path, dark):
    grid = navbake.load(GOLDEN / "house.grid.json.gz")
    path = write_report([grid, grid.inflate(0.3)], tmp_path / "a.html", audits=[audit(grid)] * 2)
    assert serious(path.as_uri(), "level().unpacked", dark) == []


@pytest.mark.parametrize("dark", [False, True])
def test_the_page_of_a_batch(tmp_path, dark):
    made = {"status": "ok", "free_area": 2.5, "cells": 10, "levels": 1, "doors": 0, "rooms": 1}
    made |= {"seconds": 0.5, "warnings": ["set `a.b`"], "stages": {"scene": 0.1}}
    rows = [{"id": f"scene {k}", **made, "cells": 10 * k} for k in range(30)]
    rows.append({"id": "broken", "status": "failed", "how": "error", "error": "no `mesh`"})
    (tmp_path / INDEX_NAME).write_text("".join(json.dumps(row) + "\n" for row in rows))
    write_page(tmp_path)
    page = (tmp_path / "index.html").as_uri()
    assert serious(page, "document.body.dataset.ready", dark) == []


def test_the_documentation(tmp_path):
    pytest.importorskip("zensical", reason="zensical is not installed")
    from make_docs import build_site
    from test_docs_site import copy_sources

    build_site(copy_sources(tmp_path), tmp_path / "site")
    for page in ("index", "settings", "viewer"):
        assert (
            serious((tmp_path / "site" / f"{page}.html").as_uri(), "document.body", False) == []
        ), page
