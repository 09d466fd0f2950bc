"""Scenes with doors that several tests bake."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from navbake.baker.bake.pipeline import BakeResult, run_bake
from navbake.baker.core.clock import Progress
from navbake.config.settings import parse_config

SHELL = """
<geom name="{0}floor" type="box" pos="3 1.5 -0.1" size="3.1 1.6 0.1"/>
<geom name="{0}wall_s" type="box" pos="3 -0.05 1.2" size="3.1 0.05 1.2"/>
<geom name="{0}wall_n" type="box" pos="3 3.05 1.2" size="3.1 0.05 1.2"/>
<geom name="{0}wall_w" type="box" pos="-0.05 1.5 1.2" size="0.05 1.5 1.2"/>
<geom name="{0}wall_e" type="box" pos="6.05 1.5 1.2" size="0.05 1.5 1.2"/>
"""
# Two rooms of 3 x 3 m with a gap of 0.9 m between them
ROOMS = (
    SHELL
    + """
<geom name="{0}wall_1" type="box" pos="3 0.525 1.2" size="0.05 0.525 1.2"/>
<geom name="{0}wall_2" type="box" pos="3 2.475 1.2" size="0.05 0.525 1.2"/>
"""
)
# a leaf that hangs in it, with room for the joint's range
LEAF = """
<body name="{0}leaf" pos="3 1.06 0"><joint name="{0}leaf" axis="0 0 1" range="0 90"/>
<geom name="{0}leaf" type="box" pos="0 0.44 1" size="0.02 0.43 1"/></body>
"""
FIXED_LEAF = """
<body name="leaf" pos="3 1.06 0"><geom type="box" pos="0 0.44 1" size="0.02 0.43 1"/></body>
"""
CUPBOARD = """
<body name="cupboard" pos="5.6 2.6 0"><geom type="box" pos="0.2 0 1" size="0.2 0.4 1"/>
<body name="cupboard_door" pos="-0.02 -0.4 0"><joint axis="0 0 1" range="0 90"/>
<geom type="box" pos="0 0.4 1" size="0.02 0.4 0.95"/></body></body>
"""


def world(*parts: str) -> str:
    """An MJCF text of these things, angles in degrees."""
    content = "".join(part.format("") for part in parts)
    return f'<mujoco><compiler angle="degree"/><worldbody>{content}</worldbody></mujoco>'


def bake_world(
    folder: Path, *parts: str, progress: Progress | None = None, **settings: Any
) -> BakeResult:
    """Bake things with settings as in the YAML."""
    path = folder / "scene.xml"
    path.write_text(world(*parts), encoding="utf-8")
    scene = {"path": str(path), **settings.pop("scene", {})}
    return run_bake(parse_config({"scene": scene, **settings}), progress=progress)
