"""The frames of SDF files: `Scope` resolves the names of frames in a world or a model to poses.

Source: SDFormat specification 1.12, sdformat.org, its chapter on the semantics of poses.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from navbake.errors import SceneError
from navbake.types import Float

WORLD_NAMES = ("world", "__root__")  # names of the world's frame
Element = ElementTree.Element


class FrameInScope(NamedTuple):
    """A frame, and the scope that it belongs to.

    Attributes:
        scope: the world or model that the frame belongs to.
        name: the frame's name in that scope; empty for the scope's own frame.
    """

    scope: Scope
    name: str


class Scope:
    """A world or a model: its named frames, and their poses.

    Poses are computed when they are first read, because an element may refer to a later one.

    Args:
        find_models: a function that returns the models directly in a world or model, in order.
        element: the ``<world>`` or ``<model>``.
        placement: the element with the scope's name and pose: the ``<include>`` of an included
            model, else `element`.
        file: the file that contains the element.
        parent: the world or model that contains this one; None for a world.

    Attributes:
        element: the ``<world>`` or ``<model>``.
        file: the file that contains the element.
        parent: the world or model that contains this one; None for a world.
        name: the full name, which begins with the names of the enclosing models, such as
            ``house::door``; empty for a world.
        local_name: the name alone, such as ``door``; empty for a world.
        depth: how many models and worlds contain this one.
        is_static: whether the model, or an enclosing one, is static.
        is_merged: whether the model is merged into the enclosing one, by ``<include
            merge="true">``.
    """

    def __init__(
        self,
        find_models: FindModels,
        element: Element,
        placement: Element,
        file: Path,
        parent: Scope | None,
    ) -> None:
        self.element = element
        self.file = file
        self.parent = parent
        self.name = ""
        self.local_name = ""
        self.depth = 0
        self.is_static = False
        self.is_merged = False
        self._find_models = find_models
        self._placement = placement
        self._frames = {
            str(child.get("name")): child
            for child in element
            if child.tag in ("link", "joint", "frame") and child.get("name")
        }
        self._poses: dict[str, Float] = {} if parent is not None else {"": np.eye(4)}
        self._pending: list[str] = []  # frames whose poses are being computed
        if parent is None:
            return
        # Where an <include> states a name, a pose or <static>, that counts instead of the model's.
        self.local_name = str(element.get("name", "model"))
        if placement is not element:
            self.local_name = find_text(placement, "name") or self.local_name
            self.is_merged = parent.parent is not None and is_true(placement.get("merge", ""))
        self.name = f"{parent.name}::{self.local_name}" if parent.name else self.local_name
        self.depth = parent.depth + 1
        self.is_static = parent.is_static
        if self.is_merged:
            self.name = parent.name
            return
        for stating_element in (placement, element):
            if stating_element.find("static") is not None:
                self.is_static |= is_true(find_text(stating_element, "static"))
                break

    @cached_property
    def models(self) -> list[Scope]:
        """The scopes of the models directly in this scope, with included ones."""
        return self._find_models(self)

    @cached_property
    def _named_models(self) -> dict[str, Scope]:
        """Local name -> scope, of the models directly in this scope that are not merged into it."""
        return {model.local_name: model for model in self.models if not model.is_merged}

    def make_full_name(self, name: str) -> str:
        """Return the full name of something in this scope, such as ``house::door::leaf``.

        Args:
            name: its name in this scope, such as ``leaf``.
        """
        return f"{self.name}::{name}" if self.name else name

    def get_frame_element(self, name: str) -> Element:
        """Return the ``<link>``, ``<joint>`` or ``<frame>`` with a name in this scope."""
        return self._frames[name]

    def resolve(self, name: str) -> FrameInScope:
        """Find the scope that a frame belongs to, and the frame's name there.

        Args:
            name: the frame's name as elements of this scope write it, such as ``door::leaf``.

        Raises:
            SceneError: there is no such frame.
        """
        first_name, _, inner_name = name.partition("::")
        if first_name == "__parent__" and self.parent is not None:
            return self.parent.resolve(inner_name)
        frame = self._find_frame("" if name == "__model__" else name)
        if frame is not None:
            return frame
        if self.is_merged and self.parent is not None:
            return self.parent.resolve(name)
        names = ", ".join(sorted({*self._frames, *self._named_models})[:20]) or "none"
        raise SceneError(f"no frame {name!r} {self._where}: it has {names}")

    def _find_frame(self, name: str) -> FrameInScope | None:
        """Search for a frame like `resolve`, but not in enclosing scopes; None if there is none."""
        if not name or name in self._frames:
            return FrameInScope(self, name)
        first_name, _, inner_name = name.partition("::")
        if first_name in self._named_models:
            return self._named_models[first_name].resolve(inner_name)
        for model in self.models:
            if model.is_merged:
                frame = model._find_frame(name)
                if frame is not None:
                    return frame
        return None

    def find_canonical_link(self) -> str:
        """Return the name of the model's canonical link; empty if the model has no link.

        It is the link that the model states as canonical, or else the model's first link.
        """
        if self.is_merged and self.parent is not None:
            return self.parent.find_canonical_link()
        return self.element.get("canonical_link") or self._first_link()

    def _first_link(self) -> str:
        link = self.element.find("link")
        if link is not None:
            return str(link.get("name"))
        for model in self.models:
            first_link = model._first_link()
            if first_link:
                return first_link if model.is_merged else f"{model.local_name}::{first_link}"
        return ""

    def find_pose(self, name: str) -> Float:
        """Return the pose of a frame in the world, (4, 4) [m].

        Args:
            name: the frame's name as elements of this scope write it; empty for the scope's frame.

        Raises:
            SceneError: there is no such frame, or it is relative to itself.
        """
        if name in WORLD_NAMES:
            return np.eye(4)
        frame = self.resolve(name)
        if frame.scope is not self:
            return frame.scope.find_pose(frame.name)
        name = frame.name
        if name not in self._poses:
            if name in self._pending:
                problem_text = f"is relative to itself, by {self._pending}"
                raise SceneError(f"frame {name!r} {self._where} {problem_text}")
            self._pending.append(name)
            self._poses[name] = self._compute_pose(name)
            self._pending.pop()
        return self._poses[name]

    def _compute_pose(self, name: str) -> Float:
        if name:
            frame = self._frames[name]
            is_joint = frame.tag == "joint"
            base_frame = find_text(frame, "child") if is_joint else frame.get("attached_to", "")
            return self.find_pose_of_element(frame, base_frame)
        assert self.parent is not None
        is_placed = self._placement.find("pose") is not None
        pose = self.parent.find_pose_of_element(self._placement if is_placed else self.element)
        placement_frame = find_text(self._placement, "placement_frame")
        placement_frame = placement_frame or self.element.get("placement_frame", "")
        if placement_frame:  # the stated pose is that of this frame, not of the model's
            # A copy of the model at the origin gives the anchor's pose in the model's frame.
            model_at_origin = Scope(
                self._find_models, self.element, self._placement, self.file, self.parent
            )
            model_at_origin._poses[""] = np.eye(4)
            pose = pose @ np.linalg.inv(model_at_origin.find_pose(placement_frame))
        return pose

    @property
    def _where(self) -> str:
        return f"of {self.name or 'the world'} in {self.file}"

    def find_pose_of_element(self, element: Element, base_frame: str = "") -> Float:
        """Return the pose of an element in the world, by its ``<pose>``, (4, 4) [m].

        Args:
            element: the element.
            base_frame: name of the frame that the ``<pose>`` is relative to if it has no
                ``relative_to``.
        """
        pose = element.find("pose")
        if pose is not None:
            base_frame = pose.get("relative_to", "") or base_frame
        return self.find_pose(base_frame) @ read_pose(pose, self.file)


def is_true(text: str) -> bool:
    """Return whether a text is SDF's ``1`` or ``true``."""
    return text.strip().lower() in ("1", "true")


