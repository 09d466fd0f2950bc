"""Who may import what: data goes one way, no circle of files, each big library has one door."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

import pytest

import draw_imports
import navbake

PACKAGE = Path(navbake.__file__).parent
HEAVY = ("matplotlib", "mujoco", "numba", "pydantic", "scipy", "trimesh", "fcl")

# module or package -> all that it may import, apart from the standard library
ONLY = {
    "errors": (),
    "types": ("numpy",),
    "navgrid.lattice": ("numpy", "navbake.types"),
    "formats.format_table": ("navbake.errors",),
}
KERNELS_ONLY = ("numpy", "numba", "llvmlite", "navbake.compiled", "navbake.types")
KERNELS_ONLY += ("navbake.baker.core.arrays", "navbake.baker.core.constants")
KERNELS_ONLY += (
    "navbake.baker.core.tolerances",
    "navbake.baker.core.area_test",
    "navbake.baker.core.limits",
    "navbake.baker.rooms.gap_limits",
)
# methods whose code stands in modules above: these alone may import upwards, for types and inside
# of the methods, and each method does nothing but call one function
FORWARDING = ("navgrid.grid_methods", "routes.graph_methods")
# library -> the modules that may import it
DOORS = {
    "mujoco": ("baker.scene", "baker.readers", "verifier", "views.draw"),
    "fcl": ("baker.occupancy", "verifier"),
    "trimesh": ("baker.readers", "verifier", "views.viewer"),
    "pxr": ("baker.readers.usd", "formats.scene_files"),
    "matplotlib": ("views.flight", "views.plot"),
    "typer": ("cli",),
    "rich": ("cli",),
}
# what may import the baker; a bake starts at `navbake.bake`, which is looked up when it is called.
# A batch drives bakes as the command line does: it needs their settings, stages and inputs.
BAKER_USERS = ("baker", "batch", "cli")
# a verification loads the scene as the bake does, and shares nothing else with it: from these it
# takes the compiled model, its pose, its names, its tree of bodies, and which geoms count as what
VERIFIER_SHARES = ("navbake.baker.scene.scene", "navbake.baker.scene.names")
VERIFIER_SHARES += ("navbake.baker.scene.model",)
# what the scene has besides, made by code that is checked
VERIFIER_LEAVES = ("shapes", "bounds")
LIGHT = ("navgrid", "formats", "runtime", "voxels", "arena", "views", "files", "errors", "types")
LIGHT += ("auditor", "tensors", "episodes", "scores")
# from below: what pictures and pages are made of knows nothing of them
BELOW_VIEWS = ("navgrid", "formats", "runtime", "tensors", "voxels", "arena", "auditor", "verifier")
BELOW_VIEWS += ("episodes", "scores")
NEVER_AT_RUN_TIME = ("mujoco", "fcl", "trimesh", "navbake.baker")
DRAWS_IN_MUJOCO = "views.draw"  # what it is called with has loaded MuJoCo


def find_modules(package: Path) -> dict[str, Path]:
    """All modules of a package by their dotted names without the package's."""
    return {
        ".".join(part for part in path.relative_to(package).with_suffix("").parts).removesuffix(
            ".__init__"
        ): path
        for path in sorted(package.rglob("*.py"))
    }


@cache
def parse(source: str) -> ast.Module:
    """A module's syntax tree; many tests ask for the same one."""
    return ast.parse(source)


def imports(path: Path, *, with_types: bool = False) -> frozenset[str]:
    """Names of all modules that a file imports, at the top or later; for types only if asked."""
    return imports_of(path.read_text(encoding="utf-8"), with_types=with_types)


@cache
def imports_of(source: str, *, with_types: bool) -> frozenset[str]:
    """Names of all modules that a file imports, at the top or later; for types only if asked."""
    skipped: set[ast.AST] = set()
    found = set()
    for node in ast.walk(parse(source)):
        is_for_types = isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"
        if is_for_types and not with_types:
            skipped.update(child for part in node.body for child in ast.walk(part))
        if node in skipped:
            continue
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"a relative import in line {node.lineno}"
            assert node.module is not None
            found.add(node.module)
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Call) and getattr(node.func, "id", "") == "lazy":
            assert isinstance(node.args[0], ast.Constant), f"line {node.lineno} hides what it loads"
            found.add(str(node.args[0].value))
    return frozenset(found)


