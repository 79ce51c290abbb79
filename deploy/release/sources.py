"""The source archive: the files of the commit, from which `pip install .` builds where Rust is.

Standard library and git only, Python 3.8 or newer.
"""

import gzip
import io
import subprocess
import tarfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent


def write(version, folder):
    """Writes the archive of the commit into a folder; its path, or none outside of a git checkout."""
    name = f"stillroom-{version}"
    archived = subprocess.run(["git", "archive", f"--prefix={name}/", "HEAD"], cwd=ROOT, capture_output=True)
    if archived.returncode != 0:
        return None
    path = Path(folder, f"{name}.tar.gz")
    with path.open("wb") as raw, gzip.GzipFile("", "wb", 9, raw, mtime=0) as packed:
        with tarfile.open(fileobj=io.BytesIO(archived.stdout)) as old, tarfile.open(fileobj=packed, mode="w") as new:
            for entry in old:
                new.addfile(entry, old.extractfile(entry) if entry.isfile() else None)
            # What marks a source archive of Python's.
            text = f"Metadata-Version: 2.1\nName: stillroom\nVersion: {version}\n".encode()
            entry = tarfile.TarInfo(f"{name}/PKG-INFO")
            entry.size = len(text)
            new.addfile(entry, io.BytesIO(text))
    return path
