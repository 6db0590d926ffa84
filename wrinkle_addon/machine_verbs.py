"""Verbs about this machine: what works on it, and its compiled kernels."""

from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
import json
import platform
import sys
from collections.abc import Mapping
from typing import Any

import warp as wp

from .folder_verbs import choose_device
from .kernel_cache import are_compiled, cache_folder, compile_kernels
from .self_test import self_test


def doctor(options: argparse.Namespace) -> Mapping[str, Any]:
    """Versions and devices, what is missing for what, and on request whether a bake and a play work."""
    chosen = choose_device(options.device)
    result: dict[str, Any] = {
        "versions": _versions(),
        "devices": [str(device) for device in wp.get_devices()],
        "hardware": describe_devices(),
        "driver": driver_version(),
        "device": chosen,
        "kernel_cache": str(cache_folder()),
        "compiled": are_compiled([chosen]),
    }
    lines = [f"{name:12} {version or 'missing'}" for name, version in result["versions"].items()]
    lines += [f"{name:12} {text}" for name, text in result["hardware"].items()]
    lines.append(f"{'driver':12} {result['driver'] or 'no CUDA driver was found'}")
    lines.append(f"{'would use':12} {chosen}")
    lines.append(f"{'kernels':12} in {result['kernel_cache']}")
    if not result["compiled"]:
        lines.append(f"{'':12} not compiled yet for {chosen}; they are on first use, or by: wrinkle kernels")
    if importlib.util.find_spec("scipy") is None or importlib.util.find_spec("matplotlib") is None:
        lines.append("Without SciPy and Matplotlib there are no plots; everything else works.")
    if options.self_test:
        checks = list(self_test(chosen))
        lines += [
            f"{check.name:12} {'works' if check.passed else 'FAILS'}, {check.seconds:.1f} s: {check.text}"
            for check in checks
        ]
        result["checks"] = [vars(check) for check in checks]
        result["exit_code"] = 0 if all(check.passed for check in checks) else 1
    return {**result, "text": "\n".join(lines)}


def kernels(options: argparse.Namespace) -> Mapping[str, Any]:
    """Compile all kernels, so that nothing that comes later waits for them."""
    devices = list(dict.fromkeys(("cpu", choose_device(options.device))))
    total = 0
    for done, total in compile_kernels(devices):
        event = {"event": "kernels", "done": done, "total": total}
        line = json.dumps(event) if options.progress == "json" else f"[{done}/{total}]"
        print(line, file=sys.stderr, flush=True)
    text = f"{total} modules are compiled for {', '.join(devices)}."
    return {"devices": devices, "modules": total, "kernel_cache": str(cache_folder()), "text": text}


def describe_devices() -> dict[str, str]:
    """What every Warp device is, by its name."""
    return {
        str(device): platform.processor() or platform.machine()
        if device.is_cpu
        else f"{device.name}, {device.total_memory / 2**30:.0f} GiB, sm_{device.arch}"
        for device in wp.get_devices()
    }


def driver_version() -> str:
    """The CUDA version of the installed driver; empty where there is none."""
    version = wp.get_cuda_driver_version()
    return "" if version is None else f"CUDA {version[0]}.{version[1]}"


def _versions() -> dict[str, str | None]:
    versions: dict[str, str | None] = {"python": platform.python_version(), "platform": platform.platform()}
    for package in ("numpy", "warp-lang", "safetensors", "scipy", "matplotlib", "pillow", "bpy"):
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            versions[package] = None
    if (bpy := sys.modules.get("bpy")) is not None:
        versions["bpy"] = bpy.app.version_string
    return versions
