"""Door candidates: bodies that a pattern names, or with the joint and shape of a door's leaf."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property

import numpy as np

from navbake.baker.kernels.constants import HINGE, SLIDE
from navbake.baker.scene.collect import collect_shapes
from navbake.baker.scene.extents import Extents, measure_geoms
from navbake.baker.scene.names import (
    all_names,
    find_subtree_ends,
    geoms_of_bodies,
    joint_name,
    warn_unmatched,
)
from navbake.baker.scene.pose import data_with_joints
from navbake.baker.scene.scene import Scene
from navbake.baker.scene.shapes import Shapes
from navbake.config.settings import DoorSettings
from navbake.types import Bool, Int

QUARTER = np.pi / 2  # how far a hinge without limits opens [rad]
# The size of a leaf that no pattern names, and the rounding that is allowed for [m]
MIN_HEIGHT = 1.5
MIN_WIDTH, MAX_WIDTH = 0.4, 2.5
MAX_THICKNESS = 0.2
ROUNDING = 1e-6
MAX_LISTED = 3  # bodies that a warning names at most


@dataclass(frozen=True, eq=False)
class DoorCandidate:
    """A body that may be a door.

    Attributes:
        id: its body's name, or ``body <id>``; with the body's number where two look the same.
        joint: its joint's name, or ``joint <id>``; None where it can't move.
        geoms: ids of the counted geoms of the body and its descendants, shape (n,), int64.
        positions: the joint's position in each state but removed [rad or m]; empty for no joint.
        joint_id: MuJoCo's id of the joint, -1 for none.
        named: whether a pattern names it; else it was found by its joint and shape.
    """

    id: str
    joint: str | None
    geoms: Int
    positions: dict[str, float]
    joint_id: int
    named: bool

    def position(self, state: str) -> float | None:
        """The joint's position in a state, as modelled where it hasn't that; None for no joint."""
        return self.positions.get(state, self.positions.get("modelled"))

    def only(self, shapes: Shapes) -> Shapes:
        """The candidate's own part of some geometry."""
        return shapes.only(_mark_geoms(len(shapes.endless), [self]))


def find_candidates(scene: Scene, settings: DoorSettings) -> tuple[list[DoorCandidate], list[str]]:
    """Find bodies that may be doors, by name or by joint and shape; warn of unused patterns.

    The candidates are sorted by body id. Descendants of one are part of it.
    """
    if not settings.patterns and not settings.find:
        return [], []
    model = scene.model
    names = all_names(model).bodies
    # by body id, the patterns that match its name; none for the world
    matches = [[p for p in settings.patterns if fnmatchcase(name, p)] for name in names[1:]]
    search = _BodySearch(scene, settings, [[], *matches])
    found: list[int] = []
    end = 0  # of the bodies of the last candidate
    for body in range(1, model.nbody):
        if body >= end and search.is_candidate(body):
            found.append(body)
            end = int(search.ends[body])
    count = Counter(names[body] for body in found)
    candidates = []
    for body in found:
        # names that aren't UTF-8 may look the same
        suffix = f" (body {body})" if count[names[body]] > 1 else ""
        candidates.append(search.describe(names[body] + suffix, body))
    return candidates, _warn_unmatched(settings.patterns, names, found, search)


def without_doors(scene: Scene, doors: Sequence[DoorCandidate]) -> Scene:
    """The scene without the geometry of some bodies."""
    if not doors:
        return scene
    return replace(scene, shapes=scene.shapes.only(~_mark_geoms(scene.model.ngeom, doors)))


def pose_doors(scene: Scene, doors: Sequence[DoorCandidate], state: str) -> Shapes:
    """The geometry of all doors in one state; doors without that state stay as modelled."""
    mask = _mark_geoms(scene.model.ngeom, doors)
    moved = {
        door.joint_id: float(position)
        for door in doors
        if (position := door.position(state)) is not None and position != door.positions["modelled"]
    }
    if not moved:
        return scene.shapes.only(mask)
    data = data_with_joints(scene.model, scene.data, moved)
    geoms = np.flatnonzero(mask).tolist()
    collected = collect_shapes(scene.model, data, scene.choices, scene.parts, geoms, scene.meshes)
    return collected.shapes


