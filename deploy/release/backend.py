"""What `pip install .` and `make dist` call to make a wheel (PEP 517): maturin, and the programs in its wheel.

Set-up fetches libtorch into .torch/ (544 MB) as for `make build`, unless LIBTORCH names a torch 2.11; cargo compiles
for minutes.

    python3 deploy/release/backend.py FOLDER
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
# As python/cross names it, for a build for another processor.
TARGET = os.environ.get("CARGO_BUILD_TARGET", "")
MACHINE = TARGET.split("-")[:1] if TARGET else []


def run(*command):
    """A step of the build. What it prints says what is missing, and is the last that is read."""
    if subprocess.run(command, cwd=wheel.ROOT).returncode != 0:
        sys.exit(f"stillroom: error: `{' '.join(command)}` failed: see above")


def set_up():
    os.environ["PYTHON"] = sys.executable
    run("deploy/setup", *MACHINE)
    commit = subprocess.run(["deploy/commit"], cwd=wheel.ROOT, capture_output=True, text=True)
    os.environ.setdefault("STILLROOM_COMMIT", commit.stdout.strip())
    os.environ.setdefault("MATURIN_PEP517_ARGS", LOCKED)


def get_requires_for_build_wheel(config_settings=None):
    """None: maturin would fetch a Rust where there is none. Set-up says which one is needed."""
    return []


def prepare_metadata_for_build_wheel(metadata_directory, config_settings=None):
    """The hook that pip calls first; the folder's name."""
    set_up()
    return maturin.prepare_metadata_for_build_wheel(metadata_directory, config_settings)


def build_wheel(wheel_directory, config_settings=None, metadata_directory=None):
    """The hook that makes the wheel; its file name."""
    set_up()
    cargo = ("cargo", "build", "--release", LOCKED)
    run(*cargo, "--workspace", *(part for name in wheel.PROGRAMS for part in ("--bin", name)))
    run(*cargo, "-p", "stillroom_actor")
    name = maturin.build_wheel(wheel_directory, config_settings, metadata_directory)
    target = Path(os.environ.get("CARGO_TARGET_DIR", wheel.ROOT / "target"))
    wheel.complete(Path(wheel_directory, name), target / TARGET / "release", parts.licences(parts.metadata()))
    return name


def build_sdist(sdist_directory, config_settings=None):
    """The hook that makes the source archive; its file name. maturin's would leave out the programs."""
    if path := sources.write(parts.version(), sdist_directory):
        return path.name
    raise OSError("a source archive is made in a git checkout")


if __name__ == "__main__":
    build_wheel(sys.argv[1])
