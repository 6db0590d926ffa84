"""The command line's manners: exit codes, one sentence for bad input, one JSON object on request."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from baked_dolls import baked, full_plan
from dolls import doll
from wrinkle_synthesis.wrinkle_addon import cli, folder_verbs, self_test
from wrinkle_synthesis.wrinkle_addon.storage import ARRAY_SUFFIX

SAMPLES = len(full_plan(doll(31, 12)).samples) + 1


@pytest.fixture(scope="module")
def database(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("doll") / "sleeve.wrinkles"
    character = doll(31, 12)
    baked(folder, character, full_plan(character))
    return folder


@pytest.fixture
def verb(monkeypatch: pytest.MonkeyPatch):
    """Let the verb `info` do something else."""

    def stand_in(function) -> None:
        monkeypatch.setattr(folder_verbs, "info", function)

    return stand_in


def test_success_is_0_and_json_is_the_last_thing_printed(wrinkle, database: Path):
    told = wrinkle("info", database)
    assert told.code == 0 and "samples" in told.output
    asked = wrinkle("info", database, "--json")
    assert asked.code == 0 and asked.result["samples"] == SAMPLES
    assert "text" not in asked.result


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([], "The following arguments are required: VERB"),
        (["knit"], "invalid choice: 'knit'"),
        (["setup", "x.blend"], "--garment"),
        (["bake", "--workers", "many"], "invalid int value: 'many'"),
        (["plan", "--quick", "--samples", "4"], "not allowed with"),
        (["info"], "Name the database folder"),
        (["info", "nowhere.wrinkles"], "There is no database"),
        (["doctor", "--device", "cuda:77"], "no device 'cuda:77' here; there is cpu"),
    ],
)
def test_bad_input_is_2_and_one_sentence(wrinkle, arguments: list[str], sentence: str):
    assert sentence in wrinkle(*arguments).complaint


def test_bad_input_is_one_json_object_on_request(wrinkle):
    outcome = wrinkle("info", "nowhere.wrinkles", "--json")
    assert outcome.code == 2 and "There is no database" in outcome.result["error"]


def test_failure_is_1(wrinkle, verb):
    def fail(options: argparse.Namespace) -> None:
        raise RuntimeError("the roof came down")

    verb(fail)
    outcome = wrinkle("info", "x")
    assert outcome.code == 1
    assert outcome.errors.splitlines()[-1] == "wrinkle: RuntimeError: the roof came down"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interruption_is_130(wrinkle, verb, number: signal.Signals):
    verb(lambda options: os.kill(os.getpid(), number))
    before = signal.getsignal(number)
    outcome = wrinkle("info", "x")
    assert (outcome.code, outcome.errors) == (130, "wrinkle: Interrupted.\n")
    assert signal.getsignal(number) == before


def test_help_is_no_error(wrinkle):
    assert wrinkle("--help").code == 0


def test_the_module_is_the_console_script():
    run = subprocess.run(
        [sys.executable, "-m", cli.__name__, "info", "nowhere.wrinkles"], capture_output=True, text=True, check=False
    )
    assert (run.returncode, run.stdout) == (2, "")
    assert run.stderr == "wrinkle: There is no database 'nowhere.wrinkles'.\n"


# --- database folders ---------------------------------------------------------------------------------------------


def test_verify_lists_what_is_missing_and_damaged(wrinkle, database: Path):
    assert wrinkle("verify", database).code == 0
    sample = next(database.glob("elbow_L-0-*"))
    data = sample.read_bytes()
    try:
        sample.write_bytes(data[:-1])
        outcome = wrinkle("verify", database, "--json")
        assert outcome.code == 1 and outcome.result["problems"] == [f"{sample.name} is damaged"]
        sample.unlink()
        assert wrinkle("verify", database, "--json").result["problems"] == [f"{sample.name} is missing"]
    finally:
        sample.write_bytes(data)


def test_merge_says_what_is_still_to_be_baked(wrinkle, database: Path, tmp_path: Path):
    assert "holds no bake" in wrinkle("merge", tmp_path).complaint
    for path in database.iterdir():
        if path.suffix == ARRAY_SUFFIX and not path.name.startswith("elbow_L-0"):
            (tmp_path / path.name).write_bytes(path.read_bytes())
    assert f"1 of {SAMPLES + 1} files" in wrinkle("merge", tmp_path).complaint
    assert wrinkle("verify", tmp_path).code == 1


def test_doctor_lists_devices(wrinkle):
    outcome = wrinkle("doctor", "--json")
    assert outcome.code == 0 and "cpu" in outcome.result["devices"]
    assert Path(outcome.result["kernel_cache"]).is_dir()
    assert set(outcome.result["hardware"]) == set(outcome.result["devices"])


def test_doctor_tries_a_bake_and_a_play_on_request(wrinkle):
    outcome = wrinkle("doctor", "--self-test", "--device", "cpu", "--json")
    assert outcome.code == 0, outcome.output
    assert [(check["name"], check["passed"]) for check in outcome.result["checks"]] == [
        ("kernels", True),
        ("bake", True),
        ("play", True),
    ]
    assert wrinkle("doctor", "--json").result["compiled"]


def test_doctor_says_what_does_not_work(wrinkle, monkeypatch: pytest.MonkeyPatch):
    def fail(folder: Path, device: str) -> tuple[str, bool]:
        raise RuntimeError("no memory")

    monkeypatch.setattr(self_test, "_bake", fail)
    outcome = wrinkle("doctor", "--self-test", "--device", "cpu")
    assert outcome.code == 1
    assert "bake         FAILS" in outcome.output and "RuntimeError: no memory" in outcome.output
    assert "play" not in outcome.output
