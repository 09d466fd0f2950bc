"""The recipe for IFC in docs/scenes.md, on a building of two rooms with a door between them."""

from __future__ import annotations

import re
from importlib import import_module

import numpy as np
import pytest

import navbake
from navbake.config.settings import load_config
from project_paths import ROOT

pytest.importorskip("shapely", reason="shapely is not installed")
pytest.importorskip("ifcopenshell", reason="ifcopenshell is not installed")
NAMES = "aggregate context feature geometry project root spatial unit".split()  # noqa: SIM905
aggregate, context, feature, geometry, project, root, spatial, unit = (
    import_module(f"ifcopenshell.api.{name}") for name in NAMES
)


# class, name: lower corner and size [m]; the door stands in the opening of the wall in the middle
BOXES = {
    ("IfcSlab", "Slab"): ((0, 0, -0.2), (6, 4, 0.2)),
    ("IfcWall", "South"): ((0, 0, 0), (6, 0.2, 2.6)),
    ("IfcWall", "North"): ((0, 3.8, 0), (6, 0.2, 2.6)),
    ("IfcWall", "West"): ((0, 0.2, 0), (0.2, 3.6, 2.6)),
    ("IfcWall", "East"): ((5.8, 0.2, 0), (0.2, 3.6, 2.6)),
    ("IfcWall", "Middle"): ((2.9, 0.2, 0), (0.2, 3.6, 2.6)),
    ("IfcOpeningElement", "Gap"): ((2.8, 1.5, 0), (0.4, 0.9, 2.1)),
    ("IfcDoor", "Door 1"): ((2.97, 1.5, 0.01), (0.06, 0.9, 2.08)),
    ("IfcFurniture", "Table"): ((0.6, 0.6, 0), (1.2, 0.8, 0.74)),
    ("IfcSpace", "Kitchen"): ((0.2, 0.2, 0), (2.7, 3.6, 2.6)),
    ("IfcSpace", "Hall"): ((3.1, 0.2, 0), (2.7, 3.6, 2.6)),
}


def write_building(path):
    """Write the boxes as an IFC file in millimetres."""
    file = project.create_file()
    root.create_entity(file, ifc_class="IfcProject")
    unit.assign_unit(file)
    model = context.add_context(file, context_type="Model")
    body = context.add_context(file, context_type="Model", context_identifier="Body",
                               target_view="MODEL_VIEW", parent=model)  # fmt: skip
    above = file.by_type("IfcProject")[0]
    for kind in ("IfcSite", "IfcBuilding", "IfcBuildingStorey"):
        inner = root.create_entity(file, ifc_class=kind, name=kind)
        aggregate.assign_object(file, relating_object=above, products=[inner])
        above = inner
    made = {}
    faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
    for (kind, name), (corner, (a, b, c)) in BOXES.items():
        item = made[name] = root.create_entity(file, ifc_class=kind, name=name)
        place = np.eye(4)
        place[:3, 3] = corner
        geometry.edit_object_placement(file, product=item, matrix=place)
        points = [(x * a, y * b, z * c) for z in (0, 1) for y in (0, 1) for x in (0, 1)]
        shape = geometry.add_mesh_representation(
            file, context=body, vertices=[points], faces=[faces]
        )
        geometry.assign_representation(file, product=item, representation=shape)
        if kind == "IfcSpace":
            aggregate.assign_object(file, relating_object=above, products=[item])
        elif kind != "IfcOpeningElement":
            spatial.assign_container(file, relating_structure=above, products=[item])
    feature.add_feature(file, feature=made["Gap"], element=made["Middle"])
    feature.add_filling(file, opening=made["Gap"], element=made["Door 1"])
    file.write(str(path))


def test_recipe(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_building(tmp_path / "house.ifc")
    text = (ROOT / "docs" / "scenes.md").read_text()
    (recipe,) = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    settings = re.findall(r"^```yaml\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)[-1]
    names: dict = {}
    exec(recipe, names)
    names["convert_ifc"]("house.ifc", "house.obj", "rooms.geojson")
    (tmp_path / "house.yaml").write_text(settings)
    config = load_config("house.yaml", ["rooms.polygons=rooms.geojson"])
    grid = navbake.bake(config)
    (level,) = grid.levels
    rooms = {room["name"]: room["area"] for room in grid.metadata["navbake"]["rooms"]}
    assert rooms == pytest.approx({"Kitchen": 2.7 * 3.6, "Hall": 2.7 * 3.6}, abs=0.6)
    assert [door["id"] for door in grid.metadata["navbake"]["doors"]] == ["IfcDoor_Door_1"]
    # through the middle wall by its door, about
    assert 2.8 < grid.find_path((2.0, 3.0, 0.0), (4.0, 1.0, 0.0)).length < 4.0
    objects = {name for data in level.user_data.values() for name in data.get("objects", [])}
    assert "IfcFurniture_Table" in objects
