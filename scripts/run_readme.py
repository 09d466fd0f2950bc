"""Runs the README's commands and its Python, with the programs of an environment, in a folder.

    python scripts/run_readme.py ENVIRONMENT/bin FOLDER

It stops at the first one that fails, with what that printed.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from pathlib import Path

README = Path(__file__).resolve().parents[1] / "README.md"
SKIPPED = ("bash scripts/", "pip install")


def read_blocks(language: str) -> list[str]:
    """The code of README.md in a language."""
    return re.findall(
        rf"^```{language}\n(.*?)^```", README.read_text(encoding="utf-8"), re.S | re.M
    )


def main() -> None:
    """Run all; the environment's programs come first in PATH."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("programs", help="the environment's bin")
    parser.add_argument("folder", help="where to run them, an empty folder")
    arguments = parser.parse_args()
    programs, folder = arguments.programs, arguments.folder
    env = {**os.environ, "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"}
    env.pop("PYTHONPATH", None)
    lines = [
        line.partition("  #")[0].strip()
        for block in read_blocks("sh")
        for line in block.splitlines()
    ]
    commands = [["bash", "-c", line] for line in lines if line and not line.startswith(SKIPPED)]
    commands += [["python", "-c", code] for code in read_blocks("python")]
    for command in commands:
        done = subprocess.run(
            command, cwd=folder, env=env, capture_output=True, text=True, check=False
        )
        if done.returncode:
            sys.exit(f"status {done.returncode} of {command[-1]}\n{done.stdout}{done.stderr}")
    print(f"{len(commands)} commands and scripts of README.md run")


if __name__ == "__main__":
    main()