def import_graph(package: Path) -> dict[str, set[str]]:
    """Which of a package's modules each of them imports, in functions and for types as well.

    Modules of `FORWARDING` have no imports here: they name modules above, which import them.
    """
    modules = find_modules(package)
    known = {f"{package.name}.{name}": name for name in modules}
    graph = {
        name: {known[found] for found in imports(path, with_types=True) if found in known} - {name}
        for name, path in modules.items()
    }
    return graph | {name: set() for name in FORWARDING if name in graph}


def find_circle(graph: Mapping[str, set[str]]) -> list[str] | None:
    """One circle of modules that import each other, or None; a depth-first search."""
    done: set[str] = set()

    def visit(name: str, way: list[str]) -> list[str] | None:
        if name in way:
            return [*way[way.index(name) :], name]
        if name in done:
            return None
        for used in sorted(graph[name]):
            circle = visit(used, [*way, name])
            if circle:
                return circle
        done.add(name)
        return None

    circles: Iterator[list[str] | None] = (visit(name, []) for name in sorted(graph))
    return next((circle for circle in circles if circle), None)


def belongs(name: str, prefixes: tuple[str, ...]) -> bool:
    return any(name == prefix or name.startswith(prefix + ".") for prefix in prefixes)


MODULES = find_modules(PACKAGE)


def is_kernel_module(name: str) -> bool:
    """Whether a module has compiled code: `kernel` or `subkernel` decorates a function there.

    It is asked while tests are collected, so nothing is parsed for it.
    """
    text = MODULES[name].read_text(encoding="utf-8")
    return re.search(r"^ *@(sub)?kernel\b", text, re.MULTILINE) is not None


KERNELS = {name for name in MODULES if is_kernel_module(name)}


def test_modules_with_kernels_are_those_that_import_their_decorators():
    decorators = {"navbake.compiled.kernel", "navbake.compiled.subkernel"}
    importing = {name for name, path in MODULES.items() if imports(path) & decorators}
    assert importing == KERNELS


def test_no_circle_of_files():
    circle = find_circle(import_graph(PACKAGE))
    assert circle is None, " -> ".join(circle or [])


def test_a_planted_circle_is_found(tmp_path):
    package = tmp_path / "planted"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "one.py").write_text("from planted.two import name\n")
    (package / "two.py").write_text("def name():\n    from planted import three\n")
    (package / "three.py").write_text("value = 1\n")
    assert find_circle(import_graph(package)) is None
    (package / "three.py").write_text("def value():\n    import planted.one\n")
    assert find_circle(import_graph(package)) == ["one", "two", "three", "one"]
    (package / "three.py").write_text(
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import planted.one\n"
    )
    assert find_circle(import_graph(package)) == ["one", "two", "three", "one"]


@pytest.mark.parametrize("name", FORWARDING)
def test_only_calls_stand_where_imports_go_upwards(name):
    """So nothing of what decides something is beyond the tests of who imports what."""
    assert f"navbake.{name}" in draw_imports.FORWARDING
    tree = ast.parse(MODULES[name].read_text(encoding="utf-8"))
    at_the_top = {node.module for node in tree.body if isinstance(node, ast.ImportFrom)}
    assert {module for module in at_the_top if module.startswith("navbake")} <= {"navbake.types"}
    (methods,) = (node for node in tree.body if isinstance(node, ast.ClassDef))
    functions = [node for node in methods.body if isinstance(node, ast.FunctionDef)]
    assert len(functions) == len(methods.body) - 1  # and a docstring
    for function in functions:
        for statement in function.body:
            allowed = ast.ImportFrom | ast.Expr | ast.Assign | ast.Return
            assert isinstance(statement, allowed), f"{name}.{function.name}"


# the folders of the baker, from below: none imports one that stands later
BAKER_ORDER = ("core", "geometry", "readers", "columns", "scene", "floors", "occupancy")
BAKER_ORDER += ("occupants", "rooms", "doors", "links", "bake", "live", "voxels")


@pytest.fixture(scope="module")
def folder_graph():
    """Which folders each folder of the package imports."""
    return draw_imports.import_graph()


def test_no_folder_of_the_baker_imports_one_above_it(folder_graph):
    folders = {name.removeprefix("baker/") for name in folder_graph if name.startswith("baker/")}
    assert folders == set(BAKER_ORDER)
    for number, folder in enumerate(BAKER_ORDER):
        above = {f"baker/{name}" for name in BAKER_ORDER[number + 1 :]}
        assert not folder_graph[f"baker/{folder}"] & above, folder


def test_no_folders_import_each_other_in_a_circle(folder_graph):
    rows = draw_imports.place_in_rows(folder_graph)
    assert len(rows) > 25


