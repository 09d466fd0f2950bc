"""Runs the command line in the tests' own process."""

from __future__ import annotations

import pytest

from navbake.cli.main import main


def run_command(capture, *arguments):
    """Run `navbake` with arguments; its exit status, stdout and stderr.

    Args:
        capture: pytest's fixture that has what is printed.
    """
    with pytest.raises(SystemExit) as caught:
        main([str(argument) for argument in arguments])
    out, err = capture.readouterr()
    return caught.value.code or 0, out, err
