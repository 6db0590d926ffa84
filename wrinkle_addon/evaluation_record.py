"""The last evaluation of a database, beside it, so that the panel can tell of it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from . import storage
from .storage import StorageError


def write_evaluation(folder: Path, key: str, result: Mapping[str, Any]) -> Path:
    """Keep the result of :func:`.evaluate.evaluate` in a database's folder, in place of an earlier one.

    Raises:
        StorageError: If the folder cannot be written to.
    """
    path = evaluation_path(folder, key)
    storage.write_json(path, dict(result))
    return path


def read_evaluation(folder: Path, key: str) -> Mapping[str, Any] | None:
    """The evaluation that was kept last; None if there is none.

    Raises:
        StorageError: If it is damaged; one sentence.
    """
    path = evaluation_path(folder, key)
    if not path.exists():
        return None
    result = storage.read_json(path)
    if not isinstance(result, dict) or not {"rmse_mm", "frames"} <= result.keys():
        raise StorageError(f"The file '{path}' is no evaluation; evaluate again with --keep.")
    return result


def evaluation_path(folder: Path, key: str) -> Path:
    """Where the evaluation of a database is kept."""
    return folder / f"evaluation-{key}.json"