def test_the_picture_of_the_imports_is_up_to_date(folder_graph):
    """If it fails: run `python scripts/draw_imports.py`."""
    picture = draw_imports.draw(folder_graph)
    assert draw_imports.PICTURE.read_text(encoding="utf-8") == picture


@pytest.mark.parametrize("name", MODULES)
def test_only_the_baker_and_the_command_line_import_the_baker(name):
    for found in imports(MODULES[name]):
        users = (*BAKER_USERS, "verifier") if belongs(found, VERIFIER_SHARES) else BAKER_USERS
        assert not belongs(found, ("navbake.baker",)) or belongs(name, users), (
            f"{name} imports {found}"
        )


@pytest.mark.parametrize("name", [n for n in MODULES if belongs(n, ("verifier", "auditor"))])
def test_checks_share_no_code_with_what_they_check(name):
    """No kernels, no Shapes of the scene; the run time is there to be swept along its paths."""
    for found in imports(MODULES[name]):
        assert found.removeprefix("navbake.") not in KERNELS, f"{name} imports {found}"
        assert not belongs(found, ("numba", "navbake.navgrid.islands")), f"{name} imports {found}"
        is_run_time = belongs(found, ("navbake.runtime",))
        assert not is_run_time or name == "verifier.sweeps", f"{name} imports {found}"
        assert not belongs(found, ("navbake.baker",)) or belongs(found, VERIFIER_SHARES)
    for node in ast.walk(parse(MODULES[name].read_text(encoding="utf-8"))):
        if isinstance(node, ast.Attribute) and node.attr in VERIFIER_LEAVES:
            value = node.value
            of_scene = getattr(value, "id", "") == "scene" or getattr(value, "attr", "") == "_scene"
            assert not of_scene, f"{name} takes {node.attr} of the scene"


@pytest.mark.parametrize("name", MODULES)
def test_each_library_has_its_doors(name):
    for library, doors in DOORS.items():
        if any(belongs(found, (library,)) for found in imports(MODULES[name])):
            assert belongs(name, doors), f"{name} imports {library}, which {doors} may"


@pytest.mark.parametrize(("area", "allowed"), ONLY.items())
def test_imports_nothing_else(area, allowed):
    for name, path in MODULES.items():
        if belongs(name, (area,)):
            for found in imports(path):
                is_standard = found.split(".")[0] in sys.stdlib_module_names
                assert is_standard or belongs(found, allowed), f"{name} imports {found}"


@pytest.mark.parametrize("name", sorted(KERNELS))
def test_kernels_import_kernels_alone(name):
    for found in imports(MODULES[name]):
        is_standard = found.split(".")[0] in sys.stdlib_module_names
        is_kernel = belongs(found, tuple(f"navbake.{kernels}" for kernels in KERNELS))
        assert is_standard or is_kernel or belongs(found, KERNELS_ONLY), f"{name} imports {found}"


def test_only_kernels_call_subkernels():
    """A subkernel has no wrapper that Python could call: the process would crash."""
    parts = set()
    for name, path in MODULES.items():
        for node in parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef):
                decorators = [ast.unparse(each).partition("(")[0] for each in node.decorator_list]
                parts |= {f"navbake.{name}.{node.name}"} if "subkernel" in decorators else set()
    assert len(parts) > 50
    for name, path in MODULES.items():
        assert name in KERNELS or not imports(path) & parts, name


@pytest.mark.parametrize(
    "name", [name for name in MODULES if belongs(name, BELOW_VIEWS) and name not in FORWARDING]
)
def test_what_lies_below_imports_no_views(name):
    found = imports(MODULES[name], with_types=True)
    assert not any(belongs(each, ("navbake.views",)) for each in found), found


# file, what it does with another library's name: why
OWN_WAYS = {
    ("compiled", "numba.config.CACHE_DIR ="): "a variable of numba's for its users",
}


def private_uses(path: Path) -> Iterator[str]:
    """What a file uses of other libraries by private names, or sets in them."""
    tree = parse(path.read_text(encoding="utf-8"))
    others: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            module = getattr(node, "module", None) or node.names[0].name
            if module.split(".")[0] in {*sys.stdlib_module_names, "navbake"}:
                continue
            others |= {(each.asname or each.name).split(".")[0] for each in node.names}
            yield from (each.name for each in node.names if each.name.startswith("_"))
        if isinstance(node, ast.Assign) and ast.unparse(node.value).startswith("lazy("):
            others |= {target.id for target in node.targets if isinstance(target, ast.Name)}
    for node in ast.walk(tree):
        is_set = isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store | ast.Del)
        if isinstance(node, ast.Attribute) and ast.unparse(node).split(".")[0] in others:
            is_private = node.attr.startswith("_") and not node.attr.startswith("__")
            if is_private or is_set:
                yield ast.unparse(node) + (" =" if is_set else "")
        is_call = isinstance(node, ast.Call) and ast.unparse(node.func) in ("setattr", "delattr")
        if is_call and ast.unparse(node.args[0]).split(".")[0] in others:
            yield ast.unparse(node)


