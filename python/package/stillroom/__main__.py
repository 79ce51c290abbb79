"""`python -m stillroom serve SPEC`: see `stillroom.serving`."""

import sys

from stillroom.serving import main

if sys.argv[1:2] != ["serve"]:
    sys.exit("usage: python -m stillroom serve gymnasium:ID | envpool:ID | package.module:function | file.py:function")
main(sys.argv[2:])
