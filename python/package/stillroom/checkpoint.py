"""Checkpoints of runs: their weights as numpy arrays, and with torch the network that they belong to."""

from __future__ import annotations

import json
import re
import warnings
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save

from stillroom._stillroom import CheckpointError, read_checkpoint, read_policy, shown, whole
from stillroom.spaces import flag

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib  # type: ignore[no-redef]

if TYPE_CHECKING:
    from stillroom.network import Network

# In a checkpoint the names of the weights begin so; beside them lie Adam's moments, beliefs and environments.
PREFIX = "model."
# Of the types of safetensors those that numpy has; BF16 is widened by hand.
TYPES = {
    **{f"{kind}{bits}": f"<{kind.lower()}{bits // 8}" for kind in "IU" for bits in (8, 16, 32, 64)},
    **{"F16": "<f2", "F32": "<f4", "F64": "<f8", "BF16": "<u2", "BOOL": "?"},
}
# Checkpoints that do not say their sign are older than the setting, and were trained with this one.
OLDER_SIGN = "object_to_goal"


@dataclass(frozen=True)
class Checkpoint:
    """The weights of a policy, and what they were trained for."""

    path: Path
    """The file that the weights were read from."""
    weights: dict[str, NDArray[Any]]
    """Weights by name, float32, also those of a file of 16 bits; names are PyTorch's module paths (docs/probe.md)."""
    carried_goal: str
    """Sign of the goal vector while the target is held: give it to the environment."""
    config: dict[str, Any] = field(default_factory=dict)
    """The run's whole configuration; a policy file has it, too; empty for a file of weights alone."""
    manifest: dict[str, Any] = field(default_factory=dict)
    """The checkpoint's manifest: `frames`, `rollout`, `stage`, ...; of a policy file `frames`, `rollout` and `run`;
    empty for a file of weights alone."""

    actions: dict[str, Any] = field(default_factory=dict)
    """The task's actions, as it declares them: their `kind`, and `names`, `counts` or `bounds`; `masked`, if not all
    can always be chosen. Empty for a file of weights alone."""

    def __repr__(self) -> str:
        """Which one it is, in a line."""
        parameters = sum(array.size for array in self.weights.values())
        frames = "" if self.frames is None else f", {self.frames} frames"
        task = f"task {self.config['task']}" if "task" in self.config else "weights alone"
        return f"<checkpoint {self.path.stem}: {task}{frames}, {parameters} parameters, {self.path.parent}>"

    @property
    def frames(self) -> int | None:
        """Frames that it was trained on, if it says so."""
        return self.manifest.get("frames")

    @property
    def goal(self) -> str:
        """How the network is given the numbers beside a frame: "polar", "cartesian" or "plain"."""
        return self.config.get("network", {}).get("goal", "polar")

    def environment(self) -> dict[str, Any]:
        """Keywords for `KitchenEnv` and `VectorEnv` that make the task that it was trained in."""
        if "environment" in self.config:
            raise ValueError(
                f"{self.config['task']} is no task of the kitchens: an environment of your own is made by its own code,"
                " which the run was started with (--env)"
            )
        episode = self.config.get("episode", {})
        names = ("max_steps", "action_space", "start_distance_max_m", "goal_distance_max_m")
        task = {"task": self.config.get("task", "arm_point_nav"), "carried_goal": self.carried_goal}
        return task | {name: episode[name] for name in names if name in episode}

    def network(self) -> Network:
        """The network in PyTorch with these weights; needs torch."""
        try:
            from stillroom.network import Network
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError("Checkpoint.network needs torch: pip install 'stillroom[train]'") from error
        clip = self.config.get("normalize", {}).get("observation_clip", 10.0)
        choices, bounds = self.actions.get("counts"), self.actions.get("bounds")
        masked = self.actions.get("masked", False)
        return Network.of(
            self.weights,
            goal=self.goal,
            activation=self.config.get("network", {}).get("activation", "tanh"),
            observation_clip=clip,
            choices=choices,
            bounds=bounds,
            masked=masked,
            channels=self._channels(),
        )

    def _channels(self) -> list[dict[str, Any]]:
        """What an environment of your own observes, as its declaration says it."""
        declared = tomllib.loads(self.config.get("environment", {}).get("declaration", ""))
        return [one for one in declared.get("channels", []) if one.get("role") == "observation"]

    def save(self, path: str | PathLike[str]) -> None:
        """Writes the weights alone as a safetensors file, which `load` and `learner probe` read."""
        Path(path).write_bytes(save(self.weights))


