"""What the package says of a processor on which its compiled module would die."""

from __future__ import annotations

import platform
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "package/stillroom"


@pytest.mark.skipif(platform.machine() != "x86_64", reason="another processor needs no AVX2")
@pytest.mark.parametrize(("flags", "message"), [("fpu sse2 avx", "a processor with AVX2"), ("fpu avx avx2", None)])
def test_a_processor_without_avx2_is_told_so(flags: str, message: str | None) -> None:
    """Before anything else is imported."""
    program = (
        "import pathlib, runpy\n"
        f"pathlib.Path.read_text = lambda self: 'processor : 0\\nflags : {flags}\\n'\n"
        f"runpy.run_path({str(PACKAGE / '_processor.py')!r})\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode == 0) == (message is None), done.stderr
    assert message is None or f"ImportError: stillroom needs {message}" in done.stderr


def test_it_is_looked_at_before_the_compiled_module_is_loaded() -> None:
    text = (PACKAGE / "__init__.py").read_text()
    assert text.index("import stillroom._processor") < text.index("from stillroom._stillroom import")
