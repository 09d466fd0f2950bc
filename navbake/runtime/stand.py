"""Finds poses from which a robot's base reaches things: in reach, in sight, touching nothing.

`navbake.runtime.stand_cells` has the rules for a cell. Here, targets are looked up by name, and of
the cells where a base can stand, some that are apart from each other are picked.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias, cast

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike

from navbake.errors import QueryError
from navbake.known_names import suggest
from navbake.lengths import format_position
from navbake.navgrid.cells import check_positions
from navbake.navgrid.user_data import find_category
from navbake.runtime.flat_grid import RealNumber, check_distance
from navbake.runtime.search import NO_CELLS, Search
from navbake.runtime.stand_cells import (
    REACH_SLACK,
    StandRules,
    StandSite,
    StandTarget,
    wrap_angle,
)
from navbake.types import Bool, Float, Int, Json

NUM_CIRCLE_CORNERS = 32  # of the outline of a base that is a disc
StandTargets: TypeAlias = str | ArrayLike | Sequence[str | ArrayLike]
"""A position, ``object:NAME``, ``category:NAME``, or a list of these."""


@dataclass(frozen=True, eq=False)
class StandPoses:
    """Poses of a robot's base from which it reaches targets, sorted by target.

    Attributes:
        positions: world x, y and floor z of the base's axis [m], shape (n, 3), float64.
        headings: where the base faces, 0 along x, counted towards y, -pi to pi [rad], shape (n,).
        target_index: the index in `targets` of each pose's target, shape (n,), int64.
        distances: from the base's axis to the target [m], shape (n,). An object counts as the
            squares of its cells: its true surface may be up to a cell's diagonal farther away.
        path_lengths: the lengths of the shortest paths from the start [m], shape (n,); NaN without
            a start.
        targets: the names of the targets: an object's name, or a point's numbers.
        target_boxes: x, y, z of the lower, then of the upper corner of each target's box, world
            [m], shape (m, 6). Of a point both are the point; of an object without a box, it is that
            round its cells, on their floors. NaN for a point in no cell without a height.
        outline: the base from above, x ahead, y to the left of its axis [m], shape (k, 2): the
            footprint, or a circle of the grid's radius.
        why_not: target without a pose -> a sentence that says why it has none.
    """

    positions: Float
    headings: Float
    target_index: Int
    distances: Float
    path_lengths: Float
    targets: tuple[str, ...]
    target_boxes: Float
    outline: Float
    why_not: dict[str, str]

    def __len__(self) -> int:
        return len(self.headings)

    def to_records(self) -> list[Json]:
        """List the poses as dicts, as `navbake stand` writes them to JSON.

        Returns:
            For each pose its ``target`` (a name), ``position`` [m], ``heading`` [rad], ``distance``
            [m] and ``path_length`` [m], None without a start.
        """
        return [
            {
                "target": self.targets[target_index],
                "position": position,
                "heading": heading,
                "distance": distance,
                "path_length": None if math.isnan(path_length) else path_length,
            }
            for target_index, position, heading, distance, path_length in zip(
                self.target_index.tolist(),
                self.positions.tolist(),
                self.headings.tolist(),
                self.distances.tolist(),
                self.path_lengths.tolist(),
                strict=True,
            )
        ]


def stand_poses(
    search: Search,
    target: StandTargets,
    rules: StandRules,
    *,
    count: int | None,
    spread: float,
    seed: int,
) -> StandPoses:
    """Find poses from which a robot's base reaches targets: `PathFinder.stand_poses`.

    Args:
        search: the search on the grid.
        target: the thing to be reached, or several.
        rules: where the base may stand.
        count: most poses for each target, >= 1; None for the poses in all cells, whatever the
            spread.
        spread: least distance between two poses of a target [m].
        seed: seed of the draw of first poses and of headings.

    Returns:
        The poses, sorted by target.

    Raises:
        QueryError: an argument is not valid, or there is no such object or category.
    """
    if count is not None and (not isinstance(count, int | np.integer) or count < 1):
        expected = "a count >= 1, or None for all"
        raise QueryError(
            f"expected {expected}, got {count!r}", key="count", value=count, expected=expected
        )
    check_distance(spread, "spread")
    rng = np.random.default_rng(seed)
    targets = find_stand_targets(search, target, needs_height=rules.height is not None)
    site = StandSite(search, rules, targets)
    stands_by_target = [site.find_stands(stand_target) for stand_target in targets]
    why_not = {
        stand_target.name: site.explain(stand_target, target_stands.tally)
        for stand_target, target_stands in zip(targets, stands_by_target, strict=True)
        if not len(target_stands.cells)
    }
    cells = np.concatenate([target_stands.cells for target_stands in stands_by_target])
    distances = np.concatenate([target_stands.distances for target_stands in stands_by_target])
    headings = np.concatenate([target_stands.headings for target_stands in stands_by_target])
    num_cells = [len(target_stands.cells) for target_stands in stands_by_target]
    target_index = np.repeat(np.arange(len(targets)), num_cells)
    positions = search.flat.positions(cells)
    path_lengths = np.full(len(cells), np.nan)
    if site.path_lengths is not None:
        path_lengths = site.path_lengths[cells]
    picked_indices = np.arange(len(cells))
    if count is not None:
        picked_indices = pick_spread(positions, target_index, path_lengths, count, spread, rng)
    if rules.facing is None:
        headings = site.draw_headings(cells, rng)
    return StandPoses(
        positions=positions[picked_indices],
        headings=headings[picked_indices],
        target_index=target_index[picked_indices],
        distances=distances[picked_indices],
        path_lengths=path_lengths[picked_indices],
        targets=tuple(stand_target.name for stand_target in targets),
        target_boxes=np.stack([find_target_box(search, stand_target) for stand_target in targets]),
        outline=_make_outline(search, rules),
        why_not=why_not,
    )


def stand_region(search: Search, target: StandTargets, rules: StandRules) -> list[Bool]:
    """Mark the cells where a robot's base can stand to reach a target: `PathFinder.stand_region`.

    Args:
        search: the search on the grid.
        target: the thing to be reached, or several, of which any counts.
        rules: where the base may stand.

    Returns:
        For each level, bool, shape (height, width).

    Raises:
        QueryError: a rule is not valid, or there is no such object or category.
    """
    targets = find_stand_targets(search, target, needs_height=rules.height is not None)
    site = StandSite(search, rules, targets)
    is_stand = np.zeros(search.flat.num_cells, dtype=np.bool_)
    for stand_target in targets:
        is_stand[site.find_stands(stand_target).cells] = True
    return [
        is_stand[search.flat.cells_of(level_number)].reshape(level.shape)
        for level_number, level in enumerate(search.grid.levels)
    ]


def _make_outline(search: Search, rules: StandRules) -> Float:
    """Return the outline of the base: its footprint, or a circle; shape (k, 2) [m]."""
    if rules.footprint is not None:
        return np.array(rules.footprint, dtype=np.float64)
    angles = np.linspace(0.0, 2.0 * math.pi, NUM_CIRCLE_CORNERS, endpoint=False)
    return search.grid.radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


class ReachTest:
    """Tests whether a robot's base at poses reaches a target, or any of several.

    Args:
        search: the search on the grid.
        target: the thing to be reached, or several, of which any counts.
        rules: where the base may stand; `tolerance` decides about ``facing``.
        tolerance: largest angle between a pose's heading and that of `stand_poses` in its cell
            [rad]; None for any heading.

    Attributes:
        cells: flat ids of all cells where the base can stand, ascending, each once.

    Raises:
        QueryError: a rule is not valid, or there is no such object or category.
    """

    cells: Int

    def __init__(
        self, search: Search, target: StandTargets, rules: StandRules, tolerance: float | None
    ) -> None:
        if tolerance is not None and not (isinstance(tolerance, RealNumber) and tolerance >= 0.0):
            expected = "a tolerance >= 0 rad, or None for any heading"
            raise QueryError(
                f"expected {expected}, got {tolerance!r}",
                key="tolerance",
                value=tolerance,
                expected=expected,
            )
        targets = find_stand_targets(search, target, needs_height=rules.height is not None)
        self._flat = search.flat
        self._tolerance = tolerance
        self._site = StandSite(
            search, rules._replace(facing=None if tolerance is None else "target"), targets
        )
        self._stands_by_target = [self._site.find_stands(stand_target) for stand_target in targets]
        self.cells = np.unique(np.concatenate([stands.cells for stands in self._stands_by_target]))

    def mark(self, positions: ArrayLike, headings: ArrayLike) -> Bool:
        """Mark the poses that reach a target.

        Args:
            positions: world x, y, z of the base's axis [m], shape (..., 3).
            headings: where the base faces [rad], shape (...).

        Returns:
            Shape (...); False beside the grid.

        Raises:
            QueryError: a position or a heading is not valid.
        """
        cells = self._flat.cells_at(positions)
        pose_headings = np.asarray(headings, dtype=np.float64)
        if pose_headings.shape != cells.shape or not np.isfinite(pose_headings).all():
            expected = f"finite headings of shape {cells.shape}, one for each position [rad]"
            raise QueryError(
                f"expected {expected}, got {headings!r:.60}",
                key="headings",
                value=headings,
                expected=expected,
            )
        is_reaching = np.zeros(cells.shape, dtype=np.bool_)
        for stands in self._stands_by_target:
            if not len(stands.cells):
                continue
            last_index = len(stands.cells) - 1
            stand_index = np.minimum(np.searchsorted(stands.cells, cells), last_index)
            is_stand = stands.cells[stand_index] == cells
            if self._tolerance is not None:
                heading_errors = wrap_angle(pose_headings - stands.headings[stand_index])
                is_stand &= np.abs(heading_errors) <= self._tolerance
            is_reaching |= is_stand
        is_reaching[is_reaching] = self._site.fits(cells[is_reaching], pose_headings[is_reaching])
        return is_reaching


# ---------------------------------------------------------------- targets


def find_stand_targets(
    search: Search, target: StandTargets, *, needs_height: bool
) -> list[StandTarget]:
    """Find the cells of targets.

    Args:
        search: the search on the grid.
        target: a position, ``object:NAME``, ``category:NAME``, or several of them.
        needs_height: whether distances are measured in space, so that heights must be known.

    Returns:
        The targets, in their order; a category is replaced by its objects.

    Raises:
        QueryError: there is no such object or category, or a position is not valid.
    """
    target_items: list[str | ArrayLike]
    if isinstance(target, str):
        target_items = [target]
    elif isinstance(target, list | tuple) and any(
        np.ndim(target_item) or isinstance(target_item, str) for target_item in target
    ):
        target_items = list(target)
    else:
        positions = check_positions(cast("ArrayLike", target), search.flat.num_levels)
        target_items = list(np.atleast_2d(positions))
    if not target_items:
        expected = "a position, object:NAME, category:NAME, or several of them"
        raise QueryError(f"expected {expected}, got none", key="target", expected=expected)
    targets = []
    for target_item in target_items:
        if isinstance(target_item, str):
            targets += _find_named_targets(search, target_item)
        else:
            point, cell = search.flat.locate(target_item, position_name="target")
            cells = NO_CELLS if cell < 0 else np.array([cell])
            z = point[2:] if len(point) == 3 else search.flat.positions(cells)[:1, 2]
            box = np.tile(np.append(point[:2], z), 2) if len(z) else None
            targets.append(StandTarget(format_position(point), cells, box))
    for stand_target in targets:
        if needs_height and stand_target.box is None:
            expected = "a target of known height where the shoulder's is given"
            hint = "bake the scene again, or give a position with x, y, z"
            raise QueryError(
                f"expected {expected}, got {stand_target.name}: {hint}",
                key="target",
                value=stand_target.name,
                expected=expected,
                hint=hint,
            )
    return targets


def find_target_box(search: Search, target: StandTarget) -> Float:
    """Return the box of a target, see `StandPoses.target_boxes`; shape (6,) [m]."""
    if target.box is not None:
        return target.box
    if not len(target.cells):
        return np.full(6, np.nan)
    positions = search.flat.positions(target.cells)
    half_edges = search.flat.layout.cell_size[search.flat.level_of(target.cells)] / 2.0
    margins = half_edges[:, None] * np.array([1.0, 1.0, 0.0])
    return np.append((positions - margins).min(axis=0), (positions + margins).max(axis=0))


def _find_named_targets(search: Search, text: str) -> list[StandTarget]:
    """Find the objects of ``object:NAME`` or of ``category:NAME``."""
    kind, _, name = text.partition(":")
    names = search.names
    scene_id = search.grid.scene_id
    if kind == "object":
        if name not in names.entries_of_name:
            hint = suggest(name, sorted(names.entries_of_name))
            raise QueryError(
                f"no object {name!r} in {scene_id!r}: {hint}", key="target", value=text, hint=hint
            )
        return [StandTarget(name, names.cells_of(name), names.boxes.get(name))]
    if kind == "category":
        object_names = names.list_objects()
        member_names = [
            object_name for object_name in object_names if find_category(object_name) == name
        ]
        if not member_names:
            hint = suggest(
                name, sorted({find_category(object_name) for object_name in object_names})
            )
            raise QueryError(
                f"no object of category {name!r} in {scene_id!r}: {hint}",
                key="target",
                value=text,
                hint=hint,
            )
        return [
            StandTarget(member, names.cells_of(member), names.boxes.get(member))
            for member in member_names
        ]
    expected = "a position, object:NAME or category:NAME"
    raise QueryError(
        f"expected {expected}, got {text!r}", key="target", value=text, expected=expected
    )


# ---------------------------------------------------------------- the choice of poses


def pick_spread(
    positions: Float,
    target_index: Int,
    path_lengths: Float,
    count: int,
    spread: float,
    rng: Generator,
) -> Int:
    """Pick poses of each target that are apart from each other.

    With path lengths, the poses with the shortest paths are picked first. Without, the first pose
    of a target is drawn at random, and each next one is the farthest from all before.

    Args:
        positions: world x, y, z of all poses [m], shape (n, 3).
        target_index: number of each pose's target, ascending, shape (n,).
        path_lengths: length of the path to each pose [m], shape (n,); NaN for none.
        count: most poses for a target.
        spread: least distance between poses of a target [m].
        rng: the generator for first poses.

    Returns:
        Indices of the poses, by target, in the order in which they were picked.
    """
    if not len(positions):
        return NO_CELLS
    has_paths = not np.isnan(path_lengths).any()
    _, first_index_of_group, group_of_pose = np.unique(
        target_index, return_index=True, return_inverse=True
    )
    is_open = np.ones(len(positions), dtype=np.bool_)
    merits = -path_lengths if has_paths else rng.random(len(positions)) + 1.0
    nearest_distances = np.full(len(positions), np.inf)
    picked_by_round = []
    for _ in range(count):
        merits_of_open = np.where(is_open, merits, -np.inf)
        best_of_group = np.maximum.reduceat(merits_of_open, first_index_of_group)
        is_best = is_open & (merits_of_open == best_of_group[group_of_pose])
        best_indices = np.flatnonzero(is_best)
        group_indices, first_indices = np.unique(group_of_pose[best_indices], return_index=True)
        if not len(group_indices):
            break
        picked_indices = best_indices[first_indices]
        picked_by_round.append(picked_indices)
        picked_of_group = np.full(len(first_index_of_group), -1)
        picked_of_group[group_indices] = picked_indices
        has_picked = picked_of_group[group_of_pose] >= 0
        pick_vectors = positions - positions[picked_of_group[group_of_pose]]
        distances = np.where(has_picked, np.linalg.norm(pick_vectors, axis=1), np.inf)
        nearest_distances = np.minimum(nearest_distances, distances)
        is_open &= nearest_distances >= spread * (1.0 - REACH_SLACK)
        is_open[picked_indices] = False
        if not has_paths:
            merits = nearest_distances
    indices = np.concatenate(picked_by_round)
    return indices[np.argsort(group_of_pose[indices], kind="stable")]
