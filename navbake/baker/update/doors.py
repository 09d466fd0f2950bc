"""Doors of a scene in which things move: only those near what moved are placed again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from navbake.baker.doors.candidates import DoorCandidate, find_candidates, pose_doors
from navbake.baker.doors.doors import (
    MIN_AREA,
    SIGHT,
    Doors,
    Surroundings,
    place_doors,
    warn_immovable_doors,
)
from navbake.baker.kernels.constants import HINGE, SLACK, SLIDE
from navbake.baker.scene.extents import measure_geoms
from navbake.baker.scene.names import find_subtree_ends, geoms_of_bodies
from navbake.baker.scene.scene import Scene
from navbake.baker.update.columns import Scratch
from navbake.baker.update.full_bake import FullBake
from navbake.baker.update.kernels.regions import cells_of_boxes
from navbake.config.settings import BakeConfig
from navbake.navgrid.doors import STATES
from navbake.navgrid.lattice import Lattice
from navbake.threads import limit_threads
from navbake.types import Bool, Float, Int


class CandidateSearch:
    """Finds the candidates for doors again when anything moves that they depend on."""

    def __init__(self, config: BakeConfig, scene: Scene, candidates: list[DoorCandidate]) -> None:
        self._config, self.candidates = config, candidates
        model = scene.model
        ends = find_subtree_ends(model)
        is_leaf = np.isin(model.jnt_type, (HINGE, SLIDE))
        self._joints = np.asarray(model.jnt_qposadr)[is_leaf]
        self._geoms = np.zeros(model.ngeom, dtype=np.bool_)
        for body in np.asarray(model.jnt_bodyid)[is_leaf].tolist():
            self._geoms[geoms_of_bodies(model, body, int(ends[body]))] = True
        for candidate in candidates:
            self._geoms[candidate.geoms] = True
        self._qpos = scene.data.qpos[self._joints].copy()
        self._limits = _joint_limits(model)

    def follow(self, scene: Scene, moved: Bool) -> dict[str, DoorCandidate]:
        """The candidates that differ now, by their ids; FullBake where they are not the same."""
        qpos, limits = scene.data.qpos[self._joints], _joint_limits(scene.model)
        turns_alike = np.array_equal(limits, self._limits)
        is_same = np.array_equal(qpos, self._qpos) and turns_alike
        if is_same and not (moved & self._geoms).any():
            return {}
        found, _ = find_candidates(scene, self._config.doors)
        pairs = zip(self.candidates, found, strict=False)
        if len(found) != len(self.candidates) or not all(_are_alike(*pair) for pair in pairs):
            raise FullBake("other bodies look like doors")
        differ = {
            new.id: new
            for old, new in zip(self.candidates, found, strict=True)
            if old.positions != new.positions or moved[old.geoms].any() or not turns_alike
        }
        self.candidates = [differ.get(old.id, old) for old in self.candidates]
        self._qpos, self._limits = qpos.copy(), limits
        return differ


class Reach(NamedTuple):
    """What a door depends on: a box round all of its states [m]; and whether it is wide."""

    box: Float
    is_wide: bool


class LiveDoors:
    """The doors of a scene, kept up to date."""

    def __init__(
        self, scene: Scene, candidates: Sequence[DoorCandidate], lattice: Lattice, scratch: Scratch
    ) -> None:
        self._lattice, self._scratch = lattice, scratch
        self._reach: dict[str, Reach] = {}
        self._measure(scene, candidates)

    def follow(
        self,
        doors: Doors,
        scene: Scene,
        candidates: Sequence[DoorCandidate],
        differ: set[str],
        touched: Int | None,
        around: Surroundings,
        state: str,
    ) -> Doors:
        """The doors as they are now.

        Args:
            doors: as they were.
            scene: as it is now, doors included.
            differ: ids of the candidates that moved.
            touched: the cells near what moved, ascending; None where all doors are to be placed.
            around: what they stand in now.
            state: that is wanted of all.
        """
        reach = max(SIGHT, around.footprints.whole.reach)
        again = [
            candidate
            for candidate in candidates
            if candidate.id in differ or self._is_near(candidate.id, touched, reach)
        ]
        if not again:
            return doors
        if any(self._reach[candidate.id].is_wide for candidate in again):
            raise FullBake("a door may carry a floor")
        self._measure(scene, again)
        if any(self._reach[candidate.id].is_wide for candidate in again):
            raise FullBake("a door may carry a floor")
        with limit_threads(1):
            new = place_doors(scene, again, around)
        asked = {candidate.id for candidate in again}
        placed = {door.id: door for door in doors.placed if door.id not in asked}
        placed |= {door.id: door for door in new.placed}
        rejected = {one.id: one for one in doors.rejected if one.id not in asked}
        rejected |= {one.id: one for one in new.rejected}
        now = [placed[c.id] for c in candidates if c.id in placed]
        warnings = doors.warnings
        if not rejected:
            walkable = warnings[len(warn_immovable_doors(doors.placed, state)) :]
            warnings = [*warn_immovable_doors(now, state), *walkable]
        out = [candidate for candidate in candidates if candidate.id in rejected]
        return replace(doors, placed=now, rejected=out, warnings=warnings)

    def _is_near(self, door: str, touched: Int | None, reach: float) -> bool:
        if touched is None:
            return True
        cell = self._lattice.cell_size
        box = self._reach[door].box[None]
        near = cells_of_boxes(self._lattice, box, reach + 2 * cell, 1.0, self._scratch.flag)
        place = np.searchsorted(touched, near)
        return bool((np.append(touched, -1)[place] == near).any())

    def _measure(self, scene: Scene, candidates: Sequence[DoorCandidate]) -> None:
        if not candidates:
            return
        num = scene.model.ngeom
        boxes: dict[str, list[Float]] = {candidate.id: [] for candidate in candidates}
        wide: set[str] = set()
        for state in STATES:
            if state == "removed":
                continue
            shapes = pose_doors(scene, candidates, state)
            extents = measure_geoms(shapes, num)
            for candidate in candidates:
                bounds = candidate.only(shapes).bounds()
                if bounds is not None:
                    boxes[candidate.id].append(bounds)
                area = np.nansum((extents.thin * extents.long)[candidate.geoms])
                if area >= MIN_AREA - SLACK:
                    wide.add(candidate.id)
        for name, found in boxes.items():
            box = np.full(6, np.inf)
            if found:
                low, high = np.stack(found).min(axis=0)[0], np.stack(found).max(axis=0)[1]
                box = np.concatenate([low, high])
            known = self._reach.get(name)
            if known is not None and found:  # where it was counts, too
                box[:3] = np.minimum(box[:3], known.box[:3])
                box[3:] = np.maximum(box[3:], known.box[3:])
            self._reach[name] = Reach(box, name in wide)


def _joint_limits(model: Any) -> Float:
    """How joints turn and how far, shape (njnt, 9); users write there."""
    limited = np.asarray(model.jnt_limited, dtype=np.float64)
    states = model.jnt_range, limited[:, None], model.jnt_axis, model.jnt_pos
    return np.hstack(states)


def _are_alike(one: DoorCandidate, other: DoorCandidate) -> bool:
    """Whether two candidates are the same but for how they are modelled."""
    same = (one.id, one.joint, one.joint_id, one.named) == (
        other.id,
        other.joint,
        other.joint_id,
        other.named,
    )
    return same and np.array_equal(one.geoms, other.geoms)
