"""Links of the settings are put on cells; what has no place is named."""

from __future__ import annotations

import json
import warnings

import mujoco
import numpy as np
import pytest

import navbake
from box_worlds import box, world
from navbake.errors import BakeWarning, ConfigError

SLAB = (
    box("ground floor", 0.02, 0.02, -0.2, 5.98, 3.98, 0)
    + box("mezzanine", 3.02, 0.02, 2.8, 5.98, 3.98, 3.0)
    + box("cupboard", 0.6, 2.52, 0, 2.4, 3.96, 1.9)
)
STOPS = [[1.03, 1.03, 0.0], [4.03, 1.03, 3.0]]


def bake(**settings):
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "no step leads")
        model = mujoco.MjModel.from_xml_string(world(SLAB))
        return navbake.bake(model, floors={"roofs": True}, **settings)


def test_fields_are_kept_and_stops_lie_on_their_cells(tmp_path):
    link = {"name": "A", "kind": "hoist", "stops": STOPS, "width": 0.8, "cost": 3, "seconds": 9}
    link |= {"agents": ["robot"], "one_way": True, "state": "closed"}
    grid = bake(links=[link], agents={"robot": {"radius": 0.3, "speed": 0.5}})
    grid.save(tmp_path / "a.grid.json")
    (found,) = navbake.load(tmp_path / "a.grid.json").links
    own = {key: getattr(found, key) for key in link if key != "stops"}
    assert {**own, "agents": list(own["agents"])} == {k: v for k, v in link.items() if k != "stops"}
    for stop, position in zip(found.stops, STOPS, strict=True):
        assert stop.position == tuple(position)
        cell = grid.cell_at(position, stop.level)
        assert stop.cell == cell.col + cell.row * grid.levels[stop.level].width
    assert grid.agents["robot"].speed == 0.5 and not found.auto


def test_a_stop_goes_to_the_nearest_free_cell():
    x = 2.2  # in the cupboard, 0.2 m from its side
    grid = bake(links=[{"name": "A", "stops": [[x, 3.0, 0.2], STOPS[1]]}])
    stop = grid.links[0].stops[0]
    row, col = divmod(stop.cell, grid.levels[0].width)
    at = grid.levels[0].lattice.positions(row, col)
    assert grid.levels[0].free[row, col] and stop.position == (x, 3.0, 0.2)
    off = np.linalg.norm(
        grid.levels[0].lattice.positions(*np.nonzero(grid.levels[0].free)) - [x, 3.0], axis=1
    )
    assert np.linalg.norm(at - [x, 3.0]) == pytest.approx(off.min())


@pytest.mark.parametrize(
    ("stop", "text"),
    [
        ([1.5, 3.3, 0.0], "is blocked: nothing is free within 0.5 m"),
        ([9.0, 1.0, 0.0], "lies outside of the grid"),
        ([1.0, 1.0, 1.2], "is 1.20 m off the nearest floor"),
    ],
)
def test_a_stop_without_a_place_is_named(stop, text):
    three = [{"name": "A", "kind": "lift", "stops": [*STOPS, stop]}]
    place = "({:.2f}, {:.2f}, {:.2f})".format(*stop).replace("(", r"\(").replace(")", r"\)")
    with pytest.warns(BakeWarning, match=f"link 'A': stop 3, {place}, {text}; it has 2 stops left"):
        assert len(bake(links=three).links[0].stops) == 2
    with pytest.warns(BakeWarning, match=f"link 'A': stop 2, {place}, {text}; it is left out"):
        assert bake(links=[{"name": "A", "stops": [STOPS[0], stop]}]).links == ()


def test_a_stop_on_the_cell_of_another_is_named():
    stops = [STOPS[0], [1.04, 1.04, 0.0], STOPS[1]]
    text = "stop 2, .1.04, 1.04, 0.00., is on the cell of another stop; it has 2 stops left"
    with pytest.warns(BakeWarning, match=text):
        (link,) = bake(links=[{"name": "A", "stops": stops}]).links
    assert [stop.level for stop in link.stops] == [0, 1]
    with pytest.warns(BakeWarning, match="is on the cell of another stop; it is left out"):
        assert bake(links=[{"name": "A", "stops": stops[:2]}]).links == ()


def test_properties_that_are_no_object_are_named(tmp_path):
    feature = {"type": "Feature", "properties": 5, "geometry": None}
    (tmp_path / "a.geojson").write_text(json.dumps(feature))
    for section in ("links", "areas"):
        with pytest.raises(ConfigError, match="object at `properties`, got 5 in feature 0 of"):
            bake(**{section: str(tmp_path / "a.geojson")})


def test_files_say_the_same(tmp_path):
    link = {"name": "A", "kind": "lift", "seconds": 12}
    line = {"type": "LineString", "coordinates": STOPS}
    feature = {"type": "Feature", "properties": link, "geometry": line}
    ring = [[1, 1], [2, 1], [2, 2], [1, 1]]
    zone = {"type": "Polygon", "coordinates": [ring]}
    area = {"type": "Feature", "properties": {"name": "z", "cost": "inf"}, "geometry": zone}
    for name, content in (
        ("links.geojson", {"type": "FeatureCollection", "features": [feature]}),
        ("links.json", [{**link, "stops": STOPS}]),
        ("areas.geojson", {"type": "FeatureCollection", "features": [area]}),
    ):
        (tmp_path / name).write_text(json.dumps(content))
    plain = bake(
        links=[{**link, "stops": STOPS}],
        areas=[{"name": "z", "cost": float("inf"), "polygon": ring[:3]}],
    )
    for links in ("links.geojson", "links.json"):
        grid = bake(links=tmp_path / links, areas=str(tmp_path / "areas.geojson"))
        assert grid.navbake == plain.navbake
        assert np.array_equal(grid.levels[0].area_index, plain.levels[0].area_index)


def test_grids_without_them_state_nothing():
    grid = bake()
    assert not {"areas", "agents"} & grid.navbake.keys() and grid.links == ()
    assert all("area" not in level.attributes for level in grid.levels)
