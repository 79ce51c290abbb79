"""Packs a release: the wheel, archives of the programs and of the sources, a bill of materials, checksums.

    python3 deploy/release/pack.py --programs target/release --wheels target/wheels --out target/dist

`make dist` calls it with programs that are linked for an older glibc; symbols.py is asked whether all that is packed is.
Prints what keeps the files from being a release. The same programs give the same bytes. Standard library only, Python
3.8 or newer.
"""

import argparse
import gzip
import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

import changelog
import parts
import sources
import symbols
import wheel

ROOT = Path(__file__).resolve().parent.parent.parent
# What a package index takes without asking is more; what people wait for is less.
WHEEL_BYTES_MOST = 40_000_000
TEXTS = ["CHANGELOG.md", "LICENSE-APACHE", "LICENSE-MIT", "README.md", "SECURITY.md"]
FOLDERS = ["scenes", "suites", "models"]
SCRIPTS = ["deploy/setup", "deploy/setup_libtorch.py", "deploy/install"]
COMPLETIONS = {
    "bash": "bash-completion/completions/orchestrator",
    "zsh": "zsh/site-functions/_orchestrator",
    "fish": "fish/vendor_completions.d/orchestrator.fish",
}
SETUP = """#!/bin/sh
# Checks this machine, and fetches libtorch into .torch/ here (544 MB); LIBTORCH=/path takes a torch 2.11 that is there.
exec "$(dirname "$0")/deploy/setup"
"""


class Failed(Exception):
    """One paragraph: what is wrong and what to do."""


def run(*command):
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    if done.returncode != 0:
        raise Failed(f"{Path(str(command[0])).name} {command[1]}: {(done.stderr or done.stdout).strip()}")
    return done.stdout


def stage(programs, folder):
    """Everything of the archive, in `folder`."""
    folder.mkdir()
    for name in wheel.PROGRAMS:
        if not (programs / name).exists():
            raise Failed(f"{programs / name} is not there: `make build` compiles it")
        shutil.copy2(programs / name, folder / name)
        wheel.strip(folder / name)
    for name in TEXTS:
        shutil.copy2(ROOT / name, folder)
    for name in FOLDERS:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name)
    (folder / "deploy").mkdir()
    for name in SCRIPTS:
        shutil.copy2(ROOT / name, folder / name)
    (folder / "setup").write_text(SETUP)
    (folder / "setup").chmod(0o755)
    # The learner looks for its libtorch here.
    (folder / "libtorch").symlink_to(".torch/libtorch")
    run(folder / "orchestrator", "man", folder / "share/man/man1")
    for shell, place in COMPLETIONS.items():
        (folder / "share" / place).parent.mkdir(parents=True)
        (folder / "share" / place).write_text(run(folder / "orchestrator", "completions", shell))


def unpack(packed, work):
    """The files of a wheel, in a folder of its name."""
    if (size := packed.stat().st_size) > WHEEL_BYTES_MOST:
        raise Failed(f"{packed.name} has {size / 1e6:.1f} MB, more than {WHEEL_BYTES_MOST / 1e6:.0f}")
    folder = Path(work) / packed.stem
    with zipfile.ZipFile(packed) as files:
        files.extractall(folder)
    if not symbols.compiled(folder):
        raise Failed(f"{packed.name} has no compiled module in it")
    return folder


def check(folders, glibc):
    """Fails where anything compiled in these folders needs more than a release promises."""
    compiled = [path for folder in folders for path in symbols.compiled(folder)]
    if found := [finding for path in compiled for finding in symbols.findings(path, glibc)]:
        raise Failed("\ndist: error: ".join(found))


def made_at():
    """Seconds since 1970 for all files: of the commit, so that the same sources give the same archive."""
    if given := os.environ.get("SOURCE_DATE_EPOCH"):
        return int(given)
    done = subprocess.run(["git", "log", "-1", "--format=%ct"], cwd=ROOT, capture_output=True, text=True)
    return int(done.stdout) if done.returncode == 0 and done.stdout.strip() else 0


def archive(folder, target):
    moment = made_at()

    def plain(entry):
        entry.uid = entry.gid = 0
        entry.uname = entry.gname = "root"
        entry.mtime = moment
        entry.mode = 0o755 if entry.isdir() or entry.mode & 0o100 else 0o644
        return entry

    with target.open("wb") as raw, gzip.GzipFile("", "wb", 6, raw, mtime=moment) as packed:
        with tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as tar:
            # add() takes a folder's entries in their order by name.
            tar.add(folder, arcname=folder.name, filter=plain)


def digest(path):
    found = hashlib.sha256()
    with path.open("rb") as file:
        for block in iter(lambda: file.read(1 << 20), b""):
            found.update(block)
    return found.hexdigest()


def reservations(said, number, text):
    """What keeps these files from being a release."""
    found = []
    if "+changes" in said:
        found.append("the sources were changed after the commit: commit, and make it again")
    if "(" not in said:
        found.append("the commit is not known: build in a checkout, with make")
    return found + changelog.reservations(text, number)


def pack(programs, wheels, out, glibc, text):
    """`text` is the changelog's."""
    number = parts.version()
    name = f"stillroom-{number}"
    out.mkdir(parents=True, exist_ok=True)
    for path in out.iterdir():
        if path.name.startswith("stillroom-") or path.name == "SHA256SUMS":
            path.unlink()
    data = parts.metadata()
    made = sorted(wheels.glob(f"{name}-*.whl")) if wheels else []
    with tempfile.TemporaryDirectory(dir=out) as work:
        folder = Path(work) / name
        stage(programs, folder)
        (folder / "THIRD-PARTY.txt").write_text(parts.licences(data))
        said = run(folder / "orchestrator", "--version").strip()
        check([folder, *(unpack(path, work) for path in made)], glibc)
        for path in made:
            shutil.copy2(path, out)
        archive(folder, out / f"{name}-{os.uname().machine}-linux-{f'glibc{glibc}' if glibc else 'as-built'}.tar.gz")
    parts.write_bill(data, out / f"{name}.cdx.json")
    if notes := changelog.notes(text, number):
        (out / f"{name}.notes.md").write_text(notes)
    sources.write(number, out)
    files = sorted(path for path in out.iterdir() if path.name.startswith(name))
    (out / "SHA256SUMS").write_text("".join(f"{digest(path)}  {path.name}\n" for path in files))
    print(f"dist: {said}")
    for path in [*files, out / "SHA256SUMS"]:
        print(f"dist: {path} ({path.stat().st_size / 1e6:.1f} MB)")
    found = reservations(said, number, text)
    for reservation in found:
        print(f"dist: not a release: {reservation}", file=sys.stderr)
    return 1 if found and os.environ.get("STRICT") else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--programs", type=Path, required=True)
    parser.add_argument("--wheels", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--glibc", default=symbols.GLIBC)
    parser.add_argument("--as-built", action="store_true", help="programs that are linked for this machine, for a test")
    parser.add_argument("--changelog", type=Path, default=changelog.CHANGELOG)
    arguments = parser.parse_args()
    glibc = None if arguments.as_built else arguments.glibc
    try:
        text = arguments.changelog.read_text()
        sys.exit(pack(arguments.programs, arguments.wheels, arguments.out, glibc, text))
    except (Failed, OSError) as failure:
        sys.exit(f"dist: error: {failure}")


if __name__ == "__main__":
    main()
