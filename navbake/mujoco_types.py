"""Types of arguments that are MuJoCo's objects, for editors and type checkers.

MuJoCo comes without types: to a type checker, an argument of the type ``mujoco.MjModel`` may be
anything. These protocols name what tells each class from other things.
"""

from __future__ import annotations

from typing import Protocol

from navbake.types import Float


class MjModelLike(Protocol):
    """A mujoco.MjModel."""

    @property
    def ngeom(self) -> int:
        """Number of geoms."""
        ...

    @property
    def nbody(self) -> int:
        """Number of bodies."""
        ...


class MjSpecLike(Protocol):
    """A mujoco.MjSpec."""

    @property
    def worldbody(self) -> object:
        """The body that all others descend from."""
        ...

    def compile(self) -> object:
        """Compile the spec to a model."""
        ...


class MjDataLike(Protocol):
    """A mujoco.MjData."""

    @property
    def qpos(self) -> Float:
        """Positions of the joints, shape (nq,)."""
        ...

    @property
    def mocap_pos(self) -> Float:
        """World positions of the mocap bodies [m], shape (nmocap, 3)."""
        ...

    @property
    def mocap_quat(self) -> Float:
        """Rotations of the mocap bodies, w, x, y, z, shape (nmocap, 4)."""
        ...

    @property
    def geom_xpos(self) -> Float:
        """World positions of the geoms [m], shape (ngeom, 3)."""
        ...

    @property
    def geom_xmat(self) -> Float:
        """World rotations of the geoms, row by row, shape (ngeom, 9)."""
        ...


class MjvSceneLike(Protocol):
    """A mujoco.MjvScene."""

    @property
    def ngeom(self) -> int:
        """Number of geoms in the scene."""
        ...

    @property
    def maxgeom(self) -> int:
        """Number of geoms that the scene has space for."""
        ...
