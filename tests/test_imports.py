"""Who may import what: the run time never loads the baker, each big library has one door."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import navbake

PACKAGE = Path(navbake.__file__).parent
HEAVY = ("matplotlib", "mujoco", "numba", "pydantic", "scipy", "trimesh", "fcl")

# module or package -> all that it may import, apart from the standard library
ONLY = {
    "errors": (),
    "lattice": ("numpy",),
    "kernels": ("numpy", "numba", "llvmlite", "navbake.kernels"),
}
# library -> the modules that may import it
DOORS = {
    "mujoco": ("bake.model",),
    "fcl": ("bake.contact",),
    "trimesh": ("bake.mesh_scene",),
    "matplotlib": ("plot",),
    "numba": ("kernels", "bake"),
    "typer": ("cli", "cli_files", "cli_inflate", "cli_path", "cli_voxels"),
    "rich": ("cli_tables",),
}
# what an agent loads at run time, and what it never loads
RUN_TIME = (
    "arena",
    "attributes",
    "differences",
    "explored",
    "grid",
    "grid_base",
    "links",
    "lattice",
    "formats",
    "info",
    "islands",
    "errors",
    "files",
    "plot",
    "layers",
    "polygon",
    "rooms_table",
    "runtime",
    "user_data",
    "voxels.files",
    "voxels.floor_plan",
    "voxels.grid",
    "voxels.io",
    "voxels.placement",
)
NEVER_AT_RUN_TIME = ("mujoco", "fcl", "trimesh", "navbake.bake")


def modules():
    """All modules of the package, as (name without ``navbake.``, path)."""
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE).with_suffix("").parts
        yield ".".join(part for part in parts if part != "__init__"), path


def imports(path):
    """Names of all modules that a file imports, at the top or later, but not for types only."""
    skipped = set()
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
            skipped.update(child for part in node.body for child in ast.walk(part))
        if node in skipped:
            continue
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} imports relatively"
            found.add(node.module)
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
    return found


def belongs(name, prefixes):
    return any(name == prefix or name.startswith(prefix + ".") for prefix in prefixes)


MODULES = dict(modules())


@pytest.mark.parametrize("name", MODULES)
def test_each_library_has_its_doors(name):
    for library, doors in DOORS.items():
        if any(belongs(found, [library]) for found in imports(MODULES[name])):
            assert belongs(name, doors), f"{name} imports {library}, which {doors} may"


@pytest.mark.parametrize(("area", "allowed"), ONLY.items())
def test_imports_nothing_else(area, allowed):
    for name, path in MODULES.items():
        if belongs(name, [area]):
            for found in imports(path):
                is_standard = found.split(".")[0] in sys.stdlib_module_names
                assert is_standard or belongs(found, allowed), f"{name} imports {found}"


def test_errors_import_nothing_at_all():
    assert imports(MODULES["errors"]) == set()


@pytest.mark.parametrize("name", [name for name in MODULES if belongs(name, RUN_TIME)])
def test_run_time_leaves_the_baker_alone(name):
    for found in imports(MODULES[name]):
        assert not belongs(found, NEVER_AT_RUN_TIME), f"{name} imports {found}"


def loaded_after(code):
    """Names of all modules that are loaded in a fresh process after some code."""
    script = f"{code}\nimport sys\nprint(' '.join(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    )
    return set(done.stdout.split())


def test_importing_navbake_loads_none_of_its_dependencies():
    assert loaded_after("import navbake").isdisjoint([*HEAVY, "numpy", "yaml", "typer", "rich"])


def test_the_run_time_loads_no_baker():
    code = "import navbake\nnavbake.load, navbake.SceneGrid2D, navbake.MultiLevelGrid"
    code += "\nnavbake.VoxelGrid, navbake.load_voxels, navbake.ExploredMap"
    loaded = loaded_after(code + "\nimport navbake.info, navbake.islands, navbake.plot")
    assert "navbake.grid" in loaded
    assert loaded.isdisjoint(["mujoco", "fcl", "trimesh", "navbake.bake.pipeline"])


def test_the_run_time_starts_without_what_its_first_question_needs():
    code = "import navbake\nnavbake.load, navbake.SceneGrid2D, navbake.PathFinder"
    assert loaded_after(code).isdisjoint(["mujoco", "fcl", "trimesh", "numba", "scipy"])


def test_help_loads_no_baker():
    code = "import navbake.cli\ntry: navbake.cli.main(['bake', '--help'])\nexcept SystemExit: pass"
    assert loaded_after(code).isdisjoint(["mujoco", "fcl", "trimesh", "numba", "scipy"])


def test_all_public_names_are_there():
    for name in navbake.__all__:
        assert getattr(navbake, name) is not None
        assert name in dir(navbake)
    with pytest.raises(AttributeError, match="nonsense"):
        _ = navbake.nonsense


def test_bake_is_both_a_package_and_a_function():
    code = """
import navbake.bake.pipeline as pipeline
import navbake
assert navbake.bake.pipeline is pipeline
assert callable(navbake.bake)
"""
    assert "navbake.bake.pipeline" in loaded_after(code)
