"""Links that the scene contradicts are found: what is in their way, and what they land on."""

from __future__ import annotations

import copy

import mujoco
import pytest

import navbake
from navbake.verifier import report as kinds
from project_paths import CONFIGS


@pytest.fixture(scope="module")
def tower():
    return navbake.bake(str(CONFIGS / "tower.yaml"))


def findings(grid, xml):
    """What a verification says of links, in the tower with more geoms."""
    model = mujoco.MjModel.from_xml_string(xml)
    report = navbake.verify(grid, model, sample=1, force=True)
    links = (kinds.LINK_TOUCHES, kinds.NO_LANDING)
    return [found for found in report.findings if found.kind in links]


def with_box(x, y, z, size):
    text = (CONFIGS / "scenes" / "tower.xml").read_text()
    more = f'<geom name="planted" type="box" pos="{x} {y} {z}" size="{size}"/>'
    return text.replace("</worldbody>", f"{more}</worldbody>")


def test_the_tower_holds_its_links(tower):
    assert findings(tower, (CONFIGS / "scenes" / "tower.xml").read_text()) == []


@pytest.mark.parametrize(
    ("planted", "text"),
    [
        ((6.2, -1.2, 1.7, "0.1 0.3 0.05"), "drop 'drop 1' runs into 'planted'"),  # headroom
        ((6.3, -1.2, -0.4, "0.1 0.3 0.05"), "drop 'drop 1' runs into 'planted'"),  # the landing
        ((1.0, 3.6, 5.0, "0.3 0.05 0.01"), "car of lift 'lift_a' runs into 'planted', moved"),
        ((4.1, 3.0, 1.5, "0.2 0.2 0.005"), None),  # within the car, which leaves it below
    ],
)
def test_what_stands_in_the_way_is_named(tower, planted, text):
    found = findings(tower, with_box(*planted))
    if text is None:
        assert {f.text.split(" runs")[0] for f in found} == {"the car of lift 'lift_b'"}
    else:
        (one,) = found
        assert one.kind == kinds.LINK_TOUCHES and text in one.text and one.geom == "planted"


def test_a_lift_is_found_by_the_name_of_its_body_or_not_checked(tower):
    xml = with_box(1.0, 3.6, 5.0, "0.3 0.05 0.01")
    for name, is_found in (("lift_a#2", True), ("other", False)):
        grid, metadata = copy.copy(tower), copy.deepcopy(tower.metadata)
        grid.metadata = metadata
        entries = metadata["navbake"]["links"]
        (own,) = [e for e in entries if isinstance(e, dict) and e["name"] == "lift_a"]
        own["name"] = name
        model = mujoco.MjModel.from_xml_string(xml)
        report = navbake.verify(grid, model, sample=1, force=True)
        assert any(repr(name) in found.text for found in report.findings) == is_found
        note = f"lift {name!r} was not checked: no body of its name slides"
        assert (note in report.notes) != is_found


def test_a_landing_without_floor_is_named(tower):
    wrong = copy.deepcopy(tower)
    level, row, col = tower.cell_at((6.3, -1.2, -0.9))  # where it lands
    wrong.levels[level].attributes["floorHeight"][row, col] -= 0.1
    (found,) = findings(wrong, (CONFIGS / "scenes" / "tower.xml").read_text())
    assert found.kind == kinds.NO_LANDING and "lands at -1.000 m" in found.text
