"""Moves things at random, and holds each update of a Baker against a fresh bake, bit for bit.

    python scripts/sweep_moves.py [--scenes room apartment house-100] [--moves 1000] [--seed 0]
    python scripts/sweep_moves.py --scenes random --moves 10000
    python scripts/sweep_moves.py --scenes storeys-1 storeys-2 storeys-3 tower --moves 200
    python scripts/sweep_moves.py --scenes unkind --moves 600
    python scripts/sweep_moves.py --scenes house-100 --every 4

Chairs, tables, doors and boxes are pushed, turned, stacked, put anywhere and out of the grid; geoms
vanish and appear again; bases drive, lifts go up and down. `unkind` are houses of one to three
storeys, with ceilings, ground and bounds that are wider, `random` small random scenes, each for a
few moves. A scene counts as failed at its first difference, and at a whole bake though nothing that
stands moved.

With `--every`, only each so-many-th grid is held against a fresh bake. What an update gets wrong
stays so until something moves near it again, so that in a large scene little escapes that.
"""

from __future__ import annotations

import argparse
import random
import sys
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import yaml

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "scripts"), str(ROOT / "tests")]

import navbake  # noqa: E402
from benchmarks.moving_scenes import free_pieces, make_any, make_storeys  # noqa: E402
from differences import first_difference  # noqa: E402 (of the tests)
from make_house import make_house  # noqa: E402
from random_scenes import make_scene  # noqa: E402 (of the tests)

SCENES = (
    "room", "bridge", "apartment", "house", "house-100", "tower", "storeys-1", "storeys-2",
    "storeys-3", "unkind", "random",
)  # fmt: skip
MOVES = 15  # in a random scene
# How far tiny moves go, so that cells keep most of what they hold [m]
TINY = (0.0, 1e-9, 0.001, 0.05, -0.05)
ROOM = """
<mujoco><worldbody>
  <geom name="floor" type="box" pos="3 2.5 -0.1" size="3 2.5 0.1"/>
  <geom name="wall_south" type="box" pos="3 0.05 1.25" size="3 0.05 1.25"/>
  <geom name="wall_north" type="box" pos="3 4.95 1.25" size="3 0.05 1.25"/>
  <geom name="wall_west" type="box" pos="0.05 2.5 1.25" size="0.05 2.5 1.25"/>
  <geom name="wall_east" type="box" pos="5.95 2.5 1.25" size="0.05 2.5 1.25"/>
  <geom name="wall_1" type="box" pos="3 1.0 1.25" size="0.05 1.0 1.25"/>
  <geom name="wall_2" type="box" pos="3 3.95 1.25" size="0.05 1.0 1.25"/>
  <body name="door" pos="3 2 1"><joint name="hinge" axis="0 0 1" range="0 1.6"/>
    <geom type="box" pos="0 0.45 0" size="0.02 0.45 1"/></body>
  <body name="mocap" mocap="true" pos="1 1 0.6"><geom type="capsule" size="0.2 0.4"/></body>
  {bodies}
</worldbody></mujoco>
"""
BRIDGE = """
<mujoco><worldbody>
  <geom name="ground" type="plane" size="0 0 1" pos="0 0 -2"/>
  <geom name="west" type="box" pos="1.5 1.5 -0.5" size="1.5 1.5 0.5"/>
  <geom name="east" type="box" pos="6 1.5 -0.5" size="1.5 1.5 0.5"/>
  <body name="slab" pos="3.75 4.5 0"><freejoint/>
    <geom type="box" size="0.9 0.5 0.05"/></body>
  <body name="crate" pos="1 1 0.3"><freejoint/><geom type="box" size="0.3 0.3 0.3"/></body>
</worldbody></mujoco>
"""


