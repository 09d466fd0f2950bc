"""What commands refuse: the exit status, one line that names the culprit, and nothing written."""

from __future__ import annotations

import shlex
import shutil

import numpy as np
import pytest

import navbake
from cli_scenes import P1, P2, write_arena, write_room
from project_paths import GOLDEN

PATH = "path house.json.gz --from 0,-4.8,L0"
HERE = "path house.json.gz --to 0,-4.8,L0"

# command line, exit status, what the message names
CASES = [
    # what is no option, no value or no command
    ("bake", 2, "CONFIG"),
    ("bake room.yaml --threads 0", 2, "--threads"),
    ("bake room.yaml --set novalue", 2, "expected KEY=VALUE, got 'novalue'"),
    ("bake room.yaml --nonsense", 2, "--nonsense"),
    ("nonsense", 2, "nonsense"),
    # first guesses
    ("export a.grid.json a.yaml", 2, "No such command 'export': write `navbake convert"),
    ("extrude map.yaml -o a.xml", 2, "write `navbake convert MAP scene.xml`"),
    ("bake x.grid.json", 1, "x.grid.json is a grid, not a scene: `navbake info x.grid.json`"),
    ("geoms x.json.gz", 1, "x.json.gz is a grid, not a scene"),
    ("init x.grid.json", 1, "is a grid, not a scene"),
    ("voxelize x.grid.json -o a.npz", 1, "is a grid, not a scene"),
    ("why house.json.gz", 2, "expected one place, X,Y[,Z|,LEVEL], got none"),
    ("why house.json.gz 1,1 --at 1,2", 2, "got '1,2' and '1,1'"),
    ("why house.json.gz --at 1.5 0.2", 2, "got '1.5' and '0.2'"),
    ("inflate house.json.gz -o a.json", 2, "expected one radius"),
    ("audit a.geojson", 2, "GRID: a.geojson is a graph of routes: add --grid GRID"),
    ("bake romo.yaml", 1, "no such file: romo.yaml: did you mean room.yaml?"),
    ("bake romo.xml", 1, "no scene file at romo.xml: did you mean room.xml?"),
    ("init romo.xml", 1, "no such file: romo.xml: did you mean room.xml?"),
    ("batch romo.xml -o out", 1, "there is no such file: did you mean room.xml?"),
    ("batch apartment -o out", 1, "such file: the settings of the sample are "),
    ("bake houze", 1, "no scene file at houze: did you mean the sample 'house'?"),
    ("score runs.jsonl set.jsonl", 1, "runs.jsonl has trajectories, not episodes: the set comes"),
    ("convert saver.yaml saver.xml", 1, "got saver.xml, which comes with saver.yaml: choose"),
    ("convert room.xml a.yaml", 2, "room.xml is a scene: bake it first, navbake bake room.xml"),
    # one of some words
    ("convert house.json.gz a.yaml --stairs open", 2, "'--stairs': expected occupied or free, got"),
    ("convert house.json.gz a.obj --up x", 2, "'--up': expected y or z, got 'x'"),
    ("path house.json.gz --from 0,0 --to 1,1 --doors ajar", 2, "'--doors': expected modelled or"),
    (f"{PATH} --to room:1:1 --doors door_front=ajar", 2, "or NAME=STATE of one door, got 'door_fr"),
    (f"{PATH} --to room:1:1 --doors =open", 2, "or NAME=STATE of one door, got '=open'"),
    (f"{PATH} --to room:1:1 --doors gate=open", 1, "no door 'gate' in 'house': it has door_back"),
    (f"{PATH} --to room:1:1 --close door_front", 1, "'house': it is a door, whose state `with_d"),
    ("episodes house.json.gz -o a.jsonl --task objectnav", 2, "'--task': expected point or object"),
    ("fly room.xml --from 0,0,1 --to 1,1,1 --unknown no", 2, "expected occupied or free, got 'no'"),
    ("episodes house.json.gz -o a.jsonl --sampler hab", 2, "expected uniform or habitat or"),
    (
        "episodes house.json.gz -o a.jsonl --split-by floor",
        2,
        "expected scene or room, got",
    ),
    # numbers
    ("verify house.json.gz --sample 0", 2, "'--sample': expected a number >= 1, got '0'"),
    ("bake room.yaml --radius 30cm", 2, "expected a number, got '30cm'"),
    ("inflate house.json.gz 30cm -o a.json", 2, "'RADIUS': expected a number, got '30cm'"),
    ("sample house.json.gz --seed=x", 2, "'--seed': expected a whole number, got 'x'"),
    ("sample house.json.gz -n 0", 2, "expected a number >= 1, got '0'"),
    # files that are not there, or something else
    ("info none.json", 1, "none.json"),
    ("rooms none.json", 1, "none.json"),
    ("info room.xml", 1, "room.xml"),
    ("plot none.json -o a.png", 1, "none.json"),
    ("plot room.xml -o none/a.png", 1, "none/a.png"),
    ("geoms none.xml", 1, "none.xml"),
    ("geoms none.yaml", 1, "none.yaml"),
    ("init none.xml", 1, "no such file: none.xml"),
    ("init room.xml", 1, "room.yaml"),  # it is there
    # bake
    ("bake none.yaml", 1, "none.yaml"),
    ("bake none.xml", 1, "none.xml"),
    ("bake room.yaml --set grid.cell_size=5cm", 1, "`grid.cell_size`"),
    ("bake room.yaml --set grid.cellsize=1", 1, "`grid.cell_size`"),
    ("bake room.yaml --set grid.max_cells=10", 1, "`grid.max_cells`"),
    ("bake room.yaml --set verify.sample=0", 1, ">= 1, or null, got 0 at `verify.sample`"),
    ("bake room.yaml --set scene.geoms=visual -o none/a.json", 1, "none/a.json"),
    ("bake room.yaml -o room.yaml", 1, "got room.yaml"),
    ("bake room.yaml -o room.xml", 1, "got room.xml"),
    ("bake room.yaml -o room.xml/", 1, "room.xml/room.grid.json"),
    ("bake room.yaml --set output=.", 1, "cannot write .: it is a folder"),
    ("bake room.yaml room.xml -o one.json", 2, "expected a folder, got one.json"),
    ("bake room.yaml -o grids", 2, "got grids: a new folder is written grids/"),
    ("bake room.yaml --name {scene}", 2, "{id}, {stem}, {parent}, got {scene}"),
    ("bake room.yaml --name ../{id}", 2, "got '../{id}'"),
    ("bake room.yaml --name /tmp/{id}", 2, "got '/tmp/{id}'"),
    ("bake room.yaml --name ''", 2, "got ''"),
    ("bake room.yaml --name a -o b.json", 2, "--name: does nothing here: it is for files in a"),
    # pictures and pages
    ("plot house.json.gz", 2, "--output"),
    ("plot house.json.gz -o room.gif", 2, "ends in .png, .svg, .pdf, got room.gif"),
    ("plot house.json.gz -o a.png --layer heat", 2, "expected one of occupancy, floor, rooms,"),
    ("plot house.json.gz -o house.json.gz", 1, "apart from the inputs"),
    ("report house.json.gz -o report.pdf", 2, ".html"),
    ("report house.json.gz", 2, "expected a page to write"),
    ("report house.json.gz -o a.html --verify arena.json", 1, "arena.json"),
    ("report house.json.gz house.json.gz -o a.html --verify a", 2, "each GRID, 2, got 1"),
    ("report .", 1, "expected grids, or one folder of a batch with index.jsonl, got ."),
    ("report . --audit", 2, "does nothing here"),
    ("view room.yaml --no-open --scene a.xml", 2, "--scene: does nothing here: it is for a GRID"),
    ("view room.yaml --no-open --force", 2, "--force: does nothing here: it is for a GRID"),
    ("view house.json.gz --no-open --set a.b=1", 2, "it is for a SCENE or CONFIG"),
    ("view room.yaml --no-open --host no.such.host.invalid", 1, "no address of this machine"),
    ("view broken.yaml --no-open --port 0", 1, "agnt"),
    # places
    ("path house.json.gz --from abc --to room:1:1", 2, "--from"),
    ("path house.json.gz --from kitchen --to 0,0", 2, "got 'kitchen'; a room is written room:NAME"),
    ("path house.json.gz --from object:sofa --to 0,0", 2, "a room is written room:NAME"),
    ("path broken.yaml --from 0,0,0,0 --to room:1:1", 2, "got '0,0,0,0'"),  # without loading it
    ("path broken.yaml --from 0,0 --to 1e999,0", 2, "expected finite numbers"),
    ("path house.json.gz --from 1:1 --to 0,0", 2, "got '1:1'; did you mean room:1:1?"),
    ("path house.json.gz --from sofa --to 0,0", 2, "got 'sofa'; a room is written room:NAME"),
    (f"{PATH} --to kitchen", 2, "a room is written room:NAME, an object object:NAME"),
    (f"{PATH} --to sofa", 2, "got 'sofa'; did you mean object:sofa?"),
    (f"{PATH} --to 1:1", 2, "got '1:1'; did you mean room:1:1?"),
    ("path house.json.gz --from room:nix --to 0,0,L0", 1, "no room 'nix'"),
    ("bake room.yaml --radius -1", 1, "got -1.0 at `agent.radius` in --radius -1"),
    ("bake room.yaml --cell-size 0", 1, "got 0.0 at `grid.cell_size` in --cell-size 0"),
    ("bake room.yaml --cell-size nan", 1, "got nan at `grid.cell_size` in --cell-size nan"),
    ("batch room.xml -o out --cell-size -1", 1, "`grid.cell_size` in --cell-size -1"),
    ("bake room.yaml --set agent.radius=-1", 1, "`agent.radius` in --set agent.radius=-1"),
    ("path house.json.gz --from 0,0,0,0 --to room:1:1", 2, "--from"),
    ("path house.json.gz --from 0,0 --to room:1:1", 2, "a level"),
    (f"{HERE} --from 1,1", 2, "--from: expected a place with a level or z, got 1,1"),
    (f"{HERE} --from 99,0", 2, "--from: no level has a floor at 99, 0"),
    (f"{HERE} --from 0,-4.8,L1", 2, "level 1 has no floor at 0, -4.8"),
    (f"{PATH} --to 1,1", 2, "levels have a floor: write 1,1,L0 or 1,1,L1"),
    (f"{PATH} --to 1,1,Lx", 2, "--to"),
    (f"{PATH} --to room:1:1 --to 0,0,0", 2, "several goals"),
    (f"{PATH} --to 1,1,L7", 1, "no level 7"),
    (f"{PATH} --to room:nowhere", 1, "no room 'nowhere'"),
    (f"{PATH} --to room:1:1 -o path.jpg", 2, ".png"),
    (f"{PATH} --to room:1:1 -o house.json.gz", 1, "apart from the inputs"),
    (f"{PATH} --to room:1:1 --radius -1", 1, "radius"),
    ("why house.json.gz --at 1,1,-30", 1, "1, 1, -30 lies below every floor"),
    # inflate: before the grid is read, where its arguments are wrong
    ("inflate absent.json --radius -1 -o a.json", 1, "0 to 10,000 m as radius, got -1.0"),
    ("inflate absent.json --radius nan -o a.json", 1, "as radius, got nan"),
    ("inflate absent.json --radius 1 --mode best -o a.json", 2, "--mode': expected exact or minos"),
    ("inflate absent.json --radius 1 --costs none -o a.json", 2, "expected step or nav2, got"),
    ("inflate absent.json --radius 1 -o absent/a.json", 1, "cannot write absent/a.json"),
    ("inflate absent.json --radius 1 -o a.json", 1, "absent.json"),
    ("inflate house.json.gz --radius 30cm -o a.json", 2, "30cm"),
    ("inflate house.json.gz --radius=30cm -o a.json", 2, "30cm"),
    ("convert house.json.gz a.yaml --height 0.1:1.2", 2, "--height: does nothing here: it is for"),
    ("convert house.json.gz a.xml --height 0.1:1.2", 2, "expected the height of walls [m]"),
    ("inflate house.json.gz --radius 1 --scaling 3 -o a.json", 2, "does nothing here"),
    ("inflate house.json.gz 1 --mode minos --ledges avoid -o a.json", 2, "does nothing here"),
    ("inflate house.json.gz 1 -o a.pgm", 2, ".json, .json.gz, got a.pgm"),
    ("inflate house.json.gz 1 -o ./house.json.gz", 1, "apart from the inputs"),
    # convert
    ("convert lab.building.yaml a.json", 2, "IN: lab.building.yaml is a scene: bake it first"),
    ("convert set.csv a.json --cut-corners", 2, "--cut-corners: does nothing here: it is for"),
    ("convert house.json.gz -", 2, "--to"),
    ("convert house.json.gz a.tif", 2, "OUT: expected"),
    ("convert house.tif a.json", 2, "IN: expected"),
    ("convert house.json.gz a.json --to tiff", 2, "--to: expected"),
    ("convert house.json.gz a.json --from tiff", 2, "got tiff"),
    ("convert house.json.gz a.json --level 0", 2, "--level: does nothing here"),
    ("convert house.json.gz ./house.json.gz", 1, "apart from the inputs"),
    ("convert house.json.gz map.yaml --inflation 1", 1, "mode trinary has no costs"),
    ("convert house.json.gz map.yaml --flat", 2, "it is for mjcf as OUT"),
    ("convert house.json.gz a.png --mode raw", 2, "it is for nav2 as OUT"),
    ("convert house.json.gz - --to nav2 --level 0", 2, "nav2 is 2 files"),
    ("convert house.json.gz - --to mjcf", 2, "files"),
    ("convert house.json.gz a.xml --level 7", 1, "7"),
    (
        "convert house.json.gz a.xml --level attic",
        1,
        "no level attic in 'house': it has 0 (level 0",
    ),
    ("convert house.json.gz a.bt", 2, "made of scenes, not of grids: `navbake voxelize SCENE -o a"),
    ("convert house.json.gz - --to binvox", 2, "`navbake voxelize SCENE -o FILE.binvox`"),
    ("convert house.json.gz m.yaml --to nav2-keepout --zones m.yaml", 1, "apart from the inputs"),
    # map-descriptor
    ("mdf", 2, "expected a GRID, or --decode"),
    ("mdf arena.grid.json --rows 3", 2, "both or none"),
    ("mdf arena.grid.json --level 4", 1, "no level 4 in 'arena': it has 0 (level 0)"),
    ("mdf arena.grid.json --explored no.npy", 1, "cannot read no.npy"),
    ("mdf arena.grid.json --explored several.npz", 1, "in several.npz"),
    ("mdf arena.grid.json --square 1e-7", 1, "larger squares"),
    ("mdf none.json", 1, "none.json"),
    (f"mdf --decode {P1} {P2}0", 1, "in part 2"),
    ("mdf --decode F F --level 1", 2, "--level: does nothing here: it is for a GRID"),
    ("mdf --decode F F --square 0.2", 2, "--square: does nothing here: it is for a GRID"),
    ("mdf --decode F F --corner 0 0", 2, "--corner: does nothing here: it is for a GRID"),
    ("mdf --decode F F --explored a.npy", 2, "--explored: does nothing here: it is for a GRID"),
    # voxelize
    ("voxelize arena.xml -o a.vox", 2, ".binvox, .bt, .ot, .npz"),
    ("voxelize arena.xml -o no/a.bt", 1, "cannot write no/a.bt"),
    ("voxelize arena.xml -o a.npz --segment a=b", 2, "PATTERN=ID"),
    ("voxelize arena.xml -o a.bt --segment top", 2, "octrees hold no IDs"),
    ("voxelize arena.xml -o a.npz --airsim", 2, "--airsim: does nothing here: it is for .binvox"),
    ("voxelize arena.xml -o a.npz --free", 2, "--free: does nothing here: it is for .bt and .ot"),
    ("voxelize arena.xml -o a.binvox --compact", 2, "--compact: does nothing here"),
    ("voxelize arena.xml -o a.binvox --twin", 2, "--twin: does nothing here"),
    ("voxelize arena.xml -o a.npz --segment top --twin", 2, "--twin: does nothing here"),
    ("voxelize arena.xml -o -", 2, "its ending says which format"),
    ("voxelize arena.xml -o a.bt --center 0 0 0", 1, "(`--cells NX NY NZ`) or a size"),
    ("voxelize arena.xml --cells 10 10 -o a.bt", 2, "got '-o': it takes 3 values"),
    ("bake room.xml -o new/dir/x.json", 1, "make the folder new/dir first"),
    ("report grids/index.jsonl", 1, "is the index of a batch: give its folder, grids"),
    ("plot arena.bt -o a.png", 1, "`navbake convert arena.bt arena.grid.json --height 0.1:1.2`"),
    ("episodes house.json.gz -o a.jsonl --rule min_dist=2", 1, "did you mean 'min_distance'?"),
    ("voxelize arena.xml -o a.bt --cells 0 1 1", 1, "whole numbers >= 1"),
    ("voxelize arena.xml -o a.bt --res 0", 1, "`res`"),
    ("voxelize arena.xml -o a.bt --res 1e-5", 1, "GiB of memory are free"),
    # verify
    ("verify arena.grid.json --sample 10 --all", 2, "expected one of them"),
    ("verify arena.grid.json --scene gone.xml", 1, "no scene at gone.xml: it may have moved"),
    # batch
    ("batch no/*.xml -o out", 1, "expected files that match"),
    ("batch room.xml -o out --make grid", 1, "expected one of inflated:RADIUS"),
    ("batch room.xml -o out --set a.b=1", 1, "unknown key"),
    ("batch room.xml -o room.xml/out", 1, "cannot write into"),
    ("batch room.xml -o ''", 2, "expected a folder, got nothing"),
    ("batch room.xml -o out --log -", 2, "expected a file, got -: --json prints the same"),
    ("batch room.xml -o out --log room.xml", 1, "expected an output apart from the inputs"),
    ("batch room.xml -o out --log out/index.jsonl", 1, "expected an output apart from the inputs"),
    ("batch room.xml -o out --log room.xml/log", 1, "cannot write room.xml"),
    ("batch room.xml -o out --ray-address a:1", 2, "does nothing here"),
    ("batch room.xml -o out --executor slurm", 2, "slurm"),
]
CASES += [
    (f"{command} -o {name}", 2, f".json, .json.gz, got {name}")
    for command in ("bake room.yaml", "inflate house.json.gz --radius 1")
    for name in ("map.pgm", "map.yaml", "map.jsonl", "map.gz")
]


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with scenes, settings and grids."""
    place = tmp_path_factory.mktemp("place")
    write_room(place)
    write_arena(place)
    (place / "broken.yaml").write_text("scene: {path: room.xml}\nagnt: {}\n")
    (place / "arena.json").write_text("[]")
    (place / "arena.bt").write_text("# Octomap OcTree binary file\n")
    shutil.copy(GOLDEN / "house.grid.json.gz", place / "house.json.gz")
    navbake.bake(place / "arena.yaml").save(place / "arena.grid.json")
    navbake.load(place / "arena.grid.json").to_nav2(place / "saver.yaml")
    (place / "runs.jsonl").write_text('{"episode": "1", "positions": [[0, 0, 0]]}\n')
    np.savez(place / "several.npz", np.ones((3, 3)))
    return place


@pytest.mark.parametrize(("line", "status", "culprit"), CASES, ids=[case[0] for case in CASES])
def test_wrong_usage_is_refused(place, run, names, monkeypatch, line, status, culprit):
    if line.startswith("view"):
        pytest.importorskip("viser")
    monkeypatch.chdir(place)
    before = {name: (place / name).read_bytes() for name in names(place)}
    found, out, err = run(*shlex.split(line))
    assert (found, out) == (status, "")
    assert culprit in " ".join(err.replace("│", " ").split())
    assert status == 2 or (err.startswith("navbake: ") and err.count("\n") == 1)
    assert {name: (place / name).read_bytes() for name in names(place)} == before
