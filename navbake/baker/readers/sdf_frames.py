"""The frames of SDF files: worlds and models as scopes of names, and the poses of what is in them.

Source: SDFormat specification 1.12, sdformat.org, its chapter on the semantics of poses.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from functools import cached_property
from pathlib import Path

import mujoco
import numpy as np

from navbake.errors import SceneError
from navbake.types import Float

WORLD = "world", "__root__"  # the names of the world's own frame
Element = ElementTree.Element


class Scope:
    """A world or a model: the frames that have a name in it, and where they are.

    Poses are found when they are needed, so that an element may name a later one.

    Attributes:
        name: with those of the models round it, as ``house::door``; empty for a world.
        own: the same without them.
        file: in which it stands.
        is_merged: whether it is part of the model round it, by ``<include merge="true">``.
    """

    def __init__(
        self, find: FindModels, element: Element, placing: Element, file: Path, above: Scope | None
    ) -> None:
        self._find_models = find
        self.element = element
        self._placing = placing
        self.file = file
        self.above = above
        self._frames = {
            str(each.get("name")): each
            for each in element
            if each.tag in ("link", "joint", "frame") and each.get("name")
        }
        self._poses: dict[str, Float] = {} if above is not None else {"": np.eye(4)}
        self._open: list[str] = []
        self.name = self.own = ""
        self.depth = 0
        self.is_static = False
        self.is_merged = False
        if above is None:
            return
        # a model's name, pose and static are those of an include, where it has them
        self.own = str(element.get("name", "model"))
        if placing is not element:
            self.own = text_of(placing, "name") or self.own
            self.is_merged = above.above is not None and is_true(placing.get("merge", ""))
        self.name = f"{above.name}::{self.own}" if above.name else self.own
        self.depth = above.depth + 1
        self.is_static = above.is_static
        if self.is_merged:
            self.name = above.name
            return
        stated = [each for each in (placing, element) if each.find("static") is not None]
        self.is_static |= bool(stated) and is_true(text_of(stated[0], "static"))

    @cached_property
    def models(self) -> list[Scope]:
        """The models in it, those of includes too."""
        return self._find_models(self)

    @cached_property
    def inner(self) -> dict[str, Scope]:
        """The models in it that go by their own name."""
        return {model.own: model for model in self.models if not model.is_merged}

    def full(self, name: str) -> str:
        """A name with those of the models round it."""
        return f"{self.name}::{name}" if self.name else name

    def frame(self, name: str) -> Element:
        """A frame of the scope's own."""
        return self._frames[name]

    def resolve(self, name: str) -> tuple[Scope, str]:
        """The scope that a frame stands in, and its name there; empty is the scope's own frame."""
        first, _, rest = name.partition("::")
        if first == "__parent__" and self.above is not None:
            return self.above.resolve(rest)
        if (found := self._find("" if name == "__model__" else name)) is not None:
            return found
        if self.is_merged and self.above is not None:
            return self.above.resolve(name)
        known = ", ".join(sorted({*self._frames, *self.inner})[:20]) or "none"
        raise SceneError(f"no frame {name!r} {self._where}: it has {known}")

    def _find(self, name: str) -> tuple[Scope, str] | None:
        """The same, in this scope and in the models that are merged with it or in it."""
        if not name or name in self._frames:
            return self, name
        first, _, rest = name.partition("::")
        if first in self.inner:
            return self.inner[first].resolve(rest)
        merged = (model._find(name) for model in self.models if model.is_merged)
        return next((found for found in merged if found is not None), None)

    def canonical(self) -> str:
        """The link that stands for the model, which it names, or the first; empty for none."""
        if self.is_merged and self.above is not None:
            return self.above.canonical()
        return self.element.get("canonical_link") or self._first_link()

    def _first_link(self) -> str:
        if (link := self.element.find("link")) is not None:
            return str(link.get("name"))
        for model in self.models:
            if first := model._first_link():
                return first if model.is_merged else f"{model.own}::{first}"
        return ""

    def pose_of(self, name: str) -> Float:
        """Where a frame is, (4, 4); empty is the scope's own."""
        if name in WORLD:
            return np.eye(4)
        scope, name = self.resolve(name)
        if scope is not self:
            return scope.pose_of(name)
        if name not in self._poses:
            if name in self._open:
                by = f"is relative to itself, by {self._open}"
                raise SceneError(f"frame {name!r} {self._where} {by}")
            self._open.append(name)
            self._poses[name] = self._find_pose(name)
            self._open.pop()
        return self._poses[name]

    def _find_pose(self, name: str) -> Float:
        if name:
            frame = self._frames[name]
            is_joint = frame.tag == "joint"
            to = text_of(frame, "child") if is_joint else frame.get("attached_to", "")
            return self.place(frame, to)
        assert self.above is not None
        is_placed = self._placing.find("pose") is not None
        place = self.above.place(self._placing if is_placed else self.element)
        anchor = text_of(self._placing, "placement_frame")
        anchor = anchor or self.element.get("placement_frame", "")
        if anchor:  # which is to be where the pose says
            alone = Scope(self._find_models, self.element, self._placing, self.file, self.above)
            alone._poses[""] = np.eye(4)
            place = place @ np.linalg.inv(alone.pose_of(anchor))
        return place

    @property
    def _where(self) -> str:
        return f"of {self.name or 'the world'} in {self.file}"

    def place(self, element: Element, default: str = "") -> Float:
        """Where an element with a ``<pose>`` is, (4, 4), relative to `default` or as it says."""
        pose = element.find("pose")
        relative = default if pose is None else pose.get("relative_to", "") or default
        return self.pose_of(relative) @ read_pose(pose, self.file)


def is_true(text: str) -> bool:
    return text.strip().lower() in ("1", "true")


def text_of(element: Element, path: str) -> str:
    return (element.findtext(path) or "").strip()


def numbers_of(text: str, count: int, where: str) -> list[float]:
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not np.isfinite(numbers).all():
        expected = "a number" if count == 1 else f"{count} numbers"
        raise SceneError(f"expected {expected} at {where}, got {text[:80]!r}")
    return numbers


def read_pose(pose: Element | None, file: Path) -> Float:
    """A ``<pose>``, (4, 4): x, y, z, and roll, pitch, yaw or a quaternion x, y, z, w."""
    place = np.eye(4)
    text = "" if pose is None else (pose.text or "").strip()
    if pose is None or not text:
        return place
    is_quat = pose.get("rotation_format", "euler_rpy") == "quat_xyzw"
    numbers = numbers_of(text, 7 if is_quat else 6, f"<pose> of {file}")
    place[:3, 3] = numbers[:3]
    if is_quat:
        x, y, z, w = numbers[3:]
        turn = np.empty(9)
        quat = np.array([w, x, y, z]) / (math.hypot(w, x, y, z) or 1.0)
        mujoco.mju_quat2Mat(turn, quat)
        place[:3, :3] = turn.reshape(3, 3)
        return place
    angles = np.radians(numbers[3:]) if is_true(pose.get("degrees", "")) else numbers[3:]
    cr, cp, cy = np.cos(angles).tolist()
    sr, sp, sy = np.sin(angles).tolist()
    place[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    return place


FindModels = Callable[[Scope], list[Scope]]
"""Returns the models in a world or a model, in order."""
