"""Scenes of boxes that several tests write."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from navbake.baker.bake.stages import Stages, bake_stages


def world(content: str, assets: str = "") -> str:
    return f"<mujoco><asset>{assets}</asset><worldbody>{content}</worldbody></mujoco>"


def box(name: str, x0: float, y0: float, z0: float, x1: float, y1: float, z1: float) -> str:
    pos = f"{(x0 + x1) / 2} {(y0 + y1) / 2} {(z0 + z1) / 2}"
    size = f"{(x1 - x0) / 2} {(y1 - y0) / 2} {(z1 - z0) / 2}"
    named = f'name="{name}" ' if name else ""
    return f'<geom {named}type="box" pos="{pos}" size="{size}"/>'


def body(name: str, content: str, more: str = "") -> str:
    named = f'name="{name}"' if name else ""
    return f"<body {named} {more}>{content}</body>"


FLOOR = box("floor", -2, -2, -0.1, 2, 2, 0)


def stages_of_xml(folder: Path, xml: str, **settings: Any) -> Stages:
    """The stages of an MJCF text, with settings as in the YAML."""
    path = folder / "scene.xml"
    path.write_text(xml, encoding="utf-8")
    scene = {"path": str(path), **settings.pop("scene", {})}
    return bake_stages({"scene": scene, **settings})
