"""A run from a script or a notebook: `stillroom.train`."""

from __future__ import annotations

import builtins
import dis
import inspect
import json
import os
import re
import shutil
import subprocess
import sys
import textwrap
import time
import weakref
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stillroom._stillroom import shown, whole
from stillroom.checkpoint import Checkpoint, load
from stillroom.run import RunError, read_progress, read_run

if TYPE_CHECKING:
    import pandas as pd

# Between two looks whether a run has begun or ended, seconds.
LOOKS_EVERY_S = 0.1
# Bytes of complaints that are read.
SAYS_MOST = 1 << 20
# Of the line by which `up` says why it ends.
ERROR = "error: "
TIP = "tip: "


class Training:
    """A run that `train` has started. It goes on when this object is gone, or this process."""

    def __init__(self, path: Path, orchestrator: str, process: subprocess.Popen[bytes], said: int) -> None:
        self.path = path
        self._orchestrator, self._process, self._said = orchestrator, process, said
        weakref.finalize(self, os.close, said)

    def __repr__(self) -> str:
        """Where it is, and how far."""
        state = "running" if self.is_running else "ended"
        return f"<{state}: {self.path}, {self.frames} of {self.budget} frames>"

    @property
    def is_running(self) -> bool:
        """Whether it goes on."""
        return self._process.poll() is None

    @property
    def frames(self) -> int:
        """Frames that it has trained on."""
        return read_progress(self.path)[0]

    @property
    def budget(self) -> int:
        """Frames that it is to have."""
        return read_progress(self.path)[1]

    @property
    def progress(self) -> float:
        """The share of its frames that it has trained on, from 0 to 1."""
        frames, budget = read_progress(self.path)
        return frames / budget

    @property
    def metrics(self) -> pd.DataFrame:
        """A row for each rollout so far; needs pandas. `stillroom.read_run(training.path)` has more."""
        return read_run(self.path).metrics

    def load(self) -> Checkpoint:
        """The policy of the newest checkpoint: `training.load().network()` is it in PyTorch."""
        return load(self.path)

    def stop(self) -> None:
        """Has the run save a checkpoint and end; `stillroom resume` goes on with it."""
        if self.is_running:
            done = subprocess.run(
                [self._orchestrator, "stop", str(self.path)], capture_output=True, text=True, check=False
            )
            if done.returncode and self.is_running:
                raise RunError(_reason(done.stderr) or f"`orchestrator stop` ended with {done.returncode}")
        self.wait()

    def wait(self, timeout_s: float | None = None) -> Training:
        """Waits until the run has ended; a TimeoutError if it has not in time, a RunError if it has failed."""
        try:
            status = self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            raise TimeoutError(f"{self.path} has not ended within {timeout_s} s") from None
        if status:
            text = os.pread(self._said, SAYS_MOST, 0).decode(errors="replace")
            raise RunError(_reason(text) or self._unsaid(status, text))
        return self

    def _unsaid(self, status: int, text: str) -> str:
        """Why it has ended, where `orchestrator` does not say so in its own words: it may be no program of ours."""
        lines = [line for line in text.splitlines() if line.strip()]
        if self.path.exists() or not lines:
            return f"`orchestrator up` ended with {status}: orchestrator logs {self.path}"
        return f"`{self._orchestrator} up` ended with {status}: {lines[-1]}"


