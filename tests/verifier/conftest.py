"""Grids of a room and of two storeys, which several tests verify; these change copies."""

from __future__ import annotations

import pytest

import navbake
from box_worlds import world
from verified_scenes import of_room, stairs_house, write


@pytest.fixture(scope="package")
def room(tmp_path_factory):
    return of_room(tmp_path_factory.mktemp("room"))


@pytest.fixture(scope="package")
def house(tmp_path_factory):
    folder = tmp_path_factory.mktemp("house")
    config = {"scene": {"path": str(write(folder, world(stairs_house())))}}
    grid = navbake.bake(config)
    assert len(grid.levels) == 2
    return grid, config
