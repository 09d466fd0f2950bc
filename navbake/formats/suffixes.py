"""Endings of voxel files. This module imports nothing, so that the command line starts quickly."""

OCTREES = (".bt", ".ot")
"""OctoMap's files, whose voxels lie on whole multiples of their edge."""
VOXELS = (".binvox", *OCTREES, ".npz")
