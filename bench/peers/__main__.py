"""Measures our simulator and every peer that is installed, one after the other on one core, and prints the table."""

from __future__ import annotations

import argparse
import ctypes.util
import json
import os
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from .measure import Answer
from .shim import Unavailable, build
from .table import Ours, report

#: A program that has not answered after this long hangs.
LIMIT_S = 3600
#: The module that measures a peer, the Python package it needs.
PEERS = {"embree": "embreex", "mujoco_peer": "mujoco", "bullet": "pybullet"}


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="peers", description=__doc__)
    parser.add_argument("--actor", type=Path, required=True, help="our program")
    parser.add_argument("--kitchens", default="all", help="`all`, or numbers with commas between")
    parser.add_argument("--policies", help="policies with commas between; all if left out")
    parser.add_argument("--seconds", type=float, default=0.2, help="processor time for each figure of ours")
    parser.add_argument("--frames", type=int, default=16, help="depth frames of each episode")
    parser.add_argument("--folder", type=Path, help="keep the exported kitchens here")
    parser.add_argument("--json", type=Path, help="write everything that was measured here")
    return parser.parse_args()


def environment(library: Path | None) -> tuple[dict[str, str], str | None]:
    """The environment of every program: one thread, and a way to OpenGL; what is missing for the latter."""
    settings = dict(os.environ)
    for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        settings[threads] = "1"
    # Mesa's software renderer draws in the calling thread.
    settings["LP_NUM_THREADS"] = "0"
    settings["PEERS_EMBREE"] = str(library or "")
    missing = None
    if "MUJOCO_GL" not in settings:
        if ctypes.util.find_library("EGL"):
            settings["MUJOCO_GL"] = "egl"
        elif ctypes.util.find_library("OSMesa"):
            settings["MUJOCO_GL"] = "osmesa"
        else:
            settings["MUJOCO_GL"] = "disabled"
            missing = "MuJoCo's pictures are left out: no EGL (Debian: apt-get install libegl1 libgl1-mesa-dri)"
    return settings, missing


def run(command: list[str | Path], settings: dict[str, str]) -> str:
    """Runs a program and returns what it prints; its errors go to ours."""
    words = [str(word) for word in command]
    print("+", *words, file=sys.stderr, flush=True)
    return subprocess.run(words, env=settings, stdout=subprocess.PIPE, text=True, timeout=LIMIT_S, check=True).stdout


def measure_peer(module: str, folder: Path, settings: dict[str, str]) -> list[Answer]:
    """Runs a peer's program; its answers are the last line that it prints."""
    printed = run([sys.executable, "-m", f"{__package__}.{module}", folder], settings)
    return json.loads(printed.splitlines()[-1])


def compare(options: argparse.Namespace, folder: Path) -> bool:
    """Measures and prints; whether every check holds."""
    which = ["--kitchens", options.kitchens] + (["--policies", options.policies] if options.policies else [])
    skipped = []
    try:
        library = build(folder)
    except Unavailable as error:
        library = None
        skipped.append(f"Embree is left out: {error}")
    settings, missing = environment(library)
    skipped += [missing] if missing else []
    run([options.actor, "export-peers", *which, "--frames", str(options.frames), "--out", folder], settings)
    ours = json.loads(run([options.actor, "bench", *which, "--seconds", str(options.seconds), "--json"], settings))
    answers = []
    for module, package in PEERS.items():
        if find_spec(package) is None:
            skipped.append(f"{package} is not installed: left out")
        elif module != "embree" or library:
            answers.extend(measure_peer(module, folder, settings))
    if options.json:
        options.json.write_text(json.dumps({"ours": ours, "peers": answers}, indent=1))
    policies = json.loads((folder / "index.json").read_text())["policies"]
    text, sound = report(Ours(**ours), answers, policies, skipped)
    print(text)
    return sound


def main() -> int:
    """The program."""
    options = arguments()
    # Everything that is started from here inherits this.
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    with tempfile.TemporaryDirectory(prefix="stillroom-peers-") as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        return 0 if compare(options, folder) else 1


if __name__ == "__main__":
    sys.exit(main())