def find_text(element: Element, path: str) -> str:
    """Return the stripped text of a descendant of an element; empty if there is none.

    Args:
        element: the element.
        path: the path from the element to the descendant, in ElementTree's syntax.
    """
    return (element.findtext(path) or "").strip()


def parse_numbers(text: str, num_numbers: int, place_text: str) -> list[float]:
    """Parse numbers that are separated by spaces.

    Args:
        text: the numbers.
        num_numbers: how many numbers there have to be.
        place_text: the place in the file, for errors.

    Raises:
        SceneError: the text has not exactly `num_numbers` finite numbers.
    """
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        numbers = []
    if len(numbers) != num_numbers or not np.isfinite(numbers).all():
        expected_text = "a number" if num_numbers == 1 else f"{num_numbers} numbers"
        raise SceneError(f"expected {expected_text} at {place_text}, got {text[:80]!r}")
    return numbers


def read_pose(element: Element | None, file: Path) -> Float:
    """Read a ``<pose>``: x, y, z, and roll, pitch, yaw or a quaternion x, y, z, w.

    Args:
        element: the ``<pose>``; None for none.
        file: its file, for errors.

    Returns:
        The pose, (4, 4) [m]; the identity if the element is None or empty.

    Raises:
        SceneError: the element does not contain six finite numbers, or seven for a quaternion.
    """
    pose = np.eye(4)
    text = "" if element is None else (element.text or "").strip()
    if element is None or not text:
        return pose
    is_quaternion = element.get("rotation_format", "euler_rpy") == "quat_xyzw"
    numbers = parse_numbers(text, 7 if is_quaternion else 6, f"<pose> of {file}")
    pose[:3, 3] = numbers[:3]
    if is_quaternion:
        x, y, z, w = numbers[3:]
        rotation = np.empty(9)
        quaternion = np.array([w, x, y, z]) / (math.hypot(w, x, y, z) or 1.0)
        mujoco.mju_quat2Mat(rotation, quaternion)
        pose[:3, :3] = rotation.reshape(3, 3)
        return pose
    angles = np.radians(numbers[3:]) if is_true(element.get("degrees", "")) else numbers[3:]
    # cosines and sines of roll, pitch and yaw
    cos_roll, cos_pitch, cos_yaw = np.cos(angles).tolist()
    sin_roll, sin_pitch, sin_yaw = np.sin(angles).tolist()
    pose[:3, :3] = [
        [
            cos_yaw * cos_pitch,
            cos_yaw * sin_pitch * sin_roll - sin_yaw * cos_roll,
            cos_yaw * sin_pitch * cos_roll + sin_yaw * sin_roll,
        ],
        [
            sin_yaw * cos_pitch,
            sin_yaw * sin_pitch * sin_roll + cos_yaw * cos_roll,
            sin_yaw * sin_pitch * cos_roll - cos_yaw * sin_roll,
        ],
        [-sin_pitch, cos_pitch * sin_roll, cos_pitch * cos_roll],
    ]
    return pose


FindModels = Callable[[Scope], list[Scope]]
"""A function that returns the models directly in a world or a model, in order."""