def make_model(name: str) -> tuple[Any, dict[str, Any]]:
    """A scene in which things can be moved, and its settings."""
    if name == "room":
        shapes = (
            'type="box" size="{} {} 0.4"',
            'type="cylinder" size="{} {}"',
            'type="sphere" size="{}"',
        )
        rng, bodies = random.Random(1), ""
        for k in range(6):
            size = [round(rng.uniform(0.15, 0.4), 3) for _ in range(2)]
            geom = shapes[k % 3].format(*size)
            place = f'name="thing_{k}" pos="{1 + k * 0.7} 3.5 0.4"'
            bodies += f"<body {place}><freejoint/><geom {geom}/></body>"
        return mujoco.MjModel.from_xml_string(ROOM.format(bodies=bodies)), {}
    if name == "bridge":
        bounds = {"bounds": [-0.5, -0.5, 8.0, 6.0]}
        return mujoco.MjModel.from_xml_string(BRIDGE), {"grid": bounds}
    if name == "house-100":
        return mujoco.MjModel.from_xml_string(free_pieces(make_house(100))), {
            "grid": {"cell_size": 0.05}
        }
    if name == "tower":  # with lifts, whose moves are whole bakes
        text = (ROOT / "configs" / "tower.yaml").read_text(encoding="utf-8")
        settings = {key: value for key, value in yaml.safe_load(text).items() if key != "output"}
        path = ROOT / "configs" / settings.pop("scene")["path"]
        spec = mujoco.MjSpec.from_file(str(path))
        for number, place in enumerate(((0.0, -1.0, 0.3), (2.0, 0.0, 3.5))):
            cart = spec.worldbody.add_body(name=f"cart_{number}", pos=place)
            cart.add_freejoint()
            cart.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.3, 0.2, 0.3])
        return spec.compile(), settings
    if name.startswith("storeys-"):
        xml, settings = make_storeys(int(name[-1]), ceiling=True, wider=True)
        return mujoco.MjModel.from_xml_string(xml), settings
    spec = mujoco.MjSpec.from_file(str(ROOT / "configs" / "scenes" / f"{name}.xml"))
    for body in spec.bodies:
        is_top = body.parent is not None and body.parent.name == "world"
        if is_top and not list(body.joints) and not body.mocap:
            body.add_freejoint()
    return spec.compile(), {}


class Mover:
    """Draws random moves of a model."""

    def __init__(self, model: Any, rng: random.Random) -> None:
        self._model, self._rng = model, rng
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        self._free = {
            model.body(int(body)).name: int(body)
            for body in model.jnt_bodyid[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE]
        }
        self._mocap = [model.body(b).name for b in range(model.nbody) if model.body_mocapid[b] >= 0]
        turns = np.isin(model.jnt_type, (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE))
        self._joints = [model.joint(int(j)).name for j in np.flatnonzero(turns)]
        self._outside: set[str] = set()  # these come back with the next bodies that move
        self._at = {name: data.xpos[body].copy() for name, body in self._free.items()}
        inside = np.abs(data.geom_xpos).max(axis=1) < 1e3
        self._low, self._high = (
            data.geom_xpos[inside].min(axis=0),
            data.geom_xpos[inside].max(axis=0),
        )

    def draw(self) -> dict[str, Any]:
        """What `Baker.update` is told; or geoms to hide or show, as ``geom``."""
        rng, kind = self._rng, self._rng.random()
        if self._joints and (kind < 0.08 or not self._free):
            name = rng.choice(self._joints)
            low, high = self._model.joint(name).range.tolist()
            return {"joints": {name: rng.uniform(low, high) if high > low else rng.uniform(-1, 1)}}
        if kind < 0.11:
            names = list(self._free)
            body = self._free[rng.choice(names)]
            return {"geom": int(self._model.body_geomadr[body])}
        if kind < 0.16 and self._mocap:
            place = [rng.uniform(a, b) for a, b in zip(self._low, self._high, strict=True)]
            return {"bodies": {rng.choice(self._mocap): place}}
        count = 1 if rng.random() < 0.8 else rng.randint(2, min(6, len(self._free)))
        names = {*rng.sample(sorted(self._free), count), *self._outside}
        return {"bodies": {name: self._place(name) for name in sorted(names)}}

    def _place(self, name: str) -> list[float]:
        rng, was = self._rng, self._at[name]
        kind = rng.random()
        place = was + np.array([rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6), 0.0])
        if kind > 0.9:
            place = was + np.array([rng.choice(TINY), rng.choice(TINY), abs(rng.choice(TINY))])
        elif kind > 0.8:  # held up, or on the floor
            place[2] = rng.uniform(self._low[2], self._high[2])
        elif kind < 0.25:
            place = np.array(
                [rng.uniform(a, b) for a, b in zip(self._low, self._high, strict=True)]
            )
            place[2] = was[2]
        elif kind < 0.4:  # on another one
            place = self._at[rng.choice(sorted(self._at))].copy()
            place[2] += rng.uniform(0.3, 0.9)
        elif kind < 0.45:
            place = self._high + np.array([rng.uniform(0, 30), 3.0, 0.0])
        elif kind < 0.55:
            place = was.copy()  # turned only
        is_inside = (self._low - 1 <= place).all() and (place <= self._high + 1).all()
        middle = np.array([*((self._low + self._high) / 2)[:2], was[2]])
        self._at[name] = place if is_inside else middle
        (self._outside.discard if is_inside else self._outside.add)(name)
        angle = rng.uniform(-np.pi, np.pi)
        turn = [np.cos(angle / 2), 0.0, 0.0, np.sin(angle / 2)]
        if rng.random() < 0.15:
            turn = [rng.gauss(0, 1) for _ in range(4)]
        return [*place.tolist(), *turn]


