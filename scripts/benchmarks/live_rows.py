"""Rows of a Baker's updates, next to fresh bakes of the same scene."""

from __future__ import annotations

import random
import time
import warnings
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

import navbake
from benchmarks.measure import Job, Row, Sample
from benchmarks.scenes import CELL, Scenes

CHAIRS, MANY = 1, 100  # bodies that are moved at once


def make_rows(scenes: Scenes) -> dict[str, Callable[[], Row]]:
    """The rows by name, each made when it is asked for."""
    return {
        "update": lambda: _row(scenes, CHAIRS, limit=0.010),
        "update 100": lambda: _row(scenes, MANY, limit=0.150),
    }


def _row(scenes: Scenes, count: int, limit: float) -> Row:
    from sweep_moves import free_pieces  # beside bench.py

    warnings.simplefilter("ignore", navbake.BakeWarning)
    model = mujoco.MjModel.from_xml_string(free_pieces(scenes.main.read_text()))
    settings: dict[str, Any] = {"grid": {"cell_size": CELL}}
    baker = navbake.Baker(model, **settings)
    moves = _Moves(model)

    def update() -> Sample:
        asked = moves.draw(count)
        begin = time.perf_counter()
        changes = baker.update(bodies=asked)
        seconds = time.perf_counter() - begin
        return Sample(seconds, facts={"reason": changes.reason, "cells": len(changes.cells[0])})

    def bake() -> Sample:
        data = mujoco.MjData(model)
        data.qpos[:] = baker.pose[0]
        begin = time.perf_counter()
        navbake.bake(model, data, **settings)
        return Sample(time.perf_counter() - begin)

    name = "a chair moves" if count == 1 else f"{count} bodies move at once"
    return Row(
        Job(f"Baker.update: {name}", update, warms_up=True),
        [Job("a fresh bake of the model in memory", bake, warms_up=True)],
        limit=limit,
    )


class _Moves:
    """Pushes pieces of furniture by up to half a metre from where they were at first."""

    def __init__(self, model: Any) -> None:
        self._rng = random.Random(0)
        self._places = {model.body(b).name: model.body_pos[b].copy() for b in range(1, model.nbody)}
        edge = float(np.stack(list(self._places.values()))[:, :2].max())
        self._low, self._high = 1.0, edge - 0.7  # nothing of one stands beyond the house

    def draw(self, count: int) -> dict[str, list[float]]:
        rng, moves = self._rng, {}
        for name in rng.sample(sorted(self._places), count):
            x, y, z = self._places[name]
            x, y = (min(max(v + rng.uniform(-0.5, 0.5), self._low), self._high) for v in (x, y))
            moves[name] = [x, y, z]
        return moves
