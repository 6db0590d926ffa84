"""The demo's packages: fetched once, checked, kept whole or not at all."""

import hashlib
import shutil
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest
from wrinkle_synthesis.demo import packages
from wrinkle_synthesis.demo.packages import Package, PackageError, package_folder


@pytest.fixture
def wheel(tmp_path: Path) -> Path:
    path = tmp_path / "index" / "sample-1.0-py3-none-any.whl"
    path.parent.mkdir()
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("sample/data/wanted.txt", "kept")
        archive.writestr("sample/data/deep/wanted.json", "{}")
        archive.writestr("sample/data/other.bin", "left out")
        archive.writestr("sample/code.py", "left out")
    return path


@pytest.fixture
def package(wheel: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Package:
    monkeypatch.setenv(packages.CACHE_VARIABLE, str(tmp_path / "cache"))
    checksum = hashlib.sha256(wheel.read_bytes()).hexdigest()
    return Package("sample", "1.0", checksum, "sample/data/", ("wanted.txt", "deep/*.json"), (), "CC0-1.0")


@pytest.fixture
def downloads(wheel: Path, monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """pip's calls, served from the sample wheel."""
    calls: list[list[str]] = []

    def run(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        calls.append(command)
        shutil.copy(wheel, command[command.index("--dest") + 1])
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(packages.subprocess, "run", run)
    return calls


def test_only_the_wanted_files_are_kept(package: Package, downloads: list[list[str]]) -> None:
    folder = package_folder(package)
    found = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    assert found == ["deep/wanted.json", "wanted.txt"]
    assert "sample==1.0" in downloads[0] and "--no-deps" in downloads[0]


def test_a_second_use_downloads_nothing(package: Package, downloads: list[list[str]]) -> None:
    assert package_folder(package) == package_folder(package)
    assert len(downloads) == 1


def test_nothing_but_the_finished_folder_is_left(package: Package, downloads: list[list[str]]) -> None:
    folder = package_folder(package)
    assert list(packages.cache_folder().iterdir()) == [folder]


def test_another_file_than_the_pinned_one_is_refused(package: Package, downloads: list[list[str]]) -> None:
    with pytest.raises(PackageError, match="not the pinned file"):
        package_folder(replace(package, sha256="0" * 64))
    assert list(packages.cache_folder().iterdir()) == []


def test_a_missing_network_is_one_sentence(package: Package, monkeypatch: pytest.MonkeyPatch) -> None:
    def run(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        return subprocess.CompletedProcess(command, 1, "", "WARNING: retrying\nERROR: no connection\n")

    monkeypatch.setattr(packages.subprocess, "run", run)
    with pytest.raises(PackageError, match=r"connect to the network") as caught:
        package_folder(package)
    assert "\n" not in str(caught.value)
    assert "no connection" in str(caught.value)


def test_a_cache_that_cannot_be_written_is_named(
    package: Package, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    monkeypatch.setenv(packages.CACHE_VARIABLE, str(blocked / "cache"))
    with pytest.raises(PackageError, match=packages.CACHE_VARIABLE):
        package_folder(package)


def test_the_key_changes_with_the_files_wanted(package: Package) -> None:
    assert package.key != replace(package, files=("wanted.txt",)).key
