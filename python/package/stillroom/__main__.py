"""`python -m stillroom serve SPEC`: see `stillroom.serving`. `python -m stillroom flags` prints a C compiler's."""

import sys
from pathlib import Path

from stillroom.serving import main

match sys.argv[1:]:
    case ["serve", *rest]:
        main(rest)
    case ["flags"]:
        folder = Path(__file__).parent / "c"
        if not (folder / "libstillroom_actor.so").exists():
            sys.exit(
                "stillroom: error: this package has no libstillroom_actor.so: `make install` puts one under PREFIX"
            )
        print(f"-I{folder} -L{folder} -Wl,-rpath,{folder} -lstillroom_actor")
    case _:
        sys.exit(
            "usage: python -m stillroom serve gymnasium:ID | envpool:ID | package.module:function | file.py:function\n"
            "       python -m stillroom flags"
        )
