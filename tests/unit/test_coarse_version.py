"""A cached coarse simulation is of the solver whose source made it."""

import sys

import pytest
import warp as wp
from wrinkle_synthesis.wrinkle_addon import coarse_simulation, coarse_version

# What the coarse simulation imports and does not run, or runs without a part in the motion: settling with line
# searches, tangles, searches for self-contact, where a garment that lies still faces, where things are named and lost,
# how many threads there are.
NO_PART = {
    *("cloth", "cloth_state", "coarse_correction", "coarse_space", "divergence", "facing", "garment", "place", "rig"),
    *("rotations", "settle_safeguards", "surface", "threads", "untangling", "verlet_lists"),
}


@pytest.fixture(autouse=True)
def read_anew():
    coarse_version.source_version.cache_clear()
    yield
    coarse_version.source_version.cache_clear()


def modules_of(module, found):
    """The package's modules that a module takes anything from, itself included."""
    if module.__name__ in found:
        return found
    found[module.__name__] = module
    for value in vars(module).values():
        name = value.__name__ if isinstance(value, type(sys)) else getattr(value, "__module__", None)
        if isinstance(value, wp.Kernel | wp.Function):
            name = value.module.name
        if isinstance(name, str) and name.startswith("wrinkle_synthesis.") and name in sys.modules:
            modules_of(sys.modules[name], found)
    return found


def test_the_version_is_of_all_source_that_shapes_the_motion():
    names = {name.removeprefix("wrinkle_synthesis.") for name in modules_of(coarse_simulation, {})}
    hashed = {path.removesuffix(".py").replace("/", ".") for path in coarse_version.sources()}
    kernels = {name for name in names if name.startswith("kernels.cloth.")}
    assert kernels and kernels <= hashed
    assert {name for name in names if name.startswith("wrinkle_addon.")} <= hashed | {
        f"wrinkle_addon.{name}" for name in NO_PART
    }


@pytest.mark.parametrize("changed", ["kernels/cloth/frame_steps.py", "wrinkle_addon/coarse_contact.py"])
def test_a_change_of_any_of_it_is_another_version(tmp_path, monkeypatch, changed):
    before = coarse_version.source_version()
    files = coarse_version.sources()
    coarse_version.source_version.cache_clear()
    other = tmp_path / "other.py"
    other.write_text(files[changed].read_text("utf-8") + "\nSLACK = 1\n", "utf-8")
    monkeypatch.setattr(coarse_version, "sources", lambda: {**files, changed: other})
    assert coarse_version.source_version() != before


def test_the_same_source_is_the_same_version():
    before = coarse_version.source_version()
    coarse_version.source_version.cache_clear()
    assert coarse_version.source_version() == before
