"""What all tests inside Blender share: the registered add-on and one baked database of the small arm."""

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("bpy")

import wrinkle_synthesis
from small_character import Bumps, bake_bumps, build_arm, empty_scene


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
