"""The house's one direction: operators -> wrinkle_addon -> kernels, and bpy only where it belongs."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
LAYERS = ("kernels", "wrinkle_addon", "operators")
BPY_MODULES = {"bpy", "mathutils", "addon_utils", "bmesh", "bl_ext", "gpu"}


def sources() -> list[Path]:
    files = [path for layer in LAYERS for path in sorted((ROOT / layer).rglob("*.py"))]
    return [*files, ROOT / "__init__.py"]


def layer_of(path: Path) -> str:
    return path.relative_to(ROOT).parts[0]


def imports(source: str, path: Path) -> list[tuple[str, bool]]:
    """Modules that a file imports, as paths from the root (relative ones) or names, and whether they are relative."""
    found: list[tuple[str, bool]] = []
    package = path.relative_to(ROOT).parts[:-1]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [(alias.name, False) for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.append((node.module or "", False))
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1]
            for alias in node.names:
                found.append((".".join([*base, *filter(None, [node.module]), alias.name]), True))
    return found


def violations(source: str, path: Path) -> list[str]:
    """What a file may not import."""
    layer = layer_of(path)
    may_use_bpy = layer in ("operators", "__init__.py") or "blender" in path.relative_to(ROOT).parts
    bad = []
    for name, relative in imports(source, path):
        top = name.split(".")[0]
        if relative and top in LAYERS and layer in LAYERS and LAYERS.index(top) > LAYERS.index(layer):
            bad.append(f"{path.name} imports {name}, a layer above its own")
        if relative and layer == "kernels" and top != "kernels":
            bad.append(f"{path.name} imports {name}, but kernels stand alone")
        if not relative and top in (*LAYERS, "wrinkle_synthesis", "demo"):
            bad.append(f"{path.name} imports {name} absolutely")
        if not relative and top in BPY_MODULES and not may_use_bpy:
            bad.append(f"{path.name} imports {name}, which only Blender has")
    return bad


def test_imports_run_one_way():
    assert [problem for path in sources() for problem in violations(path.read_text(), path)] == []


@pytest.mark.parametrize(
    ("place", "source"),
    [
        ("kernels/x.py", "from ..wrinkle_addon import rig"),
        ("wrinkle_addon/x.py", "from ..operators import bake"),
        ("wrinkle_addon/x.py", "import bpy"),
        ("wrinkle_addon/x.py", "def f():\n    from mathutils import Matrix"),
        ("kernels/x.py", "from wrinkle_synthesis.kernels import blend"),
        ("operators/x.py", "import kernels.blend"),
    ],
)
def test_a_wrong_edge_is_seen(place: str, source: str):
    assert violations(source, ROOT / place)


@pytest.mark.parametrize("module", ["", ".wrinkle_addon.cli", ".wrinkle_addon.joint_wrinkles", ".wrinkle_addon.bake"])
def test_the_core_imports_without_blender_and_without_scipy(module: str):
    code = (
        "import sys\n"
        "for name in ('bpy', 'scipy', 'matplotlib'): sys.modules[name] = None\n"
        f"import wrinkle_synthesis{module}\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def asking_for_scipy(source: str) -> list[str]:
    """Functions that import SciPy once they are called."""
    return [
        function.name
        for function in ast.walk(ast.parse(source))
        if isinstance(function, ast.FunctionDef)
        and any(name.split(".")[0] == "scipy" for name, _ in imports(ast.unparse(function), ROOT / "function.py"))
    ]


def test_nothing_that_the_extension_does_asks_for_scipy_later():
    """The extension brings none; what only tests look at may."""
    found = [(path.stem, name) for path in sources() for name in asking_for_scipy(path.read_text("utf-8"))]
    assert found == [("linear_solver", "to_scipy")]
    assert asking_for_scipy("def carry():\n    from scipy import sparse\n") == ["carry"]
