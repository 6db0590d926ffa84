"""One window bakes into a folder at a time, and one that crashed holds nothing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from wrinkle_synthesis.wrinkle_addon.folder_lock import LOCK, FolderLock, is_locked
from wrinkle_synthesis.wrinkle_addon.storage import StorageError

HOLDER = """
import os, sys, time
from pathlib import Path
from wrinkle_synthesis.wrinkle_addon.folder_lock import FolderLock
lock = FolderLock(Path(sys.argv[1]))
print("held", flush=True)
sys.stdin.read()
os._exit(9)
"""


def test_a_second_one_is_told_who_holds_it(tmp_path: Path) -> None:
    with FolderLock(tmp_path):
        with pytest.raises(StorageError, match=rf"Another Blender is baking into .*process {os.getpid()} on "):
            FolderLock(tmp_path)
        assert is_locked(tmp_path)
    assert not (tmp_path / LOCK).exists() and not is_locked(tmp_path)
    FolderLock(tmp_path).close()


def test_the_lock_of_a_process_that_died_is_free(tmp_path: Path) -> None:
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout is not None and holder.stdout.readline() == "held\n"
    with pytest.raises(StorageError, match=f"process {holder.pid}"):
        FolderLock(tmp_path)
    holder.communicate()
    assert holder.returncode == 9 and (tmp_path / LOCK).exists() and not is_locked(tmp_path)
    FolderLock(tmp_path).close()


def test_letting_go_twice_takes_nothing_from_the_next_holder(tmp_path: Path) -> None:
    first = FolderLock(tmp_path)
    first.close()
    with FolderLock(tmp_path):
        first.close()
        assert (tmp_path / LOCK).exists()
