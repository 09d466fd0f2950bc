"""Drives an agent in MuJoCo along planned paths, and counts what it touches.

Each scene is baked for a small radius and inflated to the agent's at run time. Then paths between
random places are planned and driven: the agent is a cylinder on three slides and a hinge, moved
by servos in real physics steps. As in the bake, it fills the height from
`traversable_floor_height` to its own height above the floor, so it floats over what it could step
on; all that it may touch, with its underside, is floor. The scene stays in the pose that was
baked.

    python scripts/drive_agent.py configs/*.yaml [--paths 200] [--radius 0.18] [--seed 0]
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import navbake
from navbake.baker.scene.scene import Scene, load_scene
from navbake.config.settings import BakeConfig, load_config

BAKED_RADIUS = 0.05  # [m]
RADIUS = 0.18  # [m]; stairs of the samples are for 0.2 m: there, a servo has no millimetre left
TIME_STEP = 0.004  # [s]
SPEED, ACCELERATION = 1.0, 2.0  # [m/s], [m/s²]
STRAIGHT = np.cos(np.radians(1.0))  # it brakes where a path turns by more
MASS = 20.0  # [kg]
FREQUENCY = 60.0  # [rad/s] of the servos
UNDERSIDE = 0.005  # [m] of its lower edge that may touch floor
LOOK = 0.1  # [s] between the places that are kept
THICKNESS = 1e-4  # [m] of a triangle that something may run into


@dataclass
class Drive:
    """What came of driving through a scene.

    Attributes:
        num_paths: how many paths were driven.
        num_steps: physics steps.
        length: of all paths [m].
        touched: in how many steps each geom was touched, by name; floor is not counted.
        num_on_floor: in how many steps its underside touched something no steeper than floor is.
        off: the farthest that the agent was from where it should have been [m].
    """

    num_paths: int = 0
    num_steps: int = 0
    length: float = 0.0
    touched: Counter[str] = field(default_factory=Counter)
    num_on_floor: int = 0
    off: float = 0.0

    @property
    def num_contacts(self) -> int:
        return sum(self.touched.values())


# --- the scene with an agent in it ---------------------------------------------------------


def make_model(config: BakeConfig, scene: Scene, radius: float) -> Any:
    """Compile the scene with an agent that nothing but the counted geoms can touch."""
    path = config.scene.path
    spec = mujoco.MjSpec.from_file(str(path)) if path.suffix == ".xml" else triangle_spec(scene)
    for key in list(spec.keys):
        spec.delete(key)  # their size is another one with the agent's joints
    add_agent(spec, config, radius)
    spec.option.timestep = TIME_STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model = spec.compile()
    model.geom_contype[:-1], model.geom_conaffinity[:-1] = 0, 1  # the last one is the agent's
    if path.suffix == ".xml":
        model.geom_conaffinity[:-1] = [geom.counted for geom in scene.geoms]
    return model


def triangle_spec(scene: Scene) -> Any:
    """A model of all triangles of a scene, each a thin solid, as MuJoCo collides hulls only."""
    spec = mujoco.MjSpec()
    for number, corners in enumerate(scene.shapes.triangles.corners):
        a, b, c = corners
        normal = np.cross(b - a, c - a)
        area = np.linalg.norm(normal)
        if area < 1e-9:
            continue
        centre, offset = corners.mean(axis=0), normal / area * THICKNESS / 2
        mesh = spec.add_mesh(name=f"triangle_{number}")
        sides = [corners - centre + offset, corners - centre - offset]
        mesh.uservert = np.concatenate(sides).ravel()
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        geom = int(scene.shapes.triangles.geom[number])
        spec.worldbody.add_geom(
            name=f"{scene.geoms[geom].name}/{number}",
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=mesh.name,
            pos=centre,
        )
    return spec


def add_agent(spec: Any, config: BakeConfig, radius: float) -> None:
    """Add a cylinder that three servos move and one turns."""
    low, high = config.agent.traversable_floor_height, config.agent.height
    body = spec.worldbody.add_body(name="agent", gravcomp=1.0)
    body.add_geom(
        name="agent",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=[radius, (high - low) / 2, 0.0],
        pos=[0.0, 0.0, (low + high) / 2],
        mass=MASS,
        contype=1,
        conaffinity=0,
    )
    for name, axis in {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1), "heading": None}.items():
        kind = mujoco.mjtJoint.mjJNT_SLIDE if axis else mujoco.mjtJoint.mjJNT_HINGE
        body.add_joint(name=f"agent_{name}", type=kind, axis=axis or (0, 0, 1))
        inertia = MASS if axis else MASS * radius**2 / 2
        add_servo(spec, f"agent_{name}", inertia * FREQUENCY**2, 2 * inertia * FREQUENCY)


def add_servo(spec: Any, joint: str, stiffness: float, damping: float) -> None:
    """Add what pulls a joint to where it should be, critically damped."""
    servo = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.gaintype, servo.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
    servo.gainprm[0] = stiffness
    servo.biasprm[1:3] = -stiffness, -damping


# --- the course ----------------------------------------------------------------------------


def schedule(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the agent should be and how fast it should move, step by step.

    It speeds up and brakes evenly, and stops where the path turns or a step goes straight up or
    down, so that it can keep to it.

    Args:
        positions: of the path, shape (n, 3) [m].

    Returns:
        Positions and velocities, shape (steps, 3).
    """
    flat = np.hypot(*np.diff(positions[:, :2], axis=0).T)
    ways = np.diff(positions[:, :2], axis=0) / np.maximum(flat, 1e-12)[:, None]
    turns = (ways[1:] * ways[:-1]).sum(axis=1) < STRAIGHT
    stops = [0, *(np.flatnonzero(turns) + 1).tolist(), len(positions) - 1]
    course = np.concatenate([ride_along(positions[a : b + 1]) for a, b in pairwise(stops)])
    return course, np.gradient(course, TIME_STEP, axis=0)


