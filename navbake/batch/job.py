"""One scene of a batch: what it is called, where it is, and its settings."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

from navbake.batch.products import OWN
from navbake.errors import ConfigError, shorten
from navbake.formats.scene_files import fold_name
from navbake.types import Json

# what some file system takes for something else than a letter of a name
SPECIAL = re.compile(r'[\\:*?"<>|]')
RESERVED = re.compile(r"(?i)(con|prn|aux|nul|com\d|lpt\d|index\.(jsonl|parquet|html))(\..*)?")
MAX_BYTES = 200  # of a part of an id; file systems take 255


class Job(NamedTuple):
    """One scene of a batch.

    Attributes:
        id: unique in the batch; the folder of what is made of it, parts between slashes.
        source: the path of the scene or of its settings (YAML).
        settings: what replaces the batch's settings for it, by key: ``{"agent.radius": 0.3}``.
        place: where it stands in a list, for messages.
    """

    id: str
    source: str
    settings: Json
    place: str


def check_id(name: str, place: str) -> None:
    r"""Refuse an id that could lead out of the output folder, or that some file system refuses.

    Raises:
        ConfigError: it is empty or absolute; a part of it begins with a dot, ends with a dot or a
            space, is too long, is a name that Windows reserves, or has one of ``\:*?"<>|`` or what
            can't be printed; or it is the name of a file that navbake writes of another scene.
    """
    for part in name.split("/"):
        is_fine = (
            part.isprintable()
            and part == part.strip()
            and not SPECIAL.search(part)
            and not RESERVED.fullmatch(part)
            and not part.startswith(".")
            and not part.endswith(".")
            and 0 < len(part.encode()) <= MAX_BYTES
        )
        if not is_fine:
            raise ConfigError(
                f"expected an id that can be the name of a folder on any system, or several "
                f"between slashes, got {shorten(repr(name))} at {place}: give it another `id`"
            )
        if OWN.fullmatch(part.casefold()):
            raise ConfigError(
                f"expected an id without names of files that navbake writes, got {part} in "
                f"{shorten(repr(name))} at {place}: give it another `id`"
            )


def check_unique(jobs: Sequence[Job]) -> None:
    """Refuse two jobs whose outputs would be one folder on some file system, see `fold_name`.

    Raises:
        ConfigError: two have the same id.
    """
    seen: dict[str, Job] = {}
    for job in jobs:
        other = seen.setdefault(fold_name(job.id), job)
        if other is not job and (other.id, other.source) == (job.id, job.source):
            raise ConfigError(
                f"expected each scene once, got {shorten(job.source)} at {other.place} and at "
                f"{job.place}: name it once, or give each an `id` of its own in a list"
            )
        if other is not job:
            raise ConfigError(
                f"expected unique ids, got {shorten(repr(other.id))} at {other.place} and "
                f"{shorten(repr(job.id))} at {job.place}: give each an `id` of its own"
            )
