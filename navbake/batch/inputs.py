"""The files that a scene is made of."""

from navbake.formats.scene_files import find_inputs

__all__ = ["find_inputs"]
