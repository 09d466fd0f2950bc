"""The geometry of leaves in the states of doors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from navbake.baker.geometry.shapes import Shapes
from navbake.baker.scene.collect import collect_shapes
from navbake.baker.scene.leaves import DoorCandidate, mark_candidate_geoms
from navbake.baker.scene.pose import data_with_joints
from navbake.baker.scene.scene import Scene


def pose_doors(scene: Scene, doors: Sequence[DoorCandidate], state: str) -> Shapes:
    """The geometry of all doors in one state; doors without that state stay as modelled."""
    mask = mark_candidate_geoms(scene.model.ngeom, doors)
    moved = {
        door.joint_id: float(position)
        for door in doors
        if (position := door.position(state)) is not None and position != door.positions["modelled"]
    }
    if not moved:
        return scene.shapes.only(mask)
    data = data_with_joints(scene.model, scene.data, moved)
    geoms = np.flatnonzero(mask).tolist()
    return collect_shapes(
        scene.model,
        data,
        selections=scene.selections,
        exact_meshes=scene.exact_meshes,
        only=geoms,
        meshes=scene.meshes,
    )[0]
