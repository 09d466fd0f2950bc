"""Bodies that may be doors: by name, or by how they hang and look."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from navbake.baker.kernels.constants import HINGE, SLIDE
from navbake.baker.scene.bodies import find_subtree_ends, geoms_of_bodies
from navbake.baker.scene.collect import collect_shapes
from navbake.baker.scene.extents import Extents, measure_geoms
from navbake.baker.scene.model import data_with_joints
from navbake.baker.scene.names import body_name, joint_name, warn_unmatched
from navbake.baker.scene.scene import Scene
from navbake.baker.scene.shapes import Shapes
from navbake.config.settings import DoorSettings

Bool = NDArray[np.bool_]
Int = NDArray[np.int64]

QUARTER = np.pi / 2  # how far a hinge without limits opens [rad]
UPRIGHT = 0.9  # least cosine between a hinge's axis and the vertical
# What a leaf that is found by itself is like, and how exactly that is asked [m]
LEAF_HEIGHT = 1.5
LEAF_WIDTH = (0.4, 2.5)
LEAF_THICKNESS = 0.2
EXACT = 1e-6
LISTED = 3  # bodies that a warning names at most


@dataclass(frozen=True)
class DoorBody:
    """A body that may be a door.

    Attributes:
        id: its body's name, or ``body <id>``; with the body's number where two look the same.
        joint: its joint's name, or ``joint <id>``; None where it can't move.
        geoms: ids of the counted geoms of the body and of what hangs on it.
        positions: the joint's position in each state but removed [rad or m]; empty where it
            can't move.
        joint_id: MuJoCo's id of the joint, -1 for none.
        named: whether a pattern names it, rather than its looks.
    """

    id: str
    joint: str | None
    geoms: Int
    positions: dict[str, float]
    joint_id: int
    named: bool

    def position(self, state: str) -> float | None:
        """Where its joint is in a state, as modelled in one it hasn't; None for no joint."""
        return self.positions.get(state, self.positions.get("modelled"))


def find_door_bodies(scene: Scene, settings: DoorSettings) -> tuple[list[DoorBody], list[str]]:
    """Find the bodies that may be doors: by name, or because they hang and look like a leaf.

    Args:
        scene: the scene.
        settings: patterns, and whether to look for leaves.

    Returns:
        The bodies, by body id, and warnings. One that hangs on another door is part of it.
    """
    if not settings.patterns and not settings.find:
        return [], []
    model = scene.model
    names = [body_name(model, body) for body in range(model.nbody)]
    matches = _match(names, settings.patterns)
    candidates = _Candidates(scene, settings, matches)
    found: list[int] = []
    end = 0  # of the bodies of the last door
    for body in range(1, model.nbody):
        if body >= end and candidates.is_door(body):
            found.append(body)
            end = int(candidates.ends[body])
    ids = _distinct([names[body] for body in found], found)
    doors = [
        _door_body(scene, name, candidates.joint(body), candidates.geoms(body), bool(matches[body]))
        for name, body in zip(ids, found, strict=True)
    ]
    return doors, _tell_idle(settings.patterns, names, matches, found, candidates)


def without_doors(scene: Scene, doors: Sequence[DoorBody]) -> Scene:
    """The scene as floors, levels and rooms are found from: without what may be a door."""
    if not doors:
        return scene
    return replace(scene, shapes=scene.shapes.only(~_mark_geoms(scene, doors)))


def pose_doors(scene: Scene, doors: Sequence[DoorBody], state: str) -> Shapes:
    """The geometry of all doors, all in one state; those that haven't it are as modelled."""
    mask = _mark_geoms(scene, doors)
    moved = {
        door.joint_id: float(position)
        for door in doors
        if (position := door.position(state)) is not None and position != door.positions["modelled"]
    }
    if not moved:
        return scene.shapes.only(mask)
    data = data_with_joints(scene.model, scene.data, moved)
    geoms = np.flatnonzero(mask).tolist()
    return collect_shapes(scene.model, data, scene.choices, scene.parts, geoms).shapes


