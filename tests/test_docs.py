"""What the README and docs/ say is so: code runs, commands parse, links lead somewhere.

The README's commands run in `test_starts.py`.
"""

from __future__ import annotations

import ast
import gzip
import importlib
import json
import re
import shlex
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pytest
import typer
import yaml

import navbake
from batch_in_process import stay_in_process
from batch_scenes import draw_room
from command_line import run_command
from navbake.cli.main import COMMANDS as GROUPS
from navbake.cli.main import app
from navbake.config.settings import SECTIONS, parse_config
from navbake.episodes.sampler import PRESETS
from navbake.scores import read_trajectories
from navbake.views.tables import LEVEL_COLUMNS
from project_paths import ROOT

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
PICTURES = sorted((ROOT / "docs" / "pictures").glob("*.png"))
MAX_README_WORDS = 700
MAX_PICTURE_BYTES = 150_000
FRAMEWORKS = ("gymnasium", "ifcopenshell", "jax", "mujoco.mjx", "torch")
COMMANDS: Any = typer.main.get_command(app)
UsageError = typer.BadParameter.__base__  # click may be a part of typer, or not

BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")
SPAN = re.compile(r"`([^`\n]+)`")
NAME = re.compile(r"(?<![\w./])navbake(?:\.\w+)+(?!\.json)(?<!\.json)\b")
PROJECT_PATH = re.compile(r"(?:navbake|configs|docs|examples|scripts|tests)/[\w./-]*")
each_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))


def blocks_of(page: Path, *languages: str) -> list[str]:
    return [text for language, text in BLOCK.findall(page.read_text()) if language in languages]


def frameworks_of(text: str) -> list[str]:
    """Which of the packages that not every machine has a block imports."""
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
    return [name for name in FRAMEWORKS if name in found]


def run_block(page: Path, number: int, text: str, names: dict[str, Any]) -> None:
    exec(compile(text, f"{page.name}, block {number}", "exec"), names)


def anchors_of(page: Path) -> set[str]:
    """The anchors that GitHub gives the headings of a page."""
    headings = re.findall(r"^#+ (.+)$", BLOCK.sub("", page.read_text()), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", text.lower()).replace(" ", "-") for text in headings}


def shell_lines(page: Path) -> list[list[str]]:
    lines = "".join(blocks_of(page, "sh")).splitlines()
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def commands_of(page: Path) -> list[list[str]]:
    """The words that follow `navbake` in each command line of a page."""
    lines = shell_lines(page)
    return [words[1:] for words in lines if words[0] == "navbake" and words[1][0] != "-"]


@each_page
def test_python_runs(page, tmp_path, monkeypatch, capsys):
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "docs"}
    for number, text in enumerate(blocks_of(page, "python")):
        if not frameworks_of(text):
            run_block(page, number, text, names)


@pytest.mark.parametrize(
    ("page", "number"),
    [
        pytest.param(page, number, id=f"{page.name}-{'-'.join(frameworks_of(text))}-{number}")
        for page in PAGES
        for number, text in enumerate(blocks_of(page, "python"))
        if frameworks_of(text)
    ],
)
def test_python_with_a_framework_runs_by_itself(page, number, tmp_path, monkeypatch):
    text = blocks_of(page, "python")[number]
    for name in (*frameworks_of(text), "array_api_compat"):
        if find_spec(name) is None:
            pytest.skip(f"{name} is not installed")
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    monkeypatch.chdir(tmp_path)
    run_block(page, number, text, {"__name__": "docs"})


@each_page
def test_commands_parse(page):
    for words in commands_of(page):
        command = COMMANDS.commands.get(words[0])
        assert command is not None, f"{page.name}: no command {words[0]}"
        try:
            command.make_context(words[0], words[1:])
        except UsageError as error:
            pytest.fail(f"{page.name}: navbake {shlex.join(words)}: {error.format_message()}")