def sweep(name: str, moves: int, seed: int = 0, every: int = 1) -> tuple[str | None, Counter[str]]:
    """Make random moves; the first difference, if any, and why all was baked again, how often."""
    if name in ("random", "unkind"):
        return _sweep_many(name, moves, seed)
    model, settings = make_model(name)
    found, reasons = _sweep_model(model, settings, moves, seed, every)
    return found and f"{name}, seed {seed}, {found}", reasons


def _sweep_many(name: str, moves: int, seed: int) -> tuple[str | None, Counter[str]]:
    """See `sweep`: a few moves in each of many scenes."""
    reasons = Counter[str]()
    for number in range(-(-moves // MOVES)):
        if name == "unkind":
            xml, settings = make_any(1000 * seed + number)
        else:
            xml, settings = make_scene(random.Random(f"{seed} {number}"))
        try:
            model = mujoco.MjModel.from_xml_string(xml)
            found, others = _sweep_model(model, settings, MOVES, number, 1)
        except (ValueError, navbake.SceneError) as error:  # no such scene: neither is it a move
            reasons[f"no scene: {error}"[:60]] += 1
            continue
        reasons += others
        if found:
            return f"{name}, seed {seed}, scene {number}, {found}", reasons
    return None, reasons


def _sweep_model(
    model: Any, settings: dict[str, Any], moves: int, seed: int, every: int
) -> tuple[str | None, Counter[str]]:
    mover, reasons = Mover(model, random.Random(seed)), Counter[str]()
    baker = navbake.Baker(model, **settings)
    found = first_difference(baker.grid, navbake.bake(model, **settings))
    data = mujoco.MjData(model)
    for number in range(moves):
        if found:
            return found, reasons
        move = mover.draw()
        shown = dict(move)
        if "geom" in move:
            geom = move.pop("geom")
            counts = 0 if model.geom_contype[geom] else 1
            model.geom_contype[geom] = model.geom_conaffinity[geom] = counts
        before = baker.grid
        try:
            changes = baker.update(**move)
        except navbake.SceneError as error:
            reasons[f"error: {error}"[:60]] += 1
            assert baker.grid is before
            continue
        reasons[changes.reason] += 1
        if changes.reason and "which stands" not in changes.reason:
            found = f"a whole bake: {changes.reason}"
        if not found and not settings.get("attributes"):
            found = _wrong_cells(before, changes)
        if not found and (number + 1) % every == 0:
            data.qpos[:], data.mocap_pos[:], data.mocap_quat[:] = baker.pose
            found = first_difference(changes.grid, navbake.bake(model, data, **settings))
        if found:
            found = f"move {number} ({shown}): {found}"
    return found, reasons


def _wrong_cells(before: Any, changes: Any) -> str | None:
    """Whether other cells than those that are listed differ from the grid before."""
    if changes.is_new:
        return None
    for number, (one, other) in enumerate(zip(before.levels, changes.grid.levels, strict=True)):
        differs = np.zeros(one.shape, dtype=np.bool_)
        for layer in ("weights", "floor_height", "room_index", "occupancy", "solid"):
            a, b = getattr(one, layer), getattr(other, layer)
            differs |= (a != b) & ~((a != a) & (b != b))
        if not np.array_equal(np.flatnonzero(differs), changes.cells[number]):
            return f"level {number}: other cells changed than those that are listed"
    return None


def main() -> int:
    """Sweep the scenes that are asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=SCENES)
    parser.add_argument("--moves", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--every", type=int, default=1, help="compare each so-many-th grid")
    asked = parser.parse_args()
    warnings.simplefilter("ignore", navbake.BakeWarning)
    failed = 0
    for name in asked.scenes:
        found, reasons = sweep(name, asked.moves, asked.seed, asked.every)
        failed += found is not None
        local = reasons.pop("", 0)
        print(f"{name}: {local} updates near what moved, {sum(reasons.values())} of all")
        for reason, count in reasons.most_common():
            print(f"  {count:6d}  {reason}")
        print(f"  {found or 'each equals a fresh bake'}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
