"""Build the documents as a site into build/site; a broken link ends it, and so does a page that loads from elsewhere.

The site's builder has an environment of its own, .venv-docs, so that nobody needs it to run or test the project.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

from prepare import ROOT, build_environment, find_python, interpreter

SITE = ROOT / "build" / "site"
LOADED = re.compile(r"<(?:script|img|iframe|link)\b[^>]*\b(?:src|href)=\"?(?:https?:)?//[^\"\s>]+", re.IGNORECASE)
"""What a browser fetches from another place on its own account; links that a reader follows are none."""


def main() -> None:
    venv = ROOT / ".venv-docs"
    build_environment(find_python(), venv, ["--group", f"{ROOT / 'pyproject.toml'}:docs"])
    command = [str(interpreter(venv)), "-m", "mkdocs", "build", "--strict", "--quiet", "--clean"]
    # The theme's maker advertises its next product otherwise.
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    if subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode:
        sys.exit("docs: the site was not built")
    foreign = [f"{page.relative_to(SITE)}: {tag}" for page in sorted(SITE.rglob("*.html")) for tag in loaded(page)]
    if foreign:
        sys.exit("docs: these pages load from elsewhere:\n" + "\n".join(foreign))
    print(f"{(SITE / 'index.html').relative_to(ROOT)}: {len(list(SITE.glob('*.html')))} pages")


def loaded(page: Path) -> list[str]:
    """Tags of a page that fetch from another place."""
    return LOADED.findall(page.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
