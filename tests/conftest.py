"""What all tests share: builders beside this file, and the devices that kernels are tested on."""

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import warp as wp
from wrinkle_synthesis.wrinkle_addon import cli

sys.path.insert(0, str(Path(__file__).parent))

wp.config.log_level = wp.LOG_WARNING


@pytest.fixture(scope="session", params=["cpu", "cuda:0"])
def device(request: pytest.FixtureRequest) -> str:
    """Every Warp device there is, one after the other."""
    if request.param != "cpu" and not wp.is_cuda_available():
        pytest.skip("There is no CUDA device here.")
    return request.param


@dataclass(frozen=True)
class Outcome:
    """How a verb ended.

    Attributes:
        code: Exit code.
        output, errors: What it printed.
    """

    code: int
    output: str
    errors: str

    @property
    def result(self) -> dict[str, Any]:
        """The JSON object that was printed last."""
        return json.loads(self.output.splitlines()[-1])

    @property
    def complaint(self) -> str:
        """The one sentence on standard error of a verb that was given bad input."""
        assert self.code == cli.BAD_INPUT, self
        (line,) = self.errors.splitlines()
        assert line.startswith("wrinkle: ") and line.endswith("."), line
        return line.removeprefix("wrinkle: ")


@pytest.fixture
def wrinkle(capsys: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    """The command line, in this process."""

    def run(*arguments: object) -> Outcome:
        capsys.readouterr()
        code = cli.main([str(argument) for argument in arguments])
        captured = capsys.readouterr()
        return Outcome(code, captured.out, captured.err)

    return run
