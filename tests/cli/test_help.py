"""`--help` of each command ends its words with an example that parses."""

from __future__ import annotations

import re
import shlex
from typing import Any

import pytest
import typer

from navbake.cli.main import app

COMMANDS: Any = typer.main.get_command(app)
EXAMPLE = re.compile(r"^Example: navbake (.+)$", re.MULTILINE)


@pytest.mark.parametrize("name", sorted(COMMANDS.commands))
def test_help_has_an_example_that_parses(name):
    command = COMMANDS.commands[name]
    [example] = EXAMPLE.findall(command.help)
    words = shlex.split(example)
    assert words[0] == name
    command.make_context(name, words[1:])


@pytest.mark.parametrize("name", sorted(COMMANDS.commands))
def test_help_is_printed_with_the_example_on_a_line_of_its_own(name, run):
    status, out, _ = run(name, "--help")
    assert status == 0
    assert re.search(rf"\n\n  Example: navbake {re.escape(name)}\b", out)


@pytest.mark.parametrize("name", sorted(COMMANDS.commands))
def test_help_says_what_values_are_and_no_types_of_python(name, run):
    _, out, _ = run(name, "--help")
    assert {*re.findall(r"<[^<>]*>", out)} <= {"<id>"}
    unnamed = [p.name for p in COMMANDS.commands[name].params if not (p.metavar or is_flag(p))]
    assert not unnamed


def is_flag(parameter):
    return getattr(parameter, "is_flag", False)


@pytest.mark.parametrize("name", sorted(COMMANDS.commands))
def test_help_lists_the_output_first(name, run):
    _, out, _ = run(name, "--help")
    if "--output" in out:
        assert re.search(r"\nOptions:\n +-o, --output ", out)