def test_no_private_names_of_other_libraries_are_used():
    """Nor is anything set in them: their next release would break what is."""
    for name, path in MODULES.items():
        uses = [use for use in private_uses(path) if (name, use) not in OWN_WAYS]
        assert uses == [], f"{name} uses {uses}"
    keywords = [path for path in MODULES.values() if "_nrt" in path.read_text(encoding="utf-8")]
    assert keywords == [PACKAGE / "compiled.py"]


def test_errors_import_nothing_at_all():
    assert imports(MODULES["errors"]) == set()


@pytest.mark.parametrize(
    "name", [name for name in MODULES if belongs(name, LIGHT) and "viewer" not in name]
)
def test_run_time_leaves_the_baker_alone(name):
    for found in imports(MODULES[name]):
        is_allowed = name == DRAWS_IN_MUJOCO and found == "mujoco"
        assert is_allowed or not belongs(found, NEVER_AT_RUN_TIME), f"{name} imports {found}"


@pytest.mark.parametrize("name", MODULES)
def test_an_import_inside_a_function_says_what_it_saves(name):
    """In a comment beside it or above it, or once for the module: ``# Functions import …``."""
    text = MODULES[name].read_text(encoding="utf-8")
    lines = text.splitlines()
    if any(line.startswith("# Functions import ") for line in lines):
        return
    for function in ast.walk(parse(text)):
        if not isinstance(function, ast.FunctionDef):
            continue
        for node in ast.walk(function):
            if isinstance(node, ast.Import | ast.ImportFrom):
                here, above = lines[node.lineno - 1], lines[node.lineno - 2].strip()
                assert "#" in here or above.startswith("#"), f"{name}:{node.lineno} {here.strip()}"


def test_no_function_takes_more_than_10_parameters():
    """Commands do: their parameters are the options of the command line."""
    functions = {name: path for name, path in MODULES.items() if not belongs(name, ("cli",))}
    for name, path in functions.items():
        for node in ast.walk(parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef):
                given = node.args
                parameters = [*given.posonlyargs, *given.args, *given.kwonlyargs]
                count = sum(parameter.arg not in ("self", "cls") for parameter in parameters)
                assert count <= 10, f"{name}.{node.name} takes {count} parameters"


def loaded_after(code):
    """Names of all modules that are loaded in a fresh process after some code."""
    script = f"{code}\nimport sys\nprint(' '.join(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    return set(done.stdout.splitlines()[-1].split())


def test_importing_navbake_loads_none_of_its_dependencies():
    assert loaded_after("import navbake").isdisjoint([*HEAVY, "numpy", "yaml", "typer", "rich"])


def test_the_run_time_loads_no_baker():
    code = "import navbake\nnavbake.load, navbake.SceneGrid2D, navbake.MultiLevelGrid"
    code += "\nnavbake.VoxelGrid, navbake.load_voxels, navbake.ExploredMap"
    loaded = loaded_after(code + "\nimport navbake.views.describe, navbake.views.plot")
    assert "navbake.navgrid.grid" in loaded
    assert loaded.isdisjoint(["mujoco", "fcl", "trimesh", "navbake.baker.bake.pipeline"])


# what is no part of the core, see CONTRIBUTING
SATELLITES = ("arena", "auditor", "batch", "cli", "episodes", "routes", "scores", "tensors")
SATELLITES += ("testing", "verifier", "views", "voxels", "baker.live", "baker.voxels")
CORE_FORMATS = ("allowance", "arrays", "format_table", "navgrid", "package_paths")
CORE_FORMATS += ("scene_files", "shapes", "source", "xml_files")


