"""Samples corrected by hand, beside the baked ones of a database (W08: edit a few samples, not all frames).

    corrections-KEY.json              which version of which sample counts; without it, all of them as baked
    SAMPLE-KEY-edit-N.safetensors     the N-th correction of a sample, in the form of a baked one

The baked file is never touched, and no correction is ever written over: going back is a change of one number.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from . import storage
from .storage import StorageError

FORMAT = 1
BAKED = 0
"""The version that the bake made."""


@dataclass(frozen=True)
class CorrectedSample:
    """All versions of one sample.

    Attributes:
        current: The version that counts; BAKED, or from 1 on.
        hashes: sha256 of every correction's file, the first one's first.
    """

    current: int
    hashes: tuple[str, ...]


@dataclass(frozen=True)
class Corrections:
    """What was corrected of one bake.

    Attributes:
        folder: The database's.
        key: Of the bake.
        samples: By the sample's name; those that were never corrected are missing.
    """

    folder: Path
    key: str
    samples: Mapping[str, CorrectedSample]

    @staticmethod
    def read(folder: Path, key: str) -> Corrections:
        """The corrections of a bake, which may have none.

        Raises:
            StorageError: If their list is damaged; one sentence.
        """
        path = _list_path(folder, key)
        if not path.exists():
            return Corrections(folder, key, {})
        data = storage.read_json(path)
        try:
            if data["format"] != FORMAT:
                raise StorageError(f"The list of corrections '{path}' is of another version; restore or remove it.")
            samples = {
                name: CorrectedSample(int(entry["current"]), tuple(str(digest) for digest in entry["hashes"]))
                for name, entry in data["samples"].items()
            }
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            if isinstance(error, StorageError):
                raise
            raise StorageError(f"The list of corrections '{path}' is damaged; restore or remove it.") from error
        for name, sample in samples.items():
            if not BAKED <= sample.current <= len(sample.hashes):
                raise StorageError(f"The list of corrections '{path}' names a version of {name} that is not there.")
        return Corrections(folder, key, samples)

    def path(self, sample: str) -> Path | None:
        """File of the correction that counts; None if the sample counts as baked."""
        known = self.samples.get(sample)
        return None if known is None or known.current == BAKED else self._path(sample, known.current)

    def next_path(self, sample: str) -> Path:
        """File for one more correction of a sample."""
        return self._path(sample, self._versions(sample) + 1)

    def with_next(self, sample: str) -> Corrections:
        """The correction that was just written to :meth:`next_path` counts from now on; the list is written."""
        number = self._versions(sample) + 1
        digest = storage.file_hash(self._path(sample, number))
        before = self.samples[sample].hashes if sample in self.samples else ()
        return self._with(sample, CorrectedSample(number, (*before, digest)))

    def with_version(self, sample: str, version: int) -> Corrections:
        """Another version of a sample counts from now on; the list is written.

        Raises:
            ValueError: If there is no such version.
        """
        count = self._versions(sample)
        if not BAKED <= version <= count:
            raise ValueError(f"The sample {sample} has {count} corrections, but no version {version}.")
        if count == 0:
            return self
        return self._with(sample, replace(self.samples[sample], current=version))

    def problems(self, *, check_hashes: bool = True) -> list[str]:
        """What is missing or damaged of the corrections that count, one phrase a file."""
        problems = []
        for name, sample in self.samples.items():
            path = self.path(name)
            if path is None:
                continue
            if not path.exists():
                problems.append(f"{path.name} is missing")
            elif check_hashes and storage.file_hash(path) != sample.hashes[sample.current - 1]:
                problems.append(f"{path.name} is damaged")
        return problems

    @property
    def fingerprint(self) -> str:
        """Hash of what counts; the same for two databases of one bake that play alike."""
        counting = {name: each.hashes[each.current - 1] for name, each in self.samples.items() if each.current != BAKED}
        return storage.content_key(counting)

    def _versions(self, sample: str) -> int:
        return len(self.samples[sample].hashes) if sample in self.samples else 0

    def _path(self, sample: str, version: int) -> Path:
        return self.folder / f"{sample}-{self.key}-edit-{version}{storage.ARRAY_SUFFIX}"

    def _with(self, name: str, sample: CorrectedSample) -> Corrections:
        changed = Corrections(self.folder, self.key, {**self.samples, name: sample})
        listed: dict[str, Any] = {
            each: {"current": entry.current, "hashes": list(entry.hashes)} for each, entry in changed.samples.items()
        }
        storage.write_json(_list_path(self.folder, self.key), {"format": FORMAT, "key": self.key, "samples": listed})
        return changed


def _list_path(folder: Path, key: str) -> Path:
    return folder / f"corrections-{key}.json"
