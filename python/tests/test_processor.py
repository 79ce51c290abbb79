"""What the package says of a processor on which its compiled module would die."""

from __future__ import annotations

import platform
import subprocess
import sys
from pathlib import Path

import pytest

SOURCES = Path(__file__).resolve().parents[1] / "package"

# Imports the package on a processor with these flags; the compiled module is not loaded, but said to be.
PROGRAM = """
import pathlib, sys
read_text = pathlib.Path.read_text
def told(path, *arguments, **options):
    return "processor : 0\\nflags : {flags}\\n" if str(path) == "/proc/cpuinfo" else read_text(path, *arguments, **options)
class Watch:
    def find_spec(self, name, path=None, target=None):
        if name == "stillroom._stillroom":
            sys.exit("the compiled module is loaded")
pathlib.Path.read_text = told
sys.meta_path.insert(0, Watch())
sys.path.insert(0, {sources!r})
import stillroom
"""


@pytest.mark.skipif(platform.machine() != "x86_64", reason="another processor needs no AVX2")
@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("fpu sse2 avx", "ImportError: stillroom needs a processor with AVX2"),
        ("fpu avx avx2", "the compiled module is loaded"),
    ],
)
def test_a_processor_without_avx2_is_told_so_before_the_compiled_module_is_loaded(flags: str, message: str) -> None:
    program = PROGRAM.format(flags=flags, sources=str(SOURCES))
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert done.stderr.strip().splitlines()[-1].startswith(message), done.stderr
