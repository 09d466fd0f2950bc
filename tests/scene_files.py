"""Scene files that several tests write."""

from pathlib import Path

import collada
import numpy as np
import trimesh
from collada.scene import GeometryNode, MatrixTransform, Node, Scene

import navbake

# asymmetric, so that a turn or a mirror shows
WEDGE = trimesh.Trimesh(
    vertices=[[0, 0, 0], [3, 0, 0], [0, 2, 0], [0, 0, 1]],
    faces=[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
)


def write_dae(path, mesh, unit=1.0, up=None, matrices=None):
    """Write a DAE of one geometry and a node for each matrix."""
    document = collada.Collada()
    document.assetInfo.unitname, document.assetInfo.unitmeter = "unit", unit
    document.assetInfo.upaxis = up or collada.asset.UP_AXIS.Z_UP
    source = collada.source.FloatSource("v", mesh.vertices.ravel(), ("X", "Y", "Z"))
    geometry = collada.geometry.Geometry(document, "wedge", "wedge", [source])
    inputs = collada.source.InputList()
    inputs.addInput(0, "VERTEX", "#v")
    geometry.primitives.append(geometry.createTriangleSet(mesh.faces.ravel(), inputs, "m"))
    document.geometries.append(geometry)
    nodes = [
        Node(f"n{i}", [GeometryNode(geometry)], [MatrixTransform(matrix.ravel())])
        for i, matrix in enumerate([np.eye(4)] if matrices is None else matrices)
    ]
    document.scenes.append(Scene("s", nodes))
    document.scene = document.scenes[0]
    document.write(str(path))
    return path


def leads_through(scene: Path) -> None:
    """Assert that a scene's one door, at the origin, frees its doorway when it is open."""
    for state in ("closed", "open"):
        grid = navbake.bake(scene, doors={"state": state, "patterns": ["*[dD]oor"]})
        path = navbake.PathFinder(grid).find_path((-2.0, 0.0), (2.0, 0.0))
        assert (path is not None) == (state == "open"), state