def load(path: str | PathLike[str], *, rollout: int | None = None, verify: bool = True) -> Checkpoint:
    """Reads a checkpoint. Whatever is wrong with a file is a `CheckpointError`, which names it.

    Files are ordinary ones of a bounded size. What lies in a folder is no link: the folder may be somebody else's.

    Args:
        path: a run folder (its newest complete checkpoint), `RUN/best` or another folder with checkpoints, one of a
            checkpoint's files, a policy file (`stillroom export --format safetensors`), or a safetensors file with
            weights alone.
        rollout: of a folder, the checkpoint with this number instead of the newest.
        verify: compare the SHA-256 that the manifest, or a policy file, names.
    """
    if not isinstance(path, str | PathLike):
        raise TypeError(f"path is {shown(path)}, not a path")
    path, verify = Path(path), flag("verify", verify)
    rollout = None if rollout is None else whole("rollout", rollout, 2**64 - 1)
    try:
        path = _through_best(path)
        if path.is_dir():
            return _newest(path, rollout, verify)
        if rollout is not None:
            raise ValueError(f"rollout chooses a checkpoint of a folder, and {path} is none")
        if not path.exists():
            raise CheckpointError(f"{path} is not there")
        if path.suffix not in (".json", ".safetensors"):
            raise CheckpointError(f"{path} is neither a run folder nor a checkpoint (rollout-....safetensors)")
        if path.with_suffix(".json").exists():
            return _checkpoint(path.with_suffix(".json"), verify)
        return _policy(path, verify)
    except OSError as error:
        raise CheckpointError(f"{path} cannot be read: {error}") from error


def _through_best(path: Path) -> Path:
    """The folder that a file `RUN/best` names, which stands for a link on a disk without links."""
    if path.name != "best" or not path.is_file() or path.stat().st_size > len("validation/rollout-") + 21:
        return path
    named = path.read_bytes().decode(errors="replace").strip()
    return path.parent / named if re.fullmatch("validation/rollout-[0-9]+", named) else path


def _newest(folder: Path, rollout: int | None, verify: bool) -> Checkpoint:
    """The newest checkpoint of a folder that is whole: a torn one is followed by the one before it."""
    # A link in somebody else's folder may lead anywhere.
    inside = [] if (folder / "checkpoints").is_symlink() else folder.glob("checkpoints/rollout-*.json")
    found = [*folder.glob("rollout-*.json"), *inside]
    numbered = {path: path.stem.removeprefix("rollout-") for path in found}
    manifests = {path: int(number) for path, number in numbered.items() if number.isascii() and number.isdigit()}
    problem: CheckpointError | None = None
    for manifest in sorted(manifests, key=manifests.__getitem__, reverse=True):
        if rollout not in (None, manifests[manifest]):
            continue
        try:
            checkpoint = _checkpoint(manifest, verify)
        except CheckpointError as error:
            problem = problem or error
        else:
            if problem is not None:
                warnings.warn(f"{problem}: {checkpoint.path.name} is taken", stacklevel=3)
            return checkpoint
    what = "no checkpoint" if rollout is None else f"no checkpoint of rollout {rollout}"
    raise problem or CheckpointError(f"{folder} holds {what}: a run folder has them in checkpoints/")


def _checkpoint(path: Path, verify: bool) -> Checkpoint:
    file, manifest, config, actions, tensors = read_checkpoint(path, PREFIX, verify)
    facts = json.loads(manifest)
    weights = _weights(file, tensors)
    sign = facts.get("carried_goal", OLDER_SIGN)
    return Checkpoint(file, weights, sign, tomllib.loads(config), facts, json.loads(actions))


def _policy(path: Path, verify: bool) -> Checkpoint:
    """A policy file, or weights alone."""
    facts, tensors = read_policy(path, verify)
    named = [tensor for tensor in tensors if tensor[0].startswith(PREFIX)]
    weights = _weights(path, named or tensors)
    if facts is None:
        return Checkpoint(path, weights, "goal_to_object")
    config, rollout, frames, run, actions = facts
    table = tomllib.loads(config)
    manifest = {"frames": frames, "rollout": rollout, "run": run}
    return Checkpoint(path, weights, table["network"]["carried_goal"], table, manifest, json.loads(actions))


def _weights(path: Path, tensors: list[tuple[str, str, list[int], bytes]]) -> dict[str, NDArray[Any]]:
    """Arrays of tensors, those of 16 bits widened, without the prefix of a checkpoint."""
    weights = {}
    for name, kind, shape, content in tensors:
        if kind not in TYPES:
            raise CheckpointError(f"{path} holds a tensor {shown(name)} of the type {kind}, which numpy lacks")
        array = np.frombuffer(content, TYPES[kind])
        if kind == "BF16":
            array = (array.astype(np.uint32) << 16).view(np.float32)
        try:
            array = array.reshape(shape)
        except (ValueError, OverflowError) as error:
            raise CheckpointError(f"{path} holds a tensor {shown(name)} of a shape that numpy lacks: {error}") from None
        weights[name.removeprefix(PREFIX)] = array.astype(np.float32 if kind == "F16" else array.dtype)
    if not weights:
        raise CheckpointError(f"{path} holds no weights: take another file")
    return weights
