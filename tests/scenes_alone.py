"""Scenes by their own settings alone."""

from __future__ import annotations

from typing import Any

from navbake.baker.scene.scene import Scene, load_scene
from navbake.config.settings import AgentSettings, BakeConfig, FloorSettings, SceneSettings


def load_alone(
    settings: SceneSettings,
    agent: AgentSettings | None = None,
    floors: FloorSettings | None = None,
    **options: Any,
) -> Scene:
    """Load a scene, with the default for all other settings."""
    config = BakeConfig(
        scene=settings, agent=agent or AgentSettings(), floors=floors or FloorSettings()
    )
    return load_scene(config, **options)
