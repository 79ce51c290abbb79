"""The programs of Stillroom, which a wheel holds in this folder, and their console commands.

A package of its own, which imports nothing: `stillroom` loads NumPy and the simulator. The learner looks for libtorch in
`../torch/lib`, where pip installs torch.
"""

import os
import sys
from importlib.util import find_spec
from pathlib import Path

_HERE = Path(__file__).resolve().parent


def _become(name):
    program = _HERE / name
    if not program.exists():
        sys.exit(f"{name}: this wheel has no programs: `make dist` makes one that has, and `make build` compiles them")
    beside = (_HERE.parent / "torch/lib/libtorch_cpu.so").exists()
    # A torch of another folder: the system's in a virtual environment that shows it, for one.
    elsewhere = None if beside or os.environ.get("LIBTORCH") else find_spec("torch")
    if elsewhere and elsewhere.origin:
        os.environ["LIBTORCH"] = str(Path(elsewhere.origin).parent)
    if name == "learner" and not (beside or os.environ.get("LIBTORCH")):
        sys.exit("learner: there is no torch 2.11 in this environment: pip install 'stillroom[train]'")
    # As a shell would call it: messages quote it.
    called = Path(sys.argv[0]).name
    on_path = any(Path(folder, called) == Path(sys.argv[0]) for folder in os.environ.get("PATH", "").split(":"))
    os.execv(program, [called if on_path else sys.argv[0], *sys.argv[1:]])


def orchestrator():
    """The command `orchestrator`, and `stillroom`."""
    _become("orchestrator")


def actor():
    """The command `actor`."""
    _become("actor")


def learner():
    """The command `learner`."""
    _become("learner")
