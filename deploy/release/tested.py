"""A wheel of the module and the library that `make library` compiled, for `make test-python`. maturin would compile the
module's crates once more, alone and so with other features.

    python3 deploy/release/tested.py FOLDER
"""

import os
import shutil
import sys
import tempfile
from pathlib import Path

import maturin
import wheel

BUILD = Path("target/release")


def main():
    wheels = Path(sys.argv[1]).resolve()
    os.chdir(wheel.ROOT)
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work, "wheel")
        shutil.copytree("python/package", folder, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy2(BUILD / "lib_stillroom.so", folder / "stillroom/_stillroom.abi3.so")
        (folder / "stillroom/c").mkdir()
        shutil.copy2(BUILD / wheel.LIBRARY, folder / "stillroom/c")
        shutil.copy2(wheel.HEADER, folder / "stillroom/c")
        information = folder / maturin.prepare_metadata_for_build_wheel(str(folder))
        tag = (information / "WHEEL").read_text().split("Tag: ")[1].strip()
        files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
        lines = [wheel.recorded(path.relative_to(folder), path.read_bytes()) for path in files]
        Path(information, "RECORD").write_text("\n".join([*lines, f"{information.name}/RECORD,,", ""]))
        name = f"{information.stem}-{tag}.whl"
        shutil.move(shutil.make_archive(Path(work, name), "zip", folder), wheels / name)


if __name__ == "__main__":
    main()
