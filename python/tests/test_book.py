"""The blocks of Python in the book run as they stand, each page's in its order and in one program."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from conftest import REPOSITORY

BLOCK = re.compile(r"^```python,run\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PAGES = sorted(path for path in (REPOSITORY / "docs").glob("*.md") if BLOCK.search(path.read_text(encoding="utf-8")))


def test_there_are_pages() -> None:
    assert [page.name for page in PAGES] == ["depth.md", "python.md"]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_the_blocks_of_a_page_run(page) -> None:
    blocks = BLOCK.findall(page.read_text(encoding="utf-8"))
    command = [sys.executable, "-c", "\n".join(blocks)]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
