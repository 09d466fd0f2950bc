"""The settings of the scene: its file, which of its geoms count, and its pose."""

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from navbake.config.field_types import (
    Name,
    Patterns,
    Positive,
    Section,
    Settings,
    expects,
    resolve,
    section,
    setting,
    to_path,
)

MeshMode = Literal["auto", "hull", "surface", "shell"]


def _check_id(value: str) -> str:
    if value in (".", "..") or not value.isprintable() or set(value) & set("/\\"):
        raise ValueError("no id")
    return value


def memory_path(name: str) -> Path:
    """What stands for the path of a scene in memory: its name, as in ``<apartment>``."""
    name = "".join(char if char.isprintable() and char not in "/\\" else "_" for char in name)
    return Path(f"<{name if name.strip('. ') else 'scene'}>")


def is_memory_path(path: str | PathLike[str]) -> bool:
    """Whether a path stands for a scene in memory that was given no file's name."""
    return str(path).startswith("<") and str(path).endswith(">")


def stem_of(path: str | PathLike[str]) -> str:
    """The stem of a scene file's name, or the name of a scene in memory."""
    return str(path)[1:-1] if is_memory_path(path) else Path(path).stem


ScenePath = Annotated[
    Path, BeforeValidator(to_path), expects("the path of a scene file"), AfterValidator(resolve)
]
SceneId = Annotated[
    str,
    Field(min_length=1),
    AfterValidator(_check_id),
    expects("text without / and \\ (a number needs quotes)"),
]


class ExcludeSettings(Settings):
    """What is left out of the scene, by name patterns with the shell's wildcards."""

    bodies: Patterns = setting(
        [], "body name patterns (*, ?, [...]); child bodies are left out too"
    )
    geoms: Patterns = setting([], "geom name patterns")
    movable: bool = setting(False, "true: leave out bodies with a free joint; or false")


class SceneSettings(Settings):
    """The scene, which of its geoms count, and its pose."""

    id: SceneId = setting("", "the scene's id, without / and \\", "the scene file's stem")
    path: ScenePath = Field(
        description="MJCF, MJB, URDF, OBJ, PLY, STL, GLB or DAE, relative to this file; no default"
    )
    up: Literal["z", "y"] = setting("z", "axis that points up in mesh files: z or y")
    unit: Positive = setting(1.0, "the unit of mesh files [m], > 0")
    geoms: Literal["auto", "collision", "visual", "all"] = setting(
        "auto", "auto (those that can collide, or all if none can), collision, visual, all"
    )
    # The tags let pydantic check one branch of the union, so that an error speaks of that one only.
    meshes: Annotated[
        Annotated[
            MeshMode, expects("auto, hull, surface, shell or {pattern: one of these}"), Tag("=one")
        ]
        | Annotated[dict[Name, MeshMode], Tag("=each")],
        Discriminator(lambda value: "=each" if isinstance(value, dict) else "=one"),
    ] = setting("auto", "hull, surface, shell (never solid), auto, or {name pattern: hull}")
    ground: Annotated[float | None, expects("a height in metres, or null")] = setting(
        None, "height of endless ground that is added [m], or null"
    )
    exclude: Section[ExcludeSettings] = section(
        ExcludeSettings, "what is left out, by pattern (*, ?, [...])"
    )
    keyframe: Annotated[
        str | Annotated[int, Field(ge=0)] | None, expects("a keyframe's name or index, or null")
    ] = setting(None, "pose: a keyframe's name, or index >= 0, or null")
    joints: dict[Name, Annotated[float | list[float], expects("a number or a list of numbers")]] = (
        setting({}, "pose, after the keyframe: {joint name: position [m or rad], or a list}")
    )

    @model_validator(mode="before")
    @classmethod
    def _take_id_from_path(cls, data: Any) -> Any:
        if isinstance(data, Mapping) and data.get("id") is None:
            path = data.get("path")
            stem = stem_of(path) if isinstance(path, str | PathLike) else ""
            return {**data, "id": stem or "scene"}
        return data
