"""The samples: where they are, and copies of them."""

from __future__ import annotations

from pathlib import Path

import pytest

import navbake
from command_line import run_command
from navbake.cli.main import main
from navbake.config.settings import load_config
from navbake.errors import ConfigError


def test_all_are_listed(capsys):
    assert navbake.samples.names() == [
        "apartment",
        "clutter",
        "house",
        "terrain",
        "tower",
        "warehouse",
    ]
    with pytest.raises(SystemExit):
        main(["samples"])
    out = capsys.readouterr().out
    assert [line.split()[0] for line in out.splitlines()] == navbake.samples.names()


@pytest.mark.parametrize("name", navbake.samples.names())
def test_a_copy_loads_by_itself(name, tmp_path):
    settings, *files = navbake.samples.copy(name, tmp_path)
    assert settings == tmp_path / f"{name}.yaml"
    config = load_config(settings)
    assert config.scene.path in files
    assert all(file.is_file() for file in files)


def test_a_copy_overwrites_nothing_else(tmp_path):
    navbake.samples.copy("house", tmp_path)
    navbake.samples.copy("house", tmp_path)  # the same files may be there
    (tmp_path / "house.yaml").write_text("scene: {path: mine.xml}")
    with pytest.raises(ConfigError, match=r"another .*house\.yaml is there"):
        navbake.samples.copy("house", tmp_path)
    assert (tmp_path / "house.yaml").read_text() == "scene: {path: mine.xml}"


def test_an_unknown_one_is_named_with_the_nearest():
    with pytest.raises(ConfigError, match="no sample 'hous': did you mean 'house'"):
        navbake.samples.path("hous")


def test_assets_come_along(tmp_path):
    files = navbake.samples.copy("apartment", tmp_path)
    assert tmp_path / "scenes" / "assets" / "vase.obj" in files
    assert len(navbake.samples.copy("terrain", tmp_path)) == 2


def test_a_bare_name_means_the_copy_in_the_current_folder(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    sample = str(navbake.samples.path("house"))
    status, out, err = run_command(capsys, "geoms", "house", "--json")
    assert status == 0 and err == (
        f"navbake: house is the installed sample {sample}: `navbake samples house` copies it\n"
    )
    assert run_command(capsys, "geoms", "house", "--json", "-q") == (0, out, "")
    navbake.samples.copy("house")
    text = Path("house.yaml").read_text()
    Path("house.yaml").write_text(text.replace("output:", "output: mine.grid.json  #"))
    assert load_config("house").output == Path("mine.grid.json")
    assert run_command(capsys, "geoms", "house", "--json") == (0, out, "")


def test_where_a_bare_name_is_refused_its_settings_are_named(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    status, _, err = run_command(capsys, "init", "house")
    assert status == 1 and "`navbake samples house` copies the sample" in err
    status, _, err = run_command(capsys, "batch", "house", "-o", "out")
    assert status == 1 and f"the settings of the sample are {navbake.samples.path('house')}" in err
    Path("house.yaml").write_text("scene: {path: mine.xml}")
    assert "did you mean house.yaml?" in run_command(capsys, "batch", "house", "-o", "out")[2]
