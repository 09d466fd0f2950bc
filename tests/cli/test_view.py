"""`navbake view` without a browser: what it refuses, and how it ends."""

import signal
import socket
import sys
import urllib.request

import mujoco
import pytest

import navbake
from viewer_page import run_view
from viewer_scenes import ROOM, write_room

pytest.importorskip("viser")


def test_ctrl_c_ends_it_and_frees_the_port(tmp_path):
    path = write_room(tmp_path)
    with run_view(str(path)) as (process, url):
        assert url.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(url) as page:
            assert b"<html" in page.read(1000)
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 130
        out, error = process.communicate()
        assert out == "" and "Traceback" not in error
    with socket.socket() as again:
        again.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        again.bind(("127.0.0.1", int(url.rpartition(":")[2])))


def fails(run, *arguments):
    """Run the command, and return its one line on stderr."""
    return run("view", *arguments, "--no-open")


@pytest.fixture
def run(capsys):
    from navbake.cli.main import main

    def call(*arguments):
        with pytest.raises(SystemExit) as end:
            main([str(one) for one in arguments])
        return end.value.code, capsys.readouterr().err

    return call


def test_a_port_in_use_is_one_line(run, tmp_path):
    path = write_room(tmp_path)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        code, error = fails(run, path, "--port", port)
    assert code == 1
    assert error == (
        f"navbake: port {port} of 127.0.0.1 is in use: choose another one by --port, "
        "or 0 for any free one\n"
    )


def test_a_grid_of_another_scene_is_one_line(run, tmp_path):
    model = mujoco.MjModel.from_xml_string(ROOM)
    navbake.bake(model, grid={"cell_size": 0.2}).save(tmp_path / "room.grid.json")
    (tmp_path / "other.xml").write_text(ROOM.replace(".05 1.1 1", ".05 1 1"))
    grid, other = tmp_path / "room.grid.json", tmp_path / "other.xml"
    code, error = fails(run, grid, "--scene", other, "--port", 0)
    assert code == 1 and "digests differ" in error and error.count("\n") == 1


def test_without_the_extra_it_says_what_to_install(run, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    code, error = fails(run, write_room(tmp_path))
    assert code == 1
    assert error == 'navbake: the viewer needs viser: pip install "navbake[view]"\n'
