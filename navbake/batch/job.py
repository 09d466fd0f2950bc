"""One scene of a batch: what it is called, where it is, and its settings."""

from __future__ import annotations

import re
from typing import NamedTuple

from navbake.errors import ConfigError
from navbake.types import Json

# what every file system takes as part of a name, without what leads elsewhere
PART = re.compile(r"[A-Za-z0-9_\-+=@()][A-Za-z0-9_.\-+=@(), ]{0,199}")
RESERVED = re.compile(r"(?i)(con|prn|aux|nul|com\d|lpt\d)(\..*)?")


class Job(NamedTuple):
    """One scene of a batch.

    Attributes:
        id: unique in the batch; the folder of what is made of it, parts between slashes.
        source: the scene or the settings (YAML), a path or a URL.
        settings: what replaces the batch's settings for it, by key: ``{"agent.radius": 0.3}``.
        place: where it stands in the manifest, for messages.
    """

    id: str
    source: str
    settings: Json
    place: str


def check_id(name: str, place: str) -> None:
    """Refuse an id that could lead out of the output folder, or that some file system refuses.

    Raises:
        ConfigError: it is empty, absolute, has a part such as ``..``, or a letter outside of
            ASCII letters, digits and ``_ . - + = @ ( ) ,`` and spaces within.
    """
    parts = name.split("/")
    for part in parts:
        if not PART.fullmatch(part) or RESERVED.fullmatch(part) or part.endswith((".", " ")):
            raise ConfigError(
                f"expected an id of letters, digits and _.-+=@() between slashes, not longer than "
                f"200, got {name!r} at {place}"
            )


def check_unique(jobs: list[Job]) -> None:
    """Refuse two jobs whose outputs would be one folder, also where case doesn't count.

    Raises:
        ConfigError: two have the same id, or one's id is a folder of the other's.
    """
    seen: dict[str, Job] = {}
    for job in jobs:
        other = seen.setdefault(job.id.casefold(), job)
        if other is not job:
            raise ConfigError(
                f"expected unique ids, got {job.id!r} at {other.place} and at {job.place}: "
                "give each an id of its own"
            )
    for job in jobs:
        parts = job.id.casefold().split("/")
        for count in range(1, len(parts)):
            above = seen.get("/".join(parts[:count]))
            if above is not None:
                raise ConfigError(
                    f"expected ids that are not within each other, got {above.id!r} at "
                    f"{above.place} and {job.id!r} at {job.place}"
                )
