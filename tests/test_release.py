"""What a release needs says the same everywhere."""

from __future__ import annotations

import json
import re

import pytest
import yaml

from navbake._version import __version__
from project_paths import ROOT

tomllib = pytest.importorskip("tomllib", reason="Python 3.10 has no tomllib")
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


def read(name):
    return (ROOT / name).read_text(encoding="utf-8")


def test_the_version_stands_in_each_place():
    assert yaml.safe_load(read("CITATION.cff"))["version"] == __version__
    assert yaml.safe_load(read("recipe/recipe.yaml"))["context"]["version"] == __version__
    assert f"## [{__version__}]" in read("CHANGELOG.md")


def test_the_recipe_requires_what_the_package_requires():
    project = tomllib.loads(read("pyproject.toml"))["project"]
    run = yaml.safe_load(read("recipe/recipe.yaml"))["requirements"]["run"]
    named = {"mujoco": "mujoco-python"}  # on conda-forge
    wanted = [re.match(r"([\w.-]+)(.*)", line) for line in project["dependencies"]]
    assert run == [
        f"python {project['requires-python']}",
        *(f"{named.get(m[1], m[1].lower())} {m[2]}" for m in wanted),
    ]


def test_actions_are_pinned_and_workflows_call_scripts():
    assert {path.stem for path in WORKFLOWS} == {"docs", "nightly", "publish", "test"}
    for path in WORKFLOWS:
        text = path.read_text(encoding="utf-8")
        assert yaml.safe_load(text)["permissions"] == {"contents": "read"}
        for action in re.findall(r"uses: (.*)", text):
            assert re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+", action), action
        for script in re.findall(r"run: bash (\S+)", text):
            assert (ROOT / script).is_file(), script


def test_only_pushes_may_write_the_site():
    for path in WORKFLOWS:
        for name, job in yaml.safe_load(path.read_text(encoding="utf-8"))["jobs"].items():
            if job.get("permissions", {}).get("contents") == "write":
                assert (path.stem, name, job["if"]) == (
                    *("docs", "publish"),
                    "github.event_name == 'push'",
                )


def test_only_publishing_may_sign():
    for path in WORKFLOWS:
        assert ("id-token: write" in path.read_text(encoding="utf-8")) == (path.stem == "publish")


def test_files_of_other_sites_are_readable():
    assert json.loads(read(".zenodo.json"))["license"] == "MIT"
    json.loads(read(".devcontainer/devcontainer.json"))
    for path in (ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"):
        yaml.safe_load(path.read_text(encoding="utf-8"))
    assert "navbake doctor" in read(".github/ISSUE_TEMPLATE/bug.yml")
