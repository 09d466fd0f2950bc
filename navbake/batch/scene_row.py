"""The types of a scene's row in a batch's index, and of the record in the scene's folder."""

from typing import TypedDict


class FileState(TypedDict, total=False):
    """The state of a file, by which a change of its content is noticed."""

    size: int  # [bytes]
    sha256: str  # digest of the content; of files on this machine
    tag: str  # the store's digest, version or time of change; of files on a store


class SceneRow(TypedDict, total=False):
    """A scene's row in the index of a batch, a line of JSON; see docs/batch.md.

    The row of a scene that failed, or that the batch didn't reach (``left``), lacks some keys.
    """

    # set by `job.begin_row`, for every scene
    id: str  # unique in the batch; the scene's folder in the output folder
    status: str  # ``ok``, ``failed``, or ``left``: the batch ended before it baked the scene
    source: str  # the scene or its settings: a URL, or a path from the output folder

    # set by `job.record_failure`, for a scene that failed; `error` also by `job.bake_scene` if the
    # output has no room
    how: str  # ``error``, ``crashed``, ``too long`` or ``too large``
    error: str  # the reason, as text

    # set by `job._bake_and_write`, for a scene that is ``ok``
    version: str  # navbake's
    key: str  # digest; changes when the grid or a product may change, see `job.open_scene`
    scene_digest: str | None  # digest of the geometry, from the grid
    settings_digest: str | None  # digest of the settings, from the grid
    levels: int  # number of levels
    cells: int  # number of cells of all levels, also of cells without a floor
    free_area: float  # area of all free cells [m²]
    rooms: int  # number of rooms
    doors: int  # number of doors
    warnings: list[str]  # of the grid, and of the products that couldn't be made
    audit: list[str]  # what an audit of the grid remarks
    inputs: dict[str, FileState]  # URL, or path from the output folder -> state of an input file
    stages: dict[str, float]  # name of a stage of the bake -> duration [s]; {} for a copy

    # set by `job._write_products`
    files: dict[str, FileState]  # name of a file in the scene's folder -> its state
    removed: list[str]  # products of an earlier run that this one removed; only if there are any
    # measure (``distance``, ``ratio``, ``levels``) -> how many episodes are in each of its classes,
    # whose lower edges are `products.MEASURE_CLASSES`; only with episodes
    episodes: dict[str, list[int]]

    # set by `job._end_times`, for a scene that is ``ok`` or ``failed``
    seconds: float  # duration of the scene's last attempt [s]
    ended: str  # when it ended, ISO 8601 in UTC


class SceneRecord(SceneRow, total=False):
    """The record of a finished scene, in its folder: its row, and keys that the index lacks."""

    more: list[str]  # names of files in the folder that aren't in `files`, such as the thumbnail
    content: str  # digest that scenes with the same cells have in common
    settings: str  # digest of the scene's settings
    products: list[str]  # what the batch made besides the grid, such as ``report``
