"""The add-on as Blender sees it: enabled as an extension, taken back whole, registered twice without harm."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import bpy
import pytest
import wrinkle_synthesis
from wrinkle_synthesis.operators import registration
from wrinkle_synthesis.wrinkle_addon.blender import handlers

ROOT = Path(wrinkle_synthesis.__file__).parent

AS_EXTENSION = """
import os, sys
import bpy
import addon_utils
name = "bl_ext.user_default.wrinkle_synthesis"
addon_utils.enable(name, default_set=True)
preferences = bpy.context.preferences.addons[name].preferences
assert preferences.device == "auto"
ob = bpy.data.objects["Cube"]
assert not ob.wrinkles.enabled
assert bpy.ops.wrinkle.bake.poll() is False
assert bpy.types.WRINKLE_PT_play.is_registered
blender = sys.modules[name + ".wrinkle_addon.blender.preferences"]
preferences.device = "cpu"
assert blender.device_name() == "cpu"
addon_utils.disable(name)
assert not hasattr(ob, "wrinkles")
assert not [h for h in bpy.app.handlers.frame_change_post if "wrinkle" in h.__module__]
sys.stdout.flush()
os._exit(0)
"""


def our_handlers() -> list[object]:
    return [handler for name in handlers.HANDLERS for handler in getattr(bpy.app.handlers, name)
            if "wrinkle" in handler.__module__]  # fmt: skip


def test_the_repository_is_an_extension(tmp_path: Path) -> None:
    place = tmp_path / "extensions" / "user_default"
    place.mkdir(parents=True)
    (place / "wrinkle_synthesis").symlink_to(ROOT)
    run = subprocess.run(
        [sys.executable, "-c", AS_EXTENSION],
        env={**os.environ, "BLENDER_USER_RESOURCES": str(tmp_path)},
        check=False,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert run.returncode == 0, run.stderr
    assert "Traceback" not in run.stderr


def test_importing_the_package_needs_no_blender() -> None:
    code = "import sys; sys.modules['bpy'] = None; import wrinkle_synthesis"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_handlers_of_an_earlier_registration_are_replaced() -> None:
    count = len(our_handlers())
    assert count == len(handlers.HANDLERS)
    handlers.register()
    assert len(our_handlers()) == count


def test_a_failed_registration_leaves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail() -> None:
        raise RuntimeError("no more room")

    registration.unregister()
    try:
        monkeypatch.setattr(handlers, "register", fail)
        with pytest.raises(RuntimeError, match="no more room"):
            registration.register()
        assert not hasattr(bpy.types.Object, "wrinkles")
        assert not hasattr(bpy.types, "WRINKLE_PT_play")
        assert not our_handlers()
    finally:
        monkeypatch.undo()
        registration.register()
