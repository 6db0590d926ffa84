"""Which coarse simulation this is: told by its source, so that no change of it can be forgotten.

A cache holds the motion of the solver that made it. Frames of two solvers do not follow each other, so another source
is another solver, even where only its words changed.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from . import storage

PACKAGE = Path(__file__).parent.parent
KERNELS = "kernels/cloth"
HOST = (
    *("body_proxy", "cloth_contact", "cloth_model", "coarse_contact", "coarse_layers", "coarse_simulation"),
    *(
        "elastic_elements",
        "elasticity",
        "fabrics",
        "facing",
        "launch_graph",
        "linear_solver",
        "plate_bending",
        "time_integration",
        "topology",
    ),
    "wearer",
)
"""Modules beside this one that shape the motion of a coarse simulation; two of them, what it is given."""


@cache
def source_version() -> str:
    """Hash of all source that shapes the motion of a coarse simulation, 16 hexadecimal digits."""
    return storage.content_key({name: path.read_text("utf-8") for name, path in sources().items()})


def sources() -> dict[str, Path]:
    """That source by its path within the package."""
    files = [*sorted((PACKAGE / KERNELS).glob("*.py")), *(Path(__file__).with_name(f"{name}.py") for name in HOST)]
    return {path.relative_to(PACKAGE).as_posix(): path for path in files}