def ride_along(positions: np.ndarray) -> np.ndarray:
    """Positions on a line from rest to rest, straight from above or straight up or down."""
    run = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(positions[:, :2], axis=0).T))])
    if run[-1] == 0.0:
        run = np.array([0.0, np.abs(positions[-1, 2] - positions[0, 2])])
        positions = positions[[0, -1]]
    distance = ride(run[-1])
    return np.column_stack([np.interp(distance, run, axis) for axis in positions.T])


def ride(length: float) -> np.ndarray:
    """Distances along a straight line that is run from rest to rest, step by step."""
    ramp = min(SPEED / ACCELERATION, np.sqrt(length / ACCELERATION))
    top = ACCELERATION * ramp
    cruise = (length - top * ramp) / top if top > 0 else 0.0
    t = np.arange(0.0, 2 * ramp + cruise, TIME_STEP)
    up = 0.5 * ACCELERATION * np.minimum(t, ramp) ** 2
    along = top * np.clip(t - ramp, 0.0, cruise)
    left = np.clip(t - ramp - cruise, 0.0, ramp)
    return np.append(up + along + top * left - 0.5 * ACCELERATION * left**2, length)


# --- driving -------------------------------------------------------------------------------


def drive(config: BakeConfig, num_paths: int, radius: float, seed: int) -> Drive:
    """Bake a scene, plan paths at a radius, drive them, and count contacts."""
    baked = config.model_copy(
        update={"agent": config.agent.model_copy(update={"radius": BAKED_RADIUS})}
    )
    grid = navbake.bake(baked).inflate(radius)
    finder = navbake.PathFinder(grid)
    scene = load_scene(config)
    model = make_model(config, scene, radius)
    data, pose = mujoco.MjData(model), scene.data.qpos.copy()
    if config.scene.path.suffix != ".xml":
        pose = np.empty(0)
    rng, result = np.random.default_rng(seed), Drive()
    while result.num_paths < num_paths:
        start = finder.random_point(rng)
        path = finder.find_path(start, finder.random_point(rng, reachable_from=start))
        if path is None or path.length == 0.0:
            continue
        drive_line(model, data, pose, path.positions, result, config.agent.max_slope)
        result.num_paths += 1
        result.length += path.length
    return result


