"""Files that are whole or not there: arrays in safetensors layout, written under another name and renamed."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import secrets
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load as load_tensors
from safetensors.numpy import save as save_tensors

METADATA_KEY = "wrinkle_synthesis"
ARRAY_SUFFIX = ".safetensors"


class StorageError(ValueError):
    """A file that cannot be read or written; the message is one sentence for the user."""


def canonical_json(value: Any) -> str:
    """JSON with one form for one value: sorted keys, no spaces."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def content_key(value: Any) -> str:
    """Hash of a JSON value, 16 hexadecimal digits."""
    return hashlib.sha256(canonical_json(value).encode()).hexdigest()[:16]


def file_hash(path: Path) -> str:
    """sha256 of a file's bytes."""
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def make_folder(path: Path) -> None:
    """Create a folder that can be written to.

    Raises:
        StorageError: If it cannot be created or written to.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe = temporary_name(path / "probe")
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise StorageError(f"Cannot write to the folder '{path}': {_reason(error)}; choose another place.") from error


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file atomically and durably; readers see the old file or the whole new one.

    Raises:
        StorageError: If the disk is full or the folder cannot be written to; nothing is left behind.
    """
    temporary = temporary_name(path)
    try:
        try:
            with open(temporary, "xb") as stream:
                stream.write(data)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
        _sync_folder(path.parent)
    except OSError as error:
        raise StorageError(
            f"Cannot write '{path}': {_reason(error)}; free some space or choose another place."
        ) from error


def write_json(path: Path, value: Any) -> None:
    """Write a JSON file atomically, in a form that people can read and that is the same for the same value."""
    write_bytes(path, (json.dumps(value, sort_keys=True, indent=1, allow_nan=False) + "\n").encode())


def read_json(path: Path) -> Any:
    """Read a JSON file.

    Raises:
        StorageError: If the file is missing or damaged.
    """
    try:
        return json.loads(path.read_bytes())
    except FileNotFoundError as error:
        raise StorageError(f"There is no file '{path}'.") from error
    except (OSError, ValueError) as error:
        raise StorageError(f"The file '{path}' is damaged; restore or remake it.") from error


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]], metadata: Any) -> None:
    """Write arrays with a JSON value beside them, atomically; the same input gives the same bytes.

    The metadata are one value under one key, because the library writes several keys in random order.
    """
    contiguous = {name: np.ascontiguousarray(array) for name, array in sorted(arrays.items())}
    write_bytes(path, save_tensors(contiguous, metadata={METADATA_KEY: canonical_json(metadata)}))


def read_arrays(path: Path) -> tuple[dict[str, NDArray[Any]], Any]:
    """Arrays and metadata of a file of :func:`write_arrays`.

    Raises:
        StorageError: If the file is missing, truncated or no such file, or an array holds values that are not numbers.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise StorageError(f"There is no file '{path}'.") from error
    except OSError as error:
        raise StorageError(f"Cannot read '{path}': {_reason(error)}.") from error
    try:
        arrays = load_tensors(data)
        header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
        metadata = json.loads(header["__metadata__"][METADATA_KEY])
    except (SafetensorError, KeyError, TypeError, ValueError) as error:
        raise StorageError(f"The file '{path}' is damaged or truncated; restore or remake it.") from error
    for name, array in arrays.items():
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise StorageError(f"The array '{name}' in '{path}' holds values that are not numbers; remake the file.")
    return arrays, metadata


def temporary_name(path: Path) -> Path:
    """A name in the same folder that no other process on any host will take."""
    return path.with_name(f".{path.name}.{socket.gethostname()}-{os.getpid()}-{secrets.token_hex(4)}.tmp")


def _sync_folder(folder: Path) -> None:
    """Make a rename survive a power cut, where the system lets a folder be opened (Windows does not)."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except PermissionError:
        return
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _reason(error: OSError) -> str:
    reasons = {
        errno.ENOSPC: "the disk is full",
        errno.EDQUOT: "the disk quota is used up",
        errno.EACCES: "permission denied",
        errno.EROFS: "it is read-only",
        errno.ENOTDIR: "a part of the path is a file",
        errno.EEXIST: "a file of that name is in the way",
    }
    return reasons.get(error.errno or 0, error.strerror or str(error))
