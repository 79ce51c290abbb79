"""Builds the few lines of C through which Embree is called."""

from __future__ import annotations

import shutil
import subprocess
from importlib.util import find_spec
from pathlib import Path


class Unavailable(Exception):
    """A peer cannot be measured here; the message says why."""


def build(folder: Path) -> Path:
    """Compiles the library into `folder` against the Embree that embreex brings; returns its path."""
    spec = find_spec("embreex")
    if spec is None or spec.origin is None:
        raise Unavailable("embreex is not installed")
    compiler = shutil.which("cc")
    if compiler is None:
        raise Unavailable("there is no C compiler (Debian: apt-get install gcc libc6-dev)")
    libraries = Path(spec.origin).parent.parent / "embreex.libs"
    embree = next(libraries.glob("libembree4*"), None)
    if embree is None:
        raise Unavailable(f"embreex brings no Embree in {libraries}")
    source = Path(__file__).with_name("embree_packets.c")
    library = folder / "libpeers_embree.so"
    command = [compiler, "-O3", "-march=native", "-Wall", "-Wextra", "-shared", "-fPIC", str(source), str(embree)]
    command += [f"-Wl,-rpath,{libraries}", f"-Wl,-rpath-link,{libraries}", "-o", str(library)]
    compiled = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    if compiled.returncode != 0:
        raise Unavailable(f"{source.name} could not be compiled:\n{compiled.stderr}")
    return library