def test_the_core_loads_no_satellite():
    """What bakes, reads and asks: each satellite could be taken away."""
    code = "import navbake.baker.bake.pipeline, navbake.baker.bake.stages"
    code += ", navbake.formats.navgrid, navbake.runtime.path_finder"
    loaded = loaded_after(code)
    assert "navbake.baker.rooms.rooms" in loaded
    satellites = tuple(f"navbake.{name}" for name in SATELLITES)
    assert {name for name in loaded if belongs(name, satellites)} == set()
    formats = {name for name in loaded if name.startswith("navbake.formats.")}
    assert formats == {f"navbake.formats.{name}" for name in CORE_FORMATS}


def test_the_run_time_starts_without_what_its_first_question_needs():
    code = "import navbake\nnavbake.load, navbake.SceneGrid2D, navbake.PathFinder"
    assert loaded_after(code).isdisjoint(["mujoco", "fcl", "trimesh", "numba", "scipy"])


def test_help_loads_no_baker():
    code = (
        "from navbake.cli.main import main\ntry: main(['bake', '--help'])\nexcept SystemExit: pass"
    )
    assert loaded_after(code).isdisjoint(["mujoco", "fcl", "trimesh", "numba", "scipy", "numpy"])


def test_settings_that_are_missing_are_named_before_scenes_can_be_read():
    code = "from navbake.cli.main import main\ntry: main(['bake', 'none.yaml'])"
    loaded = loaded_after(f"{code}\nexcept SystemExit: pass")
    assert "navbake.config.settings" in loaded
    assert loaded.isdisjoint(["mujoco", "fcl", "trimesh", "numba", "scipy"])


# numba loads scipy.linalg with its first kernel
SCIPY = ("scipy.ndimage", "scipy.sparse", "scipy.spatial")

# a sample with meshes of furniture, whose tops are looked at
APARTMENT = PACKAGE.parent / "configs/scenes/apartment.xml"

# command -> what it doesn't load; `house` and `cup` are scenes without and with a mesh
LIGHT_COMMANDS = {
    "info house.grid.json": ("numba", "scipy", "mujoco", "trimesh", "matplotlib", "PIL"),
    "rooms house.grid.json": ("numba", "scipy", "mujoco", "trimesh", "matplotlib", "PIL"),
    "why house.grid.json --at 0,0": ("numba", "scipy", "mujoco", "trimesh", "matplotlib", "PIL"),
    "bake house.xml -o again.grid.json": ("trimesh", *SCIPY, "matplotlib", "PIL", "glfw", "rich"),
    "geoms house.xml": ("trimesh", *SCIPY, "matplotlib", "PIL", "glfw"),
    "bake cup.xml -o again.grid.json": ("trimesh", *SCIPY, "matplotlib", "PIL", "glfw", "rich"),
    f"bake {APARTMENT} -o flat.grid.json": ("trimesh", *SCIPY, "matplotlib", "PIL", "glfw", "rich"),
}


@pytest.fixture(scope="module")
def baked(tmp_path_factory):
    """A folder with two scenes, and the grid of one."""
    folder = tmp_path_factory.mktemp("baked")
    floor = '<geom type="box" size="2 2 .1" pos="0 0 -.1"/>'
    cup = '<asset><mesh name="cup" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/></asset>'
    (folder / "house.xml").write_text(f"<mujoco><worldbody>{floor}</worldbody></mujoco>")
    geom = '<geom type="mesh" mesh="cup"/>'
    (folder / "cup.xml").write_text(f"<mujoco>{cup}<worldbody>{floor}{geom}</worldbody></mujoco>")
    navbake.bake(folder / "house.xml").save(folder / "house.grid.json")
    return folder


@pytest.mark.parametrize(("command", "unloaded"), LIGHT_COMMANDS.items())
def test_a_command_loads_only_what_it_needs(baked, command, unloaded):
    code = (
        f"import os\nos.chdir({str(baked)!r})\nfrom navbake.cli.main import main\n"
        f"try: main({command.split()})\nexcept SystemExit as end: assert not end.code"
    )
    if sys.version_info < (3, 11):  # numba loads scipy.linalg, which loads it in SciPy 1.15
        unloaded = {*unloaded} - {"scipy.sparse"}
    found = loaded_after(code) & {*unloaded}
    # a run that compiles a kernel loads what only the compiler needs; the next one has it
    assert not found or loaded_after(code) & {*unloaded} == set()


def test_all_public_names_are_there():
    for name in navbake.__all__:
        assert getattr(navbake, name) is not None
        assert name in dir(navbake)
    with pytest.raises(AttributeError, match="nonsense"):
        _ = navbake.nonsense


def test_bake_is_a_function():
    assert loaded_after("import navbake\nassert callable(navbake.bake)")
    assert type(navbake.bake).__name__ == "function"
