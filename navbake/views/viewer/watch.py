"""Files that a bake reads, and whether they have changed on disk since."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path

from navbake.formats.scene_files import find_inputs

PERIOD = 0.5  # between two looks [s]
State = dict[Path, tuple[int, int] | None]


def find_files(paths: Iterable[Path]) -> list[Path]:
    """Files and, of scenes among them, all that these name: includes, meshes, textures, ….

    Of a file that isn't there, all places where it is looked for: somebody may put it there.
    """
    found = (find_inputs(path, looks=True, missing=True) for path in paths)
    return [*dict.fromkeys(path for of_one in found for path in of_one)]


def read_state(paths: Iterable[Path]) -> State:
    """When each file was written, and its size; None for one that isn't there."""
    state: State = {}
    for path in paths:
        try:
            status = os.stat(path)
        except (OSError, ValueError):  # ValueError: a name with a NUL
            state[path] = None
        else:
            state[path] = status.st_mtime_ns, status.st_size
    return state


class Watch:
    """Tells when files have changed and rest again: whoever writes them may take some time.

    Args:
        list_files: the files; asked again after each change, for a scene may name others then.
    """

    def __init__(self, list_files: Callable[[], Iterable[Path]]) -> None:
        self._list_files = list_files
        self._files = list(list_files())
        self._known = self._last = read_state(self._files)

    def look(self) -> bool:
        """Whether the files are others than when this was last true, and as at the last look."""
        now = read_state(self._files)
        rests, self._last = now == self._last, now
        if not rests or now == self._known:
            return False
        self._files = list(self._list_files())
        self._known = self._last = read_state(self._files)
        return True
