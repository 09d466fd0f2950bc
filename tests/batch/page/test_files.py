"""The page of a batch that writes into a store lies in the store."""

from __future__ import annotations

from pathlib import Path

import pytest

from batch_in_process import Told, stay_in_process
from batch_scenes import draw_room
from navbake.batch.job import Plan
from navbake.batch.page.page import LivePage, draw_thumbnails, write_page
from navbake.batch.run import Means, run_batch
from navbake.batch.scenes import list_jobs
from navbake.batch.store import read_file, remove_files, sizes_below
from report_pages import content_of_page

pytest.importorskip("fsspec")
FOLDER = "memory://pages/out"


def test_a_store_has_thumbnails_and_the_page(tmp_path, monkeypatch):
    stay_in_process(monkeypatch)
    for name in ("first", "second"):
        (tmp_path / f"{name}.xml").write_text(draw_room(1))
    jobs = list_jobs([str(tmp_path / "*.xml")])
    plan = Plan(FOLDER, {"grid": {"cell_size": 0.2}}, thumbnail=True)
    run_batch(plan, jobs, Means(), Told())
    thumbnail = f"{FOLDER}/first/thumbnail.png"
    drawn = read_file(thumbnail)
    remove_files(FOLDER, ["first/thumbnail.png"])
    assert run_batch(plan, jobs, Means(), Told()).skipped == 2
    assert draw_thumbnails(FOLDER, lambda share: None) == 0
    assert read_file(thumbnail) == drawn
    remove_files(FOLDER, ["second/thumbnail.png"])
    write_page(FOLDER)
    shown = content_of_page(read_file(f"{FOLDER}/index.html"))
    made = [(scene["id"], scene["thumbnail"]) for scene in shown["scenes"]]
    assert made == [("first", True), ("second", False)]
    assert (shown["title"], shown["base"]) == ("out", ".")
    remove_files(FOLDER, ["index.html"])
    LivePage(FOLDER, 2).refresh(1)
    assert "index.html" not in sizes_below(FOLDER)
    # what is baked anew without a page has no old thumbnail
    run_batch(Plan(FOLDER, {}), jobs, Means(), Told())
    assert not any(Path(name).name == "thumbnail.png" for name in sizes_below(FOLDER))