def test_the_commands_of_the_page_of_formats_run_in_an_empty_folder(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    page = ROOT / "docs" / "convert.md"
    (zones,) = blocks_of(page, "json")
    (tmp_path / "zones.geojson").write_text(zones)
    for words in commands_of(page):
        assert run_command(capsys, *words)[0] == 0, words
    assert {file.suffix for file in tmp_path.iterdir()} >= {".pgm", ".npz", ".xml", ".yaml"}


def test_the_commands_of_the_page_of_routes_run_in_an_empty_folder(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for words in commands_of(ROOT / "docs" / "routes.md"):
        assert run_command(capsys, *words)[0] == 0, words


def test_the_commands_of_the_page_of_batches_run_on_this_machine(tmp_path, monkeypatch, capsys):
    """All but those on stores and on a cluster, on two scenes; patterns and lists name them."""
    stay_in_process(monkeypatch)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scenes").mkdir()
    for number in (1, 2):
        (tmp_path / "scenes" / f"{number}.xml").write_text(draw_room(number))
    (tmp_path / "all.yaml").write_text("grid: {cell_size: 0.2}\n")
    (tmp_path / "houses.csv").write_text("scene,id\nscenes/1.xml,0001\nscenes/2.xml,0002\n")
    row = {"files": {"mjcf": "scenes/1.xml"}, "house": "h", "robot": 0.2, "split": "train"}
    (tmp_path / "dataset.jsonl.gz").write_bytes(gzip.compress(json.dumps(row).encode()))
    ran = []
    for words in commands_of(ROOT / "docs" / "batch.md"):
        if words[0] == "batch" and "ray" not in words and "s3://" not in " ".join(words):
            ran.append([word.replace("$SLURM_ARRAY_TASK_ID", "1") for word in words])
            assert run_command(capsys, *ran[-1])[0] == 0, words
    flags = {word for words in ran for word in words if word.startswith("--")}
    assert flags >= {"--plan", "--slice", "--merge", "--shards", "--column", "--page", "--make"}


def test_the_page_of_episodes_scores_what_its_lines_make(tmp_path, monkeypatch, capsys):
    (tmp_path / "configs").symlink_to(ROOT / "configs")
    monkeypatch.chdir(tmp_path)
    page = ROOT / "docs" / "episodes.md"
    bake, episodes, score = commands_of(page)[:3]
    for words in (bake, episodes):
        assert run_command(capsys, *words)[0] == 0, words
    run_block(page, 0, blocks_of(page, "py")[0], {})
    status, out, err = run_command(capsys, *score)
    assert (status, err) == (0, "") and "success  1.000" in out
    (line,) = blocks_of(page, "json")
    (tmp_path / "runs.jsonl").write_text(line)
    assert read_trajectories("runs.jsonl")[0].stop is False


def test_the_tutorial_leads_from_its_scene_to_a_path(tmp_path, monkeypatch, capsys):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    page = ROOT / "docs" / "tutorial.md"
    (scene,) = blocks_of(page, "xml")
    (tmp_path / "office.xml").write_text(scene)
    statuses = {shlex.join(words): run_command(capsys, *words) for words in commands_of(page)}
    failed = {words: out for words, (status, out, _) in statuses.items() if status}
    ((words, out),) = failed.items()
    assert words.startswith("path ") and "--doors open" not in words
    assert "door 'door' (as modelled) is in the way; `--doors open` opens all doors" in out
    (code,) = blocks_of(page, "py")
    run_block(page, 0, code, {"__name__": "docs"})
    assert "through ['door']" in capsys.readouterr().out


def test_the_install_line_of_the_readme_works_in_a_checkout():
    """Before the release there is no package of that name to be installed."""
    (line, *_) = [words for words in shell_lines(ROOT / "README.md") if words[0] == "pip"]
    assert line == ["pip", "install", ".[plot]"]


def test_commands_that_are_wrong_do_not_parse():
    for words in (["bake", "a.yaml", "--colour"], ["plot"], ["path", "a.json", "--from", "0,0"]):
        with pytest.raises(UsageError):
            COMMANDS.commands[words[0]].make_context(words[0], words[1:])


def test_the_page_of_the_command_line_groups_the_commands_as_the_help_does():
    text = (ROOT / "docs" / "command_line.md").read_text()
    table = text.partition("| group | commands |\n|---|---|\n")[2].partition("\n\n")[0]
    listed = {
        title.strip(): [name for name in SPAN.findall(names) if name != "mdf"]
        for title, names in (row.strip("|").split("|") for row in table.splitlines())
    }
    assert listed == {
        title: [command.__name__.replace("_", "-") for command in commands]
        for title, commands in GROUPS.items()
    }


def first_cells_of(text: str, heading: str) -> list[list[str]]:
    """The first two cells of each row of the table with this heading, without backticks."""
    table = text.partition(f"{heading}\n")[2].partition("\n\n")[0]
    rows = [line.strip("|").split("|") for line in table.splitlines()[1:]]
    return [[cell.strip().strip("`") for cell in row[:2]] for row in rows]


def test_the_page_of_the_command_line_lists_the_columns_of_levels():
    text = (ROOT / "docs" / "command_line.md").read_text()
    section = text.partition("## What bake and info print\n")[2]
    listed = [column for column, _ in first_cells_of(section, "| column | meaning |")]
    assert listed == [*LEVEL_COLUMNS, "rooms"]


def test_the_page_of_episodes_lists_all_rules_with_their_defaults():
    text = (ROOT / "docs" / "episodes.md").read_text()
    listed = dict(first_cells_of(text, "| rule | default | range, unit | meaning |"))
    defaults = msgspec.to_builtins(PRESETS["uniform"])
    del defaults["name"]
    assert listed.keys() == defaults.keys()
    for rule, default in listed.items():
        if default not in ("none", "by the measure"):
            assert yaml.safe_load(default) == defaults[rule]
        else:
            assert not defaults[rule]


def test_every_command_is_shown():
    shown = {words[0] for page in PAGES for words in commands_of(page)}
    assert shown == set(COMMANDS.commands)


@each_page
def test_options_in_the_text_are_there(page):
    known = {
        option
        for command in COMMANDS.commands.values()
        for parameter in (*command.params, *COMMANDS.params)
        for option in (*parameter.opts, *parameter.secondary_opts)
    }
    known.add("--help")  # of all
    spans = SPAN.findall(BLOCK.sub("", page.read_text()))
    options = {
        word.split("=")[0]
        for span in spans
        if span.startswith(("-", "navbake "))
        for word in span.split()
        if re.match(r"--?[a-zA-Z]", word)  # "-" is stdout, and places may begin with a minus
    }
    assert options <= known
    for span in spans:
        words = span.split()
        if words[0] == "navbake" and len(words) > 1 and not words[1].startswith("-"):
            assert words[1] in COMMANDS.commands, f"{page.name}: {span}"


@each_page
def test_names_are_there(page):
    for name in NAME.findall(page.read_text()):
        assert resolves(name), f"{page.name}: no {name}"


def test_names_that_are_not_there_are_found():
    assert resolves("navbake.PathFinder.find_path")
    assert not resolves("navbake.PathFinder.find_way")
    assert not resolves("navbake.no_module")


def resolves(name: str) -> bool:
    """Whether a dotted name is a module, or what one holds."""
    found: Any = navbake
    path = "navbake"
    for part in name.split(".")[1:]:
        path = f"{path}.{part}"
        if not hasattr(found, part):
            try:
                importlib.import_module(path)
            except ImportError:
                return False
        found = getattr(found, part)
    return True


@each_page
def test_links_lead_somewhere(page):
    for target in LINK.findall(BLOCK.sub("", page.read_text())):
        if target.startswith("https://"):
            continue
        path, _, anchor = target.partition("#")
        found = (page.parent / path).resolve() if path else page
        assert found.exists(), f"{page.name}: {target}"
        assert not anchor or anchor in anchors_of(found), f"{page.name}: {target}"


@each_page
def test_paths_are_there(page):
    text = page.read_text()
    spans = [span for span in SPAN.findall(BLOCK.sub("", text)) if PROJECT_PATH.fullmatch(span)]
    words = [word for line in shell_lines(page) for word in line if PROJECT_PATH.fullmatch(word)]
    for path in (*spans, *words):
        assert (ROOT / path).exists(), f"{page.name}: {path}"


@each_page
def test_settings_in_yaml_are_valid(page):
    for text in blocks_of(page, "yaml"):
        parse_config({"scene": {"path": "scene.xml"}, **yaml.safe_load(text)}, page.name)


# ---------------------------------------------------------------- single pages


def test_readme_is_short():
    assert len((ROOT / "README.md").read_text().split()) <= MAX_README_WORDS


def test_all_pages_are_listed():
    linked = set(LINK.findall((ROOT / "docs" / "README.md").read_text()))
    assert {page.name for page in PAGES[2:]} - {"README.md"} <= linked


@pytest.mark.parametrize("picture", PICTURES, ids=lambda picture: picture.stem)
def test_pictures_are_small_and_shown(picture):
    assert picture.stat().st_size < MAX_PICTURE_BYTES
    assert any(f"pictures/{picture.name})" in page.read_text() for page in PAGES)


def test_citation_is_of_this_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == navbake.__version__
    assert citation["cff-version"] == "1.2.0"
    assert citation["license"] == "MIT"


class Row(NamedTuple):
    """A key in a table of docs/settings.md."""

    default: str
    limits: str


def setting_rows() -> dict[str, Row]:
    rows = {}
    for line in (ROOT / "docs" / "settings.md").read_text().splitlines():
        if line.startswith("| `"):
            key, default, limits, _ = (
                cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip("|"))
            )
            rows[key.strip("`")] = Row(default.strip("`").replace("\\|", "|"), limits)
    return rows


def setting_fields() -> dict[str, Any]:
    """Each setting by its dotted key, sections left out."""
    fields = {}
    for section, model in SECTIONS.items():
        for name, field in model.model_fields.items():
            is_section = field.default_factory is not None or name == "scene"
            if not is_section:
                key = ".".join(part for part in (section, field.alias or name) if part)
                fields[key] = field
    return fields


def test_settings_are_all_described():
    assert set(setting_rows()) == set(setting_fields())


@pytest.mark.parametrize("key", sorted(setting_fields()))
def test_setting_has_the_default_and_the_limits_of_the_table(key):
    row, field = setting_rows()[key], setting_fields()[key]
    if field.is_required():
        assert row.default == "required"
    elif key in ("scene.id", "output", "levels.top"):
        assert row.default in ("the file's stem", "<id>.grid.json", "the next level's ground")
    else:
        assert yaml.safe_load(row.default) == field.default
    description = re.sub(r"; default .*", "", field.description)
    for fact in re.findall(r"\[(?:m|m2|degrees)\]|[<>]=? [\d.]+|\d+ to [\d.]+", description):
        assert fact in row.limits