def train(
    make_env: str | Callable[..., Any],
    *,
    frames: int,
    run: str | PathLike[str] | None = None,
    env_kwargs: Mapping[str, Any] | None = None,
    settings: Mapping[str, Any] | None = None,
    options: Sequence[str] = (),
    orchestrator: str = "orchestrator",
) -> Training:
    """Starts a run on environments of your own, and returns when it has begun. Whatever is wrong is a RunError.

    Args:
        make_env: a function that makes an environment, or its name as `stillroom up --env` takes it. Actors are
            processes of their own: they import the function from its file, which must not train when it is imported
            (`if __name__ == "__main__":`). One of a notebook is written to a file beside the run, and so imports within
            itself all that it uses.
        frames: to train on.
        run: the run's folder, which is made; otherwise one in `runs/`, named by the time.
        env_kwargs: keyword arguments for `make_env`: what JSON can say.
        settings: by name, such as {"ppo.learning_rate": 1e-3} (docs/settings.md).
        options: further words for `stillroom up`, such as ["--seed", "7", "--actors", "4"].
        orchestrator: the program.
    """
    # A notebook's interpreter does not activate its environment.
    program = shutil.which(orchestrator) or shutil.which(Path(sys.executable).with_name(orchestrator))
    if program is None:
        raise RunError(
            f"there is no program `{orchestrator}`: install a wheel that has it, or name it: orchestrator=..."
        )
    if isinstance(options, str):
        raise RunError(f"options is {shown(options)}: give a list of words")
    frames = whole("frames", frames, 2**63 - 1, 1)
    path = Path(run) if run is not None else Path("runs") / time.strftime("%Y%m%d-%H%M%S-train")
    if path.exists():
        raise RunError(f"{path} is there already: give another folder, or `stillroom resume {path}`")
    env = make_env if isinstance(make_env, str) else _place(make_env, path)
    command = [program, "up", "--run", str(path), "--frames", str(frames), "--env", env, "--python", sys.executable]
    if env_kwargs:
        command += ["--env-kwargs", _json("env_kwargs", dict(env_kwargs))]
    for name, value in (settings or {}).items():
        command += ["--set", f"{name}={_toml(name, value)}"]
    # A file in memory: the run's process goes on writing when this one is gone.
    said = os.memfd_create("orchestrator up")
    process = subprocess.Popen([*command, *options], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=said)
    training = Training(path, program, process, said)
    while not (path / "config.toml").exists():
        if not training.is_running:
            training.wait()
            raise RunError(f"`orchestrator up` has ended without a run in {path}")
        time.sleep(LOOKS_EVERY_S)
    return training


def _toml(name: str, value: Any) -> str:
    """TOML's tables within a value are not JSON's."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{json.dumps(key)} = {_toml(name, inner)}" for key, inner in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(name, inner) for inner in value) + "]"
    return _json(name, value)


def _json(name: str, value: Any) -> str:
    try:
        return json.dumps(value)
    except (TypeError, ValueError) as error:
        raise RunError(f"{name}: {error}") from error


def _reason(text: str) -> str:
    """What `orchestrator` says last of all that is wrong, and its tip."""
    _, is_there, last = f"\n{text}".rpartition(f"\n{ERROR}")
    lines = last.splitlines() if is_there else []
    tips = [line.strip() for line in lines if line.strip().startswith(TIP)]
    return "; ".join(lines[:1] + tips)


def _place(make_env: Callable[..., Any], run: Path) -> str:
    """How other processes find a function."""
    name = getattr(make_env, "__qualname__", "")
    if not inspect.isfunction(make_env) or not name.isidentifier():
        raise RunError(f"make_env is {shown(make_env)}: give a function with a name of its own, not inside another")
    module = sys.modules[make_env.__module__]
    file = getattr(module, "__file__", None)
    if file is None:
        return _written(make_env, name, run)
    is_script = make_env.__module__ == "__main__"
    return (
        f"{Path(file).absolute()}:{name}" if is_script or not _is_installed(file) else f"{make_env.__module__}:{name}"
    )


def _is_installed(file: str) -> bool:
    return "site-packages" in Path(file).parts


def _written(make_env: Callable[..., Any], name: str, run: Path) -> str:
    """A notebook's function in a file of its own, which a resumed run needs, too."""
    read = {word.argval for word in dis.get_instructions(make_env) if word.opname == "LOAD_GLOBAL"}
    used = {word for word in read if not hasattr(builtins, word)} | set(make_env.__code__.co_freevars)
    if used:
        word = min(used)
        raise RunError(f"make_env uses `{word}` of the notebook, which actors do not have: import it within make_env")
    file = run.with_name(re.sub(r"\W", "_", run.name) + "_env.py").absolute()
    file.parent.mkdir(parents=True, exist_ok=True)
    try:
        text = textwrap.dedent(inspect.getsource(make_env))
    except OSError as error:
        raise RunError(f"the source of make_env is not to be had: {error}. Put it into a file") from error
    if file.exists() and file.read_text() != text:
        raise RunError(f"{file} is there already, with something else: name another run")
    file.write_text(text)
    return f"{file}:{name}"