class _Candidates:
    """Tells of single bodies whether they may be doors."""

    def __init__(
        self, scene: Scene, settings: DoorSettings, matches: Sequence[Sequence[str]]
    ) -> None:
        self._scene, self._settings, self._matches = scene, settings, matches
        self._counted = np.array([report.counted for report in scene.geoms], dtype=np.bool_)
        self.ends = find_subtree_ends(scene.model)
        self._extents: Extents | None = None

    def joint(self, body: int) -> int:
        """The body's hinge or slide if that is its only joint, else -1."""
        model = self._scene.model
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        is_door = count == 1 and int(model.jnt_type[first]) in (HINGE, SLIDE)
        return first if is_door else -1

    def geoms(self, body: int) -> Int:
        """The counted geoms of a body and of what hangs on it."""
        under = geoms_of_bodies(self._scene.model, body, int(self.ends[body]))
        return under[self._counted[under]]

    def is_door(self, body: int) -> bool:
        """Whether a pattern names it, or it hangs and looks like a leaf; and it has geoms."""
        if self._matches[body]:
            return len(self.geoms(body)) > 0
        joint = self.joint(body)
        if joint < 0 or not self._settings.find or not self._hangs(joint):
            return False
        geoms = self.geoms(body)
        return len(geoms) > 0 and self._looks_like_leaf(geoms)

    def _hangs(self, joint: int) -> bool:
        """Whether it is a hinge about the vertical, or a slide along the floor."""
        axis = self._scene.data.xaxis[joint]
        is_hinge = int(self._scene.model.jnt_type[joint]) == HINGE
        return bool(is_hinge == (abs(axis[2]) >= UPRIGHT))

    def _looks_like_leaf(self, geoms: Int) -> bool:
        """Whether the largest geom is tall, thin and as wide as a door, as it is modelled."""
        if self._extents is None:
            self._extents = measure_geoms(self._moving(), self._scene.model.ngeom)
        extents = self._extents
        leaf = largest_side(extents, geoms)
        return bool(
            extents.high[leaf] - extents.low[leaf] >= LEAF_HEIGHT - EXACT
            and LEAF_WIDTH[0] - EXACT <= extents.long[leaf] <= LEAF_WIDTH[1] + EXACT
            and extents.thin[leaf] <= LEAF_THICKNESS + EXACT
        )

    def _moving(self) -> Shapes:
        """The geometry of what hinges and slides move, so that nothing else is measured."""
        model = self._scene.model
        mask = np.zeros(model.ngeom, dtype=np.bool_)
        is_own = model.body_jntnum == 1
        body = np.asarray(model.jnt_bodyid)[np.isin(model.jnt_type, (HINGE, SLIDE))]
        for first in body[is_own[body]].tolist():
            mask[geoms_of_bodies(model, first, int(self.ends[first]))] = True
        return self._scene.shapes.only(mask)


def largest_side(extents: Extents, geoms: Int) -> int:
    """Which of some geoms has the largest side as seen from its front; the first if none has."""
    area = (extents.long * (extents.high - extents.low))[geoms]
    return int(geoms[0] if np.isnan(area).all() else geoms[np.nanargmax(area)])


def _door_body(scene: Scene, name: str, joint: int, geoms: Int, named: bool) -> DoorBody:
    model = scene.model
    if joint < 0:
        return DoorBody(name, None, geoms, {}, -1, named)
    modelled = float(scene.data.qpos[model.jnt_qposadr[joint]])
    low, high = (float(v) for v in model.jnt_range[joint])
    if not model.jnt_limited[joint]:
        low, high = 0.0, QUARTER if int(model.jnt_type[joint]) == HINGE else 1.0
    closed = min(max(0.0, low), high)
    open_ = low if closed - low > high - closed else high
    positions = {"modelled": modelled, "open": open_, "closed": closed}
    return DoorBody(name, joint_name(model, joint), geoms, positions, joint, named)


def _mark_geoms(scene: Scene, doors: Sequence[DoorBody]) -> Bool:
    mask = np.zeros(scene.model.ngeom, dtype=np.bool_)
    for door in doors:
        mask[door.geoms] = True
    return mask


def _distinct(names: Sequence[str], bodies: Sequence[int]) -> list[str]:
    """Tell apart what would be called the same, as names that aren't UTF-8 may be."""
    count = Counter(names)
    return [
        name if count[name] == 1 else f"{name} (body {body})"
        for name, body in zip(names, bodies, strict=True)
    ]


# ---------------------------------------------------------------- patterns


def _match(names: Sequence[str], patterns: Sequence[str]) -> list[list[str]]:
    """By body id, the patterns that match its name; none for the world."""
    found = [[p for p in patterns if fnmatchcase(name, p)] for name in names]
    found[0] = []
    return found


def _tell_idle(
    patterns: Sequence[str],
    names: Sequence[str],
    matches: Sequence[Sequence[str]],
    found: Sequence[int],
    candidates: _Candidates,
) -> list[str]:
    """Tell which patterns name no door, and what they match instead."""
    used = {pattern for body in found for pattern in matches[body]}
    warnings = []
    for pattern in patterns:
        if pattern in used:
            continue
        bodies = [body for body, matching in enumerate(matches) if pattern in matching]
        if not bodies:
            warnings.append(warn_unmatched("doors.patterns", pattern, names[1:], "no body"))
            continue
        parts = [body for body in bodies if len(candidates.geoms(body))]
        kind = "parts of other doors" if parts else "bodies without geoms that count"
        text = f"only {kind}: {_list_some([names[body] for body in parts or bodies])}"
        others = [name for body, name in enumerate(names) if body and body not in bodies]
        warnings.append(warn_unmatched("doors.patterns", pattern, others, text))
    return warnings


def _list_some(names: Sequence[str]) -> str:
    return ", ".join(names[:LISTED]) + (", …" if len(names) > LISTED else "")
