"""What CHANGELOG.md says of a version: the notes of its release.

    python3 deploy/release/changelog.py VERSION [FILE]

Prints the section below `## [VERSION] - DATE`, and exits with 1 where that version cannot be released: it has no such
section, or changes are still listed as unreleased. Standard library only, Python 3.8 or newer.
"""

import re
import sys
from pathlib import Path

CHANGELOG = Path(__file__).resolve().parent.parent.parent / "CHANGELOG.md"
HEADING = re.compile(r"^## (.*)$", re.MULTILINE)


def sections(text):
    """{heading: what stands below it}."""
    parts = HEADING.split(text)[1:]
    return {heading.strip(): below.strip() for heading, below in zip(parts[::2], parts[1::2])}


def notes(text, number):
    """The heading and section of a version, None where there is none."""
    for heading, below in sections(text).items():
        if re.fullmatch(rf"\[{re.escape(number)}\] - \d{{4}}-\d\d-\d\d", heading) and below:
            return f"## {heading}\n\n{below}\n"
    return None


def reservations(text, number):
    """What keeps this version from being released, a sentence each."""
    found = []
    if notes(text, number) is None:
        found.append(f"CHANGELOG.md has no section '## [{number}] - YEAR-MONTH-DAY', or nothing stands below it")
    if sections(text).get("[Unreleased]"):
        found.append("CHANGELOG.md lists changes as unreleased: move them to a version, and name it in Cargo.toml")
    return found


def main():
    if len(sys.argv) not in (2, 3):
        sys.exit(f"usage: {sys.argv[0]} VERSION [FILE]")
    text = (Path(sys.argv[2]) if len(sys.argv) == 3 else CHANGELOG).read_text()
    found = reservations(text, sys.argv[1])
    print(notes(text, sys.argv[1]) or "", end="")
    for reservation in found:
        print(f"dist: not a release: {reservation}", file=sys.stderr)
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
