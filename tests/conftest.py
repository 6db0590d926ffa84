"""What all tests share: builders beside this file, and the devices that kernels are tested on."""

import sys
from pathlib import Path

import pytest
import warp as wp

sys.path.insert(0, str(Path(__file__).parent))

wp.config.quiet = True


@pytest.fixture(scope="session", params=["cpu", "cuda:0"])
def device(request: pytest.FixtureRequest) -> str:
    """Every Warp device there is, one after the other."""
    if request.param != "cpu" and not wp.is_cuda_available():
        pytest.skip("There is no CUDA device here.")
    return request.param
