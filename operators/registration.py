"""Everything that Blender is told of, in order."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from types import ModuleType

import bpy

from ..wrinkle_addon.blender import (
    command,
    first_start,
    flow_panel,
    flow_properties,
    ghost,
    handlers,
    panels,
    preferences,
    properties,
    render_lock,
    sample_properties,
)
from ..wrinkle_addon.blender import presets as preset_panels
from . import (
    bake,
    check_garment,
    compress_flow,
    evaluate,
    make_coarse_mesh,
    make_local_mesh,
    mirror_joint,
    open_sample,
    pause_bake,
    plot_evaluation,
    plot_samples,
    presets,
    remove_wrinkles,
    restore_sample,
    self_test,
    setup_garment,
    show_influence,
    show_problem,
    simulate_coarse,
    stop_process,
    take_ranges,
    write_clip,
    write_sample,
)

MODULES: Sequence[ModuleType] = (
    preferences,
    self_test,
    flow_properties,
    sample_properties,
    properties,
    setup_garment,
    remove_wrinkles,
    make_local_mesh,
    check_garment,
    show_problem,
    mirror_joint,
    take_ranges,
    show_influence,
    presets,
    bake,
    pause_bake,
    stop_process,
    open_sample,
    write_sample,
    restore_sample,
    make_coarse_mesh,
    simulate_coarse,
    write_clip,
    plot_samples,
    evaluate,
    plot_evaluation,
    compress_flow,
    preset_panels,
    first_start,
    render_lock,
    panels,
    flow_panel,
    ghost,
    handlers,
    command,
)
"""Each has ``classes``, and ``register`` and ``unregister`` if there is more to do."""

Step = tuple[Callable[[], object], Callable[[], object]]


def register() -> None:
    """Register all modules; if one fails, what was registered before it is taken back."""
    undo: list[Callable[[], object]] = []
    try:
        for do, take_back in _steps():
            do()
            undo.append(take_back)
    except BaseException:
        for take_back in reversed(undo):
            take_back()
        raise


def unregister() -> None:
    """Take everything back, last first."""
    for _, take_back in reversed(list(_steps())):
        take_back()


def _steps() -> Iterator[Step]:
    for module in MODULES:
        for cls in module.classes:
            yield _class_step(cls)
        if hasattr(module, "register"):
            yield module.register, module.unregister


def _class_step(cls: type) -> Step:
    return lambda: bpy.utils.register_class(cls), lambda: bpy.utils.unregister_class(cls)
