"""Run tests inside a real Blender: ``blender --background --python run_pytest.py -- PACKAGES TESTS``.

PACKAGES is a folder with what Blender's Python lacks; an installed extension's would go when a test loads the factory
settings. The package is imported from this checkout under its own name.
"""

import os
import sys
import tempfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

packages, *tests = sys.argv[sys.argv.index("--") + 1 :]
package = Path(tempfile.mkdtemp())
(package / "wrinkle_synthesis").symlink_to(ROOT)
sys.path[:0] = [str(package), packages]
# For the processes that tests start.
os.environ["PYTHONPATH"] = f"{package}:{packages}"
os.chdir(ROOT)
code = pytest.main(["-p", "no:cacheprovider", *tests])
sys.stdout.flush()
os._exit(code)
