"""Corrections of samples go back and forth with Blender's undo, though they lie on disk and not in the file.

A garment remembers which versions of which samples were chosen in its file. Undo brings back what it remembered
before; the step from the one memory to the other is then taken in the database's folder, too. Versions that somebody
else has chosen meanwhile are left alone, and none is ever removed: all that changes is which one counts.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import bpy

from ..corrections import BAKED, Corrections
from ..database import WrinkleDatabase
from . import playback

Versions = dict[str, tuple[int, int]]
"""By a sample's name: the version before it was first changed in this file, and the one that was chosen last."""

problems: dict[int, str] = {}
"""Why the last undo could not be followed, by the session_uid of the garment."""

_before: dict[int, str] = {}
"""What garments remembered when an undo or a redo began, by session_uid."""


def note_versions(garment: bpy.types.Object, before: Corrections, after: Corrections, samples: Sequence[str]) -> None:
    """Remember that other versions of some samples count from now on."""
    known = _read(garment.wrinkles.corrections, after.key)
    for name in samples:
        old, new = _current(before, name), _current(after, name)
        first, last = known.get(name, (old, old))
        known[name] = (first if last == old else old, new)
    garment.wrinkles.corrections = json.dumps({"key": after.key, "samples": known})
    problems.pop(garment.session_uid, None)


def begin_undo() -> None:
    """An undo or a redo begins."""
    _before.clear()
    _before.update({ob.session_uid: ob.wrinkles.corrections for ob in bpy.data.objects if ob.type == "MESH"})


def follow_undo() -> None:
    """An undo or a redo is done: let the versions count that the garments remember now."""
    for garment in list(bpy.data.objects):
        if garment.type != "MESH" or _before.get(garment.session_uid, garment.wrinkles.corrections) == (
            garment.wrinkles.corrections
        ):
            continue
        problems.pop(garment.session_uid, None)
        try:
            _step(garment, _before[garment.session_uid], garment.wrinkles.corrections)
        except ValueError as error:
            problems[garment.session_uid] = f"The correction could not be undone. {error}"
    _before.clear()


def _step(garment: bpy.types.Object, before: str, after: str) -> None:
    if not garment.wrinkles.database:
        return
    database = WrinkleDatabase.open(Path(bpy.path.abspath(garment.wrinkles.database)))
    old, new = _read(before, database.header.key), _read(after, database.header.key)
    samples = {sample.name: sample for sample in database.header.plan.samples}
    for name in old.keys() | new.keys():
        version = version_after(old.get(name), new.get(name), _current(database.corrections, name))
        if version is not None and name in samples:
            database.restored(samples[name], version)
    play_anew(database.folder)


def version_after(before: tuple[int, int] | None, after: tuple[int, int] | None, now: int) -> int | None:
    """The version of a sample that counts after an undo or a redo; None if it is not for this file to say.

    Args:
        before, after: What the file remembered of the sample, and remembers now; None for nothing.
        now: The version that counts on disk.
    """
    if before is not None and after is not None and before[0] == after[0]:
        return after[1] if now == before[1] else None
    if before is not None and now == before[1]:
        return before[0]
    if after is not None and now == after[0]:
        return after[1]
    return None


def play_anew(folder: Path) -> None:
    """Let every garment that plays a database read it again."""
    for ob in bpy.data.objects:
        if ob.type == "MESH" and ob.wrinkles.database and Path(bpy.path.abspath(ob.wrinkles.database)) == folder:
            playback.forget(ob)
            ob.update_tag()


def _read(text: str, key: str) -> Versions:
    """What was remembered of the bake of this key."""
    data = json.loads(text or "{}")
    return {name: (pair[0], pair[1]) for name, pair in data["samples"].items()} if data.get("key") == key else {}


def _current(corrections: Corrections, sample: str) -> int:
    known = corrections.samples.get(sample)
    return BAKED if known is None else known.current
