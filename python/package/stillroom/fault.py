"""What an exception of a user's environment says, in one sentence with its place."""

from __future__ import annotations

import os
import sysconfig
import traceback

PACKAGE = os.path.join(os.path.dirname(__file__), "")
STANDARD = os.path.join(sysconfig.get_path("stdlib"), "")
# Folders of installed packages.
INSTALLED = (f"{os.sep}site-packages{os.sep}", f"{os.sep}dist-packages{os.sep}")


def sentence(error: BaseException) -> str:
    """`the environment's step() raised TypeError: no number (mine.py:14)`."""
    frames = _outside(error)
    called = frames[0].name if frames else ""
    if called == "<module>":
        who = f"importing {_short(frames[0].filename)}"
    else:
        who = f"the environment's {called}()" if called.isidentifier() else "the environment"
    return f"{who} raised {told(error)}"


def told(error: BaseException) -> str:
    """The exception's type, text and place, in one line: the innermost line of the user's own code, or else of a
    package's."""
    text = " ".join(str(error).split())
    frames = _outside(error)
    own = [frame for frame in frames if _is_own(frame.filename)]
    place = f" ({_short((own or frames)[-1].filename)}:{(own or frames)[-1].lineno})" if frames else ""
    return type(error).__name__ + (f": {text}" if text else "") + place


def exited(ended: SystemExit) -> str:
    """`the environment's step() called sys.exit(4) (mine.py:14)`."""
    frames = _outside(ended)
    called = f"{frames[0].name}()" if frames and frames[0].name.isidentifier() else "code"
    place = f" ({_short(frames[-1].filename)}:{frames[-1].lineno})" if frames else ""
    return f"the environment's {called} called sys.exit({'' if ended.code is None else ended.code}){place}"


def a(name: str) -> str:
    """A type's name with its article: `an int`."""
    return f"{'an' if name[:1] in 'aeiou' else 'a'} {name}"


def _outside(error: BaseException) -> list[traceback.FrameSummary]:
    """The frames of its traceback outside of this package and of Python's import."""
    ignored = ("<", PACKAGE, os.path.join(STANDARD, "importlib"))
    frames = traceback.extract_tb(error.__traceback__)
    return [frame for frame in frames if not frame.filename.startswith(ignored)]


def _is_own(file: str) -> bool:
    return not (file.startswith(STANDARD) or any(part in file for part in INSTALLED))


def _short(file: str) -> str:
    """A file's path from the current folder or that of the installed packages, where it is in one."""
    for part in INSTALLED:
        if part in file:
            return file.rpartition(part)[2]
    return file.removeprefix(os.path.join(os.getcwd(), ""))
