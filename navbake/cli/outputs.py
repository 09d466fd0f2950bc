"""Where the grids of several scenes are written: names, and folders where names are the same."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from typer import BadParameter

from navbake.errors import ConfigError

if TYPE_CHECKING:
    from navbake.config.settings import BakeConfig

FIELDS = ("id", "stem", "parent")
FIELD = re.compile(r"\{([^{}]*)\}")


def is_folder(output: str) -> bool:
    """Whether an output is a folder: one that exists, or a new one that ends in a slash."""
    return output.endswith(("/", os.sep)) or os.path.isdir(output)


def check_name(name: str) -> None:
    """Refuse a name with unknown fields, or one that leads out of the folder."""
    unknown = [field for field in FIELD.findall(name) if field not in FIELDS]
    if unknown:
        raise BadParameter(
            f"expected fields out of {', '.join(f'{{{f}}}' for f in FIELDS)}, got {{{unknown[0]}}}",
            param_hint="--name",
        )
    if not name or Path(name).is_absolute() or ".." in Path(name).parts or name.endswith("/"):
        raise BadParameter(
            f"expected the name of a file in the folder, got {name!r}", param_hint="--name"
        )


def lay_out(
    jobs: Sequence[tuple[Path, BakeConfig]], output: str | None, name: str | None
) -> list[Path]:
    """Find the file that each scene's grid is written to.

    That is `output`, or a file in that folder, or what the settings say, or a file in the current
    folder. In a folder, files are called by `name`; without one by the scene's id. Then those of
    one name are laid out in folders, as their CONFIGs are from the folder that all CONFIGs have
    in common.

    Args:
        jobs: each CONFIG, and the settings that it gives.
        output: a file if there is but one job, a folder, or None for what the settings say.
        name: with fields, see `check_name`; or None.
    """
    if output is not None and not is_folder(output):
        return [Path(output) for _ in jobs]
    folder = Path(output or "")
    targets = [
        config.output
        if output is None and name is None and config.output
        else folder / f"{_fill(name or '{id}', path, config)}.grid.json"
        for path, config in jobs
    ]
    if name is not None:
        return targets
    count = Counter(targets)
    homes = [path.resolve().parent for path, _ in jobs]
    return [
        target
        if count[target] == 1 or config.output == target
        else target.parent / _below_common(home, homes) / target.name
        for target, home, (_, config) in zip(targets, homes, jobs, strict=True)
    ]


def _fill(name: str, path: Path, config: BakeConfig) -> str:
    values = {
        "id": str(config.scene.id),
        "stem": path.stem,
        "parent": path.resolve().parent.name,
    }
    filled = FIELD.sub(lambda field: values[field[1]], name)
    if not filled:
        raise ConfigError(f"`--name {name}` gives {path} no name")
    return filled


def _below_common(folder: Path, folders: Sequence[Path]) -> Path:
    """A folder, relative to the one that all of them have in common."""
    try:
        return folder.relative_to(os.path.commonpath(folders))
    except ValueError:  # Windows: they are on several drives
        return Path(folder.name)
