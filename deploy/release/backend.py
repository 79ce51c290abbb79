"""What `pip install .` calls in a checkout or a source archive (PEP 517): maturin, and the programs in its wheel.

Set-up fetches libtorch into .torch/ (544 MB) as for `make build`, unless LIBTORCH names a torch 2.11; cargo compiles
for minutes.
"""

import os
import subprocess
import sys
from pathlib import Path

import maturin
import parts
import sources
import wheel
from maturin import *  # noqa: F403  # the hooks that stay maturin's own

LOCKED = "--locked"


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None):
    """The hook that makes the wheel; its file name."""
    cargo = ["cargo", "build", "--release", LOCKED, "--workspace"]
    programs = [part for name in wheel.PROGRAMS for part in ("--bin", name)]
    library = ["cargo", "build", "--release", LOCKED, "-p", "stillroom_actor"]
    for command in (["deploy/setup"], cargo + programs, library):
        subprocess.run(command, cwd=wheel.ROOT, check=True, env={**os.environ, "PYTHON": sys.executable})
    os.environ.setdefault("MATURIN_PEP517_ARGS", LOCKED)
    name = maturin.build_wheel(wheel_directory, config_settings, metadata_directory)
    target = Path(os.environ.get("CARGO_TARGET_DIR", wheel.ROOT / "target"))
    wheel.complete(Path(wheel_directory, name), target / "release", parts.licences(parts.metadata()))
    return name


def build_sdist(sdist_directory, config_settings=None):
    """The hook that makes the source archive; its file name. maturin's would leave out the programs."""
    if path := sources.write(parts.version(), sdist_directory):
        return path.name
    raise OSError("a source archive is made in a git checkout")
