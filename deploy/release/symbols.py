"""What a program asks of the system that runs it: says what is newer than a release promises.

    python3 deploy/release/symbols.py [--glibc 2.28] FILE|FOLDER...

Exits with 1 and a line for each finding if a file needs a newer symbol, another library, or looks for libraries in a
place of the machine that built it. Reads what `readelf` of the binutils prints. Standard library only, Python 3.8.
"""

import argparse
import re
import subprocess
import sys
from pathlib import Path

GLIBC = "2.28"
# What is on every system with glibc 2.28: GCC 8's libraries. libtorch 2.11 itself needs no more.
NEWEST = {"GLIBCXX": "3.4.25", "CXXABI": "1.3.11", "GCC": "7.0.0"}
LIBRARIES = {
    "ld-linux-x86-64.so.2", "ld-linux-aarch64.so.1",
    "libc.so.6", "libm.so.6", "libpthread.so.0", "libdl.so.2", "librt.so.1", "libutil.so.1",
    "libgcc_s.so.1", "libstdc++.so.6",
    # What set-up brings.
    "libtorch_cpu.so", "libtorch.so", "libc10.so",
}  # fmt: skip


def readelf(option, path):
    done = subprocess.run(["readelf", "--wide", option, str(path)], capture_output=True, text=True)
    if done.returncode != 0 or not done.stdout:
        raise OSError(f"{path}: readelf says: {done.stderr.strip() or 'nothing'}")
    return done.stdout


def numbers(version):
    return tuple(int(part) for part in version.split("."))


def compiled(folder):
    """All programs and libraries in a folder."""
    files = sorted(path for path in Path(folder).rglob("*") if path.is_file() and not path.is_symlink())
    return [path for path in files if is_elf(path)]


def is_elf(path):
    with path.open("rb") as file:
        return file.read(4) == b"\x7fELF"


def needed_versions(path):
    """(library, symbol version) of all that the file needs."""
    needed = set()
    in_needs = False
    library = "?"
    for line in readelf("--version-info", path).splitlines():
        if line.startswith("Version "):
            in_needs = line.startswith("Version needs section")
        elif in_needs:
            if found := re.search(r"File: (\S+)", line):
                library = found.group(1)
            elif found := re.search(r"Name: (\S+)", line):
                needed.add((library, found.group(1)))
    return needed


def findings(path, glibc=GLIBC):
    """A sentence for each thing that a system with this glibc does not have. None: this machine's, with all it has."""
    newest = {"GLIBC": glibc, **NEWEST}
    found = []
    for library, version in sorted(needed_versions(path)) if glibc else []:
        name, _, number = version.partition("_")
        if name not in newest or not re.fullmatch(r"[0-9.]+", number):
            found.append(f"{path} needs {version} of {library}, which no release may need")
        elif numbers(number) > numbers(newest[name]):
            symbols = re.findall(rf"\bUND (\S+)@{re.escape(version)}\b", readelf("--dyn-syms", path))
            found.append(
                f"{path} needs {version} of {library}, newer than {name}_{newest[name]}: {', '.join(sorted(symbols))}"
            )
    dynamic = readelf("--dynamic", path)
    for library in re.findall(r"\(NEEDED\).*\[(.*)\]", dynamic):
        if library not in LIBRARIES:
            found.append(f"{path} needs the library {library}, which neither set-up nor every system has")
    for place in re.findall(r"\((?:RUNPATH|RPATH)\).*\[(.*)\]", dynamic):
        for folder in place.split(":"):
            if not folder.startswith("$ORIGIN"):
                found.append(f"{path} looks for libraries in {folder}, a folder of the machine that built it")
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--glibc", default=GLIBC)
    parser.add_argument("files", nargs="+")
    arguments = parser.parse_args()
    try:
        files = [file for path in arguments.files for file in (compiled(path) if Path(path).is_dir() else [path])]
        found = [finding for path in files for finding in findings(path, arguments.glibc)]
    except OSError as failure:
        sys.exit(f"dist: error: {failure}")
    for finding in found:
        print(f"dist: error: {finding}", file=sys.stderr)
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
