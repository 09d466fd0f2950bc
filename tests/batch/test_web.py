"""Lists on the web lead to their own host, and nowhere else unless that is allowed."""

import json
import threading
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from batch_in_process import run_sources, stay_in_process
from navbake.batch import store
from navbake.batch.store import check_host
from navbake.errors import NavbakeError

run = partial(run_sources, settings={"grid": {"cell_size": 0.5}})
FLOOR = '<mujoco><worldbody><geom type="box" size="2 2 .1" pos="0 0 -.1"/></worldbody></mujoco>'

FAR = ("other", "away", "yaml")  # rows that lead to another host


@pytest.fixture(autouse=True)
def only_own_hosts(monkeypatch):
    monkeypatch.setattr(store, "_allowed_hosts", set())


@pytest.fixture
def web(tmp_path, monkeypatch):
    """A server that two hosts reach, and what was asked of it, by host."""
    pytest.importorskip("fsspec")
    pytest.importorskip("aiohttp")
    asked = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append((self.headers["Host"].partition(":")[0], self.path))
            if self.path.startswith("/away"):
                self.send_response(302)
                self.send_header("Location", f"http://localhost:{port}/floor.xml")
                self.send_header("Content-Length", "0")
                self.end_headers()
                return
            if self.path.startswith("/moved"):
                self.send_response(302)
                self.send_header("Location", "/floor.xml")
                self.send_header("Content-Length", "0")
                self.end_headers()
                return
            content = pages[self.path].encode()
            self.send_response(200)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            if self.command == "GET":
                self.wfile.write(content)

        do_HEAD = do_GET

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    port = server.server_address[1]
    rows = [
        {"id": "own", "scene": "floor.xml"},
        {"id": "moved", "scene": "moved.xml"},
        {"id": "other", "scene": f"http://localhost:{port}/floor.xml"},
        {"id": "away", "scene": "away.xml"},
        {"id": "yaml", "config": "far.yaml"},
    ]
    pages = {
        "/floor.xml": FLOOR,
        "/list.jsonl": "\n".join(map(json.dumps, rows)),
        "/far.yaml": f"scene: {{path: 'http://localhost:{port}/floor.xml'}}",
    }
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    monkeypatch.chdir(tmp_path)
    stay_in_process(monkeypatch)
    yield f"http://127.0.0.1:{port}/list.jsonl", asked
    server.shutdown()
    thread.join()
    server.server_close()


def test_a_list_leads_to_its_own_host_alone(web):
    url, asked = web
    _, result = run(url)
    rows = {row["id"]: row for row in result.rows}
    status = {name: row["status"] for name, row in rows.items()}
    assert status == dict.fromkeys(("own", "moved"), "ok") | dict.fromkeys(FAR, "failed")
    assert {host for host, _ in asked} == {"127.0.0.1"}
    for name in FAR:
        assert "expected a file of 127.0.0.1, got http://localhost" in rows[name]["error"]
        assert "--allow-hosts localhost" in rows[name]["error"]


def test_other_hosts_may_be_allowed(web):
    url, asked = web
    _, result = run(url, hosts=("localhost",))
    assert [row["status"] for row in result.rows] == ["ok"] * 5
    assert {host for host, _ in asked} == {"127.0.0.1", "localhost"}


def test_what_users_name_is_theirs(web, tmp_path):
    url, _ = web
    other = url.replace("127.0.0.1", "localhost").replace("list.jsonl", "floor.xml")
    (tmp_path / "mine.txt").write_text(f"{other}\n")
    assert [row["status"] for row in run("mine.txt")[1].rows] == ["ok"]


def test_hosts_are_told_apart():
    check_host("http://a.org/x", ["https://A.org:8080/y"])
    check_host("s3://bucket/x", ["https://a.org/y"])
    check_host("https.xml", [])
    for url in ("http://b.org/x", "https://a.org@b.org/x", "HTTP://a.org.b.org/x"):
        with pytest.raises(NavbakeError, match=r"expected a file of a\.org, got .*b\.org/x"):
            check_host(url, ["https://a.org/y"])
