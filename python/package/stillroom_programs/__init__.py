"""The programs of Stillroom, which a wheel holds in this folder, and their console commands.

A package of its own, which imports nothing: `stillroom` loads NumPy and the simulator. The learner looks for libtorch
in `../torch/lib`, where pip installs torch.
"""

import os
import shutil
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import NoReturn

_HERE = Path(__file__).resolve().parent


def _become(name: str) -> NoReturn:
    program = _HERE / name
    if not program.exists():
        # A wheel of `make python`: another installation's program may be there.
        here = Path(sys.argv[0]).resolve().parent
        folders = [folder for folder in os.environ.get("PATH", "").split(os.pathsep) if Path(folder).resolve() != here]
        other = shutil.which(name, path=os.pathsep.join(folders))
        # Another wheel without programs passes it on to this one again.
        if other is None or os.environ.get("STILLROOM_PASSED_ON"):
            sys.exit(
                f"{name}: this wheel has no programs: `make dist` makes one that has, `make install` compiles them"
            )
        os.environ["STILLROOM_PASSED_ON"] = "yes"
        os.execv(other, [other, *sys.argv[1:]])
    beside = (_HERE.parent / "torch/lib/libtorch_cpu.so").exists()
    # A torch of another folder: the system's in a virtual environment that shows it, for one.
    elsewhere = None if beside or os.environ.get("LIBTORCH") else find_spec("torch")
    if elsewhere and elsewhere.origin:
        os.environ["LIBTORCH"] = str(Path(elsewhere.origin).parent)
    if name == "learner" and not beside:
        torch = os.environ.get("LIBTORCH")
        if not torch:
            sys.exit("learner: there is no torch 2.11 in this environment: pip install 'stillroom[train]'")
        # As the orchestrator does for its learners.
        folders = [f"{torch}/lib", os.environ.get("LD_LIBRARY_PATH")]
        os.environ["LD_LIBRARY_PATH"] = os.pathsep.join(filter(None, folders))
    # Messages quote the command: by its name, where a shell finds it by that.
    called = Path(sys.argv[0])
    os.execv(program, [called.name if shutil.which(called.name) == str(called) else str(called), *sys.argv[1:]])


def orchestrator() -> NoReturn:
    """The commands `stillroom` and `orchestrator`."""
    _become("orchestrator")


def actor() -> NoReturn:
    """The command `actor`."""
    _become("actor")


def learner() -> NoReturn:
    """The command `learner`."""
    _become("learner")