class _BodySearch:
    """Decides of single bodies whether they may be doors."""

    def __init__(self, scene: Scene, settings: DoorSettings, matches: list[list[str]]) -> None:
        self._scene, self._settings, self.matches = scene, settings, matches
        self._counted = np.array([report.counted for report in scene.geoms], dtype=np.bool_)
        self.ends = find_subtree_ends(scene.model)

    def geoms(self, body: int) -> Int:
        """The counted geoms of a body and its descendants."""
        under = geoms_of_bodies(self._scene.model, body, int(self.ends[body]))
        return under[self._counted[under]]

    def is_candidate(self, body: int) -> bool:
        """Whether a pattern names it, or it moves and looks like a leaf; and it has geoms.

        A leaf may turn or slide about or along any axis: garage doors tilt, and rollers go up.
        """
        if self.matches[body]:
            return len(self.geoms(body)) > 0
        joint = self._joint(body)
        if joint < 0 or not self._settings.find:
            return False
        geoms = self.geoms(body)
        return len(geoms) > 0 and self._looks_like_leaf(geoms)

    def describe(self, name: str, body: int) -> DoorCandidate:
        """The candidate that a body is; a joint opens to the end of its range farther from 0."""
        model, joint, geoms = self._scene.model, self._joint(body), self.geoms(body)
        named = bool(self.matches[body])
        if joint < 0:
            return DoorCandidate(name, None, geoms, {}, -1, named)
        modelled = float(self._scene.data.qpos[model.jnt_qposadr[joint]])
        low, high = (float(v) for v in model.jnt_range[joint])
        if not model.jnt_limited[joint]:
            low, high = 0.0, QUARTER if int(model.jnt_type[joint]) == HINGE else 1.0
        closed = min(max(0.0, low), high)
        open_ = low if closed - low > high - closed else high
        positions = {"modelled": modelled, "open": open_, "closed": closed}
        return DoorCandidate(name, joint_name(model, joint), geoms, positions, joint, named)

    def _joint(self, body: int) -> int:
        """The body's hinge or slide if that is its only joint, else -1."""
        model = self._scene.model
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        return first if count == 1 and int(model.jnt_type[first]) in (HINGE, SLIDE) else -1

    def _looks_like_leaf(self, geoms: Int) -> bool:
        """Whether the largest geom is tall, thin and as wide as a door, as it is modelled."""
        extents, leaf = self._extents, largest_side(self._extents, geoms)
        return bool(
            extents.high[leaf] - extents.low[leaf] >= MIN_HEIGHT - ROUNDING
            and MIN_WIDTH - ROUNDING <= extents.long[leaf] <= MAX_WIDTH + ROUNDING
            and extents.thin[leaf] <= MAX_THICKNESS + ROUNDING
        )

    @cached_property
    def _extents(self) -> Extents:
        """The extents of what hinges and slides move; nothing else is worth measuring."""
        model = self._scene.model
        mask = np.zeros(model.ngeom, dtype=np.bool_)
        bodies = np.asarray(model.jnt_bodyid)[np.isin(model.jnt_type, (HINGE, SLIDE))]
        for body in bodies[model.body_jntnum[bodies] == 1].tolist():
            mask[geoms_of_bodies(model, body, int(self.ends[body]))] = True
        return measure_geoms(self._scene.shapes.only(mask), model.ngeom)


def largest_side(extents: Extents, geoms: Int) -> int:
    """The geom with the largest upright side; the first if none is finite."""
    area = (extents.long * (extents.high - extents.low))[geoms]
    return int(geoms[0] if np.isnan(area).all() else geoms[np.nanargmax(area)])


def _mark_geoms(num_geoms: int, doors: Sequence[DoorCandidate]) -> Bool:
    mask = np.zeros(num_geoms, dtype=np.bool_)
    for door in doors:
        mask[door.geoms] = True
    return mask


def _warn_unmatched(
    patterns: Sequence[str], names: Sequence[str], found: Sequence[int], search: _BodySearch
) -> list[str]:
    """Warn of patterns that name no candidate, and say what they match instead."""
    used = {pattern for body in found for pattern in search.matches[body]}
    warnings = []
    for pattern in patterns:
        if pattern in used:
            continue
        bodies = [body for body, matching in enumerate(search.matches) if pattern in matching]
        if not bodies:
            warnings.append(warn_unmatched("doors.patterns", pattern, names[1:], "no body"))
            continue
        parts = [body for body in bodies if len(search.geoms(body))]
        kind = "parts of other doors" if parts else "bodies without geoms that count"
        matched = [names[body] for body in parts or bodies]
        more = ", …" if matched[MAX_LISTED:] else ""
        text = f"only {kind}: {', '.join(matched[:MAX_LISTED])}{more}"
        others = [name for body, name in enumerate(names) if body and body not in bodies]
        warnings.append(warn_unmatched("doors.patterns", pattern, others, text))
    return warnings
