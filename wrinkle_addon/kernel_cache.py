"""Compiled kernels: Warp compiles each for a device when it is first used, and keeps it in its cache folder."""

from __future__ import annotations

import hashlib
import importlib
import os
import pkgutil
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import cache
from pathlib import Path

import warp as wp

from .. import kernels


def compile_kernels(devices: Sequence[str]) -> Iterator[tuple[int, int]]:
    """Compile all kernels for some devices, several at once; what is in the cache is only loaded.

    Yields:
        How many modules are done, and how many there are.
    """
    jobs = [(name, device) for device in devices for name in _modules()]
    workers = ThreadPoolExecutor(min(4, os.cpu_count() or 1))
    try:
        done = [workers.submit(wp.load_module, name, device, max_workers=0) for name, device in jobs]
        for count, job in enumerate(as_completed(done), 1):
            job.result()
            yield count, len(jobs)
    finally:
        workers.shutdown(cancel_futures=True)
    for device in devices:
        _stamp(device).touch()


def are_compiled(devices: Sequence[str]) -> bool:
    """Whether all kernels were compiled for these devices, in this version, under this name of the package."""
    return all(_stamp(device).exists() for device in devices)


def cache_folder() -> Path:
    """Where Warp keeps compiled kernels: $WARP_CACHE_PATH, or a folder in the user's cache."""
    wp.init()
    return Path(wp.config.kernel_cache_dir)


def _stamp(device: str) -> Path:
    """The file that says that all kernels are there; it goes when somebody empties the cache."""
    target = wp.get_device(device)
    kind = wp.get_cpu_kernel_cache_key() if target.is_cpu else f"{wp.config.version} sm_{target.arch}"
    key = hashlib.sha256(f"{_sources()} {kind}".encode()).hexdigest()[:16]
    return cache_folder() / f"wrinkle_synthesis-{key}.ready"


@cache
def _sources() -> str:
    """Hash of the kernels' text, and of the name under which this package is imported, by which Warp keeps them."""
    digest = hashlib.sha256(kernels.__name__.encode())
    for path in sorted(Path(kernels.__path__[0]).rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


@cache
def _modules() -> tuple[str, ...]:
    """Modules that hold kernels, those that play first."""
    found = [each.name for each in pkgutil.walk_packages(kernels.__path__, f"{kernels.__name__}.")]
    for name in found:
        importlib.import_module(name)
    with_kernels = [name for name in found if wp.get_module(name).kernels]
    return tuple(sorted(with_kernels, key=lambda name: ".cloth." in name))
