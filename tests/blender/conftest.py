"""What all tests inside Blender share: the registered add-on and one baked database of the small arm."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("bpy")

import bpy
import wrinkle_synthesis
from small_character import Arm, Bumps, bake_bumps, build_arm, empty_scene


@pytest.fixture(scope="session", autouse=True)
def registered() -> Iterator[None]:
    """The add-on, registered once for the whole session."""
    wrinkle_synthesis.register()
    yield
    wrinkle_synthesis.unregister()


@pytest.fixture(scope="session")
def database(registered: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a database of the arm's sleeve."""
    return tmp_path_factory.mktemp("arm") / "sleeve.wrinkles"


@pytest.fixture(scope="session")
def bumps(database: Path) -> Bumps:
    """What the arm's database was made from: the shape of the sleeve in any pose."""
    empty_scene()
    return bake_bumps(build_arm(), database)


@pytest.fixture
def undoable_arm(bumps: Bumps, database: Path, tmp_path: Path) -> Arm:
    """A played arm with a database of its own, its sleeve active, and undo as in the window."""
    folder = shutil.copytree(database, tmp_path / "sleeve.wrinkles")
    empty_scene()
    bpy.context.preferences.edit.use_global_undo = True
    arm = build_arm("", folder)
    bpy.context.view_layer.objects.active = arm.sleeve
    bpy.context.view_layer.update()
    return arm
