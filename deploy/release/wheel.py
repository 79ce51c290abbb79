"""Puts the programs, the library for simulators in other languages, and the policy that `play` shows, into a wheel of the
Python package.

    python3 deploy/release/wheel.py --programs target/release WHEEL

maturin makes wheels of one library or of one program: WHEEL is what it made of the library, and is replaced. The same
files give the same bytes. Standard library only, Python 3.8 or newer.
"""

import argparse
import base64
import hashlib
import os
import re
import shutil
import subprocess
import tempfile
import zipfile
from pathlib import Path

import parts

ROOT = Path(__file__).resolve().parent.parent.parent
PROGRAMS = ["orchestrator", "actor", "learner"]
# The package of the console commands; the learner in it finds the torch beside it.
PACKAGE = "stillroom_programs"
RUN_PATH = b"$ORIGIN/../torch/lib"
POLICY = "models/fetch.safetensors"
LIBRARY = "libstillroom_actor.so"
# Of the processor that is built for.
STRIP = os.environ.get("STRIP", "strip")
HEADER = "actor/c/include/stillroom_actor.h"


def strip(program, run_path=b"$ORIGIN/libtorch/lib"):
    """Takes line tables out of a program, and out of its run path the folder of the machine that built it."""
    subprocess.run([STRIP, str(program)], check=True)
    data = program.read_bytes()
    found = list(re.finditer(rb"\$ORIGIN/libtorch/lib(:[^\0]*)?\0", data))
    # The learner has one: without it, it finds no libtorch.
    has_none = program.name == "learner" and not found
    if has_none or len(found) > 1 or any(len(place[0]) <= len(run_path) for place in found):
        raise OSError(f"{program.name} has several run paths, a short one, or none")
    for place in found:
        begin, end = place.span()
        program.write_bytes(data[:begin] + run_path + bytes(end - begin - len(run_path)) + data[end:])


def recorded(name, data):
    """The line of a file in RECORD."""
    digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
    return f"{name},sha256={digest},{len(data)}"


def complete(wheel, programs, third_party):
    """Adds programs, library, policy and the licences of what they link to this wheel."""
    made = wheel.with_suffix(".part")
    with zipfile.ZipFile(wheel) as old, zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as new:
        record = next(name for name in old.namelist() if name.endswith(".dist-info/RECORD"))
        lines = []

        def add(name, data, entry=None, mode=0o644):
            if entry is None:
                entry = zipfile.ZipInfo(name, old.getinfo(record).date_time)
                entry.external_attr = (0o100000 | mode) << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            new.writestr(entry, data)
            lines.append(recorded(name, data))

        for entry in old.infolist():
            # A wheel of `make python` has the library of that machine.
            if entry.filename != record and not entry.filename.startswith("stillroom/c/"):
                add(entry.filename, old.read(entry), entry)
        with tempfile.TemporaryDirectory() as work:
            for name in PROGRAMS:
                program = Path(work, name)
                shutil.copy2(programs / name, program)
                strip(program, RUN_PATH)
                add(f"{PACKAGE}/{name}", program.read_bytes(), mode=0o755)
            library = Path(work, LIBRARY)
            shutil.copy2(programs / LIBRARY, library)
            subprocess.run([STRIP, str(library)], check=True)
            add(f"stillroom/c/{LIBRARY}", library.read_bytes(), mode=0o755)
        add(f"stillroom/c/{Path(HEADER).name}", (ROOT / HEADER).read_bytes())
        add(f"{PACKAGE}/{POLICY}", (ROOT / POLICY).read_bytes())
        add(record.replace("RECORD", "licenses/THIRD-PARTY.txt"), third_party.encode())
        new.writestr(old.getinfo(record), "\n".join([*lines, f"{record},,", ""]))
    made.replace(wheel)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--programs", type=Path, required=True)
    parser.add_argument("wheel", type=Path)
    arguments = parser.parse_args()
    complete(arguments.wheel, arguments.programs, parts.licences(parts.metadata()))


if __name__ == "__main__":
    main()
