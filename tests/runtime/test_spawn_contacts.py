"""Spawned agents stand in MuJoCo as cylinders, and touch neither the scene nor one another.

``NAVBAKE_EXAMPLES=500 pytest tests/runtime/test_spawn_contacts.py`` draws 10,000 a scene.
"""

from __future__ import annotations

import os

import mujoco
import numpy as np
import pytest

import navbake
from project_paths import GOLDEN, ROOT

CROWDS = int(os.environ.get("NAVBAKE_EXAMPLES", "50"))
NUM_AGENTS = 20
STEP = 0.25  # [m]: what is lower is stepped over
TOUCH = -1e-9  # [m]: less is touching, not meeting


class Crowd:
    """A scene with cylinders that can be put anywhere."""

    def __init__(self, name: str, keyframe: str | None, radius: float, height: float) -> None:
        spec = mujoco.MjSpec.from_file(str(ROOT / f"configs/scenes/{name}.xml"))
        pose = {key.name: np.array(key.qpos) for key in spec.keys}.get(keyframe)
        for key in list(spec.keys):
            spec.delete(key)  # their size is another one with the agents' joints
        for number in range(NUM_AGENTS):
            body = spec.worldbody.add_body(name=f"agent_{number}")
            for axis in np.eye(3):
                body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
            body.add_geom(
                name=f"agent_{number}",
                type=mujoco.mjtGeom.mjGEOM_CYLINDER,
                size=[radius, (height - STEP) / 2, 0.0],
                pos=[0.0, 0.0, (STEP + height) / 2],
            )
        self.model = spec.compile()
        collides = (self.model.geom_contype | self.model.geom_conaffinity) != 0
        self.agents = slice(self.model.ngeom - NUM_AGENTS, self.model.ngeom)
        # the scene meets agents alone
        self.model.geom_contype[:], self.model.geom_conaffinity[:] = 0, collides
        self.model.geom_contype[self.agents] = 1
        self.data = mujoco.MjData(self.model)
        if pose is not None:
            self.data.qpos[: -3 * NUM_AGENTS] = pose

    def contacts(self, positions: np.ndarray) -> list[tuple[str, str, float]]:
        """Who meets what, and how deep [m], with agents at positions."""
        self.data.qpos[-3 * NUM_AGENTS :] = positions.ravel()
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_comPos(self.model, self.data)
        mujoco.mj_collision(self.model, self.data)
        return [
            (*(self.model.geom(g).name for g in contact.geom), contact.dist)
            for contact in self.data.contact[: self.data.ncon]
            if contact.dist < TOUCH
        ]


@pytest.mark.parametrize(
    ("name", "keyframe", "radius"), [("apartment", None, 0.18), ("house", "doors_open", 0.2)]
)
def test_agents_meet_neither_the_scene_nor_one_another(name, keyframe, radius):
    grid = navbake.load(GOLDEN / f"{name}.grid.json.gz").inflate(radius)
    finder, rng = navbake.PathFinder(grid), np.random.default_rng(0)
    crowd = Crowd(name, keyframe, radius, grid.agent_height)
    for number in range(CROWDS):
        stratify = (None, "area", "room")[number % 3]
        positions, _ = finder.spawn(rng, NUM_AGENTS, stratify=stratify)
        assert crowd.contacts(positions) == []


def test_contacts_are_seen():
    grid = navbake.load(GOLDEN / "apartment.grid.json.gz").inflate(0.18)
    crowd = Crowd("apartment", None, 0.18, grid.agent_height)
    positions, _ = navbake.PathFinder(grid).spawn(np.random.default_rng(0), NUM_AGENTS)
    positions[0] = positions[1] + (0.36 - 1e-3, 0.0, 0.0)
    assert crowd.contacts(positions)
    positions[0] = (-4.9, 0.0, 0.0)  # in a wall
    assert any("wall" in name for names in crowd.contacts(positions) for name in names[:2])