def drive_line(
    model: Any, data: Any, pose: np.ndarray, positions: np.ndarray, result: Drive, max_slope: float
) -> np.ndarray:
    """Drive along a line from its start, and add what came of it; where the agent was, (n, 3)."""
    course, velocity = schedule(positions)
    level = np.cos(np.radians(max_slope))
    heading = find_heading(velocity)
    course = np.column_stack([course, heading])
    velocity = np.column_stack([velocity, np.gradient(heading, TIME_STEP)])
    mujoco.mj_resetData(model, data)
    own = slice(len(pose), len(pose) + 4)
    data.qpos[own] = course[0]
    places = [course[0, :3]]
    for place, rate in zip(course, velocity, strict=True):
        data.qpos[: len(pose)], data.qvel[:-4] = pose, 0.0  # as it was baked
        data.ctrl[-4:] = place + rate * (2 / FREQUENCY)  # so that its speed is the course's too
        mujoco.mj_step(model, data)
        result.num_steps += 1
        result.off = max(result.off, float(np.abs(data.qpos[own] - place)[:3].max()))
        count_contacts(model, data, result, level)
        places.append(data.qpos[own][:3].copy())
    return np.array([*places[:: round(LOOK / TIME_STEP)], places[-1]])


def count_contacts(model: Any, data: Any, result: Drive, level: float) -> None:
    """Count what the agent touches now; what is as level as `level` and below it is floor."""
    if not data.ncon:  # the list of contacts takes longer to make than a step
        return
    agent = model.body("agent").id
    bottom = data.geom_xpos[-1, 2] - model.geom_size[-1, 1]
    for contact in data.contact[: data.ncon]:
        geoms = [g for g in contact.geom if model.geom_bodyid[g] != agent]
        is_below = contact.pos[2] < bottom + UNDERSIDE
        if is_below and abs(contact.frame[2]) > level:
            result.num_on_floor += 1
        else:
            result.touched.update(model.geom(g).name for g in geoms)


def find_heading(velocity: np.ndarray) -> np.ndarray:
    """The way that the agent looks, step by step: where it goes, or last went [rad]."""
    moves = np.hypot(velocity[:, 0], velocity[:, 1]) > 0.05 * SPEED
    angle = np.unwrap(np.arctan2(velocity[moves, 1], velocity[moves, 0]))
    if not len(angle):
        return np.zeros(len(velocity))
    times = np.arange(len(velocity))
    smooth = np.ones(25) / 25  # it turns within 0.1 s
    return np.convolve(np.pad(np.interp(times, times[moves], angle), 12, "edge"), smooth, "valid")


# --- the report ----------------------------------------------------------------------------


def main() -> None:
    parser = argparse.ArgumentParser(description="Drive planned paths in MuJoCo, count contacts.")
    parser.add_argument("configs", type=Path, nargs="+", help="settings (YAML) of scenes")
    parser.add_argument("--paths", type=int, default=200, help="in each scene")
    parser.add_argument("--radius", type=float, default=RADIUS, help="of the agent [m]")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    total = 0
    for path in options.configs:
        config = load_config(path, [])
        result = drive(config, options.paths, options.radius, options.seed)
        total += result.num_contacts
        print(
            f"{config.scene.id:<12} {result.num_paths} paths, {result.length:7.1f} m, "
            f"{result.num_steps:,} steps, at most {result.off * 1000:.1f} mm off: "
            f"{result.num_contacts} contacts, {result.num_on_floor} with the floor"
        )
        for name, count in result.touched.most_common(5):
            print(f"  {name}: in {count} steps")
    raise SystemExit(1 if total else 0)


if __name__ == "__main__":
    main()
