"""Checkpoints of runs: their weights as numpy arrays, and with torch the network that they belong to."""

from __future__ import annotations

import hashlib
import json
import re
import warnings
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load as decode
from safetensors.numpy import save_file

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib  # type: ignore[no-redef]

if TYPE_CHECKING:
    from stillroom.network import Network

# In a checkpoint the names of the weights begin so; beside them lie Adam's moments, beliefs and environments.
PREFIX = "model."
# What the metadata of a policy file are called.
ENTRY = "stillroom"
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

    @property
    def frames(self) -> int | None:
        """Frames that it was trained on, if it says so."""
        return self.manifest.get("frames")

    @property
    def goal(self) -> str:
        """How the network is given the goal: "polar" or "cartesian"."""
        return self.config.get("network", {}).get("goal", "polar")

    def environment(self) -> dict[str, Any]:
        """Keywords for `ArmPointNav` and `VectorEnv` that make the task that it was trained in."""
        episode = self.config.get("episode", {})
        names = ("max_steps", "action_space", "start_distance_max_m", "goal_distance_max_m")
        return {"carried_goal": self.carried_goal, **{name: episode[name] for name in names if name in episode}}

    def network(self) -> Network:
        """The network in PyTorch with these weights; needs torch."""
        from stillroom.network import Network

        return Network.of(self.weights, goal=self.goal)

    def save(self, path: str | PathLike[str]) -> None:
        """Writes the weights alone as a safetensors file, which `load` and `learner probe` read."""
        save_file(self.weights, path)


class CheckpointError(ValueError):
    """A path holds no checkpoint that can be used."""


def load(path: str | PathLike[str], *, rollout: int | None = None, verify: bool = True) -> Checkpoint:
    """Reads a checkpoint.

    Args:
        path: a run folder (its newest complete checkpoint), `RUN/best` or another folder with checkpoints, one of a
            checkpoint's files, a policy file (`orchestrator export --format safetensors`), or a safetensors file with
            weights alone.
        rollout: of a folder, the checkpoint with this number instead of the newest.
        verify: compare the SHA-256 that the manifest, or a policy file, names.
    """
    path = _through_best(Path(path))
    if path.is_dir():
        return _newest(path, rollout, verify)
    if not path.exists():
        raise CheckpointError(f"{path} is not there")
    if path.suffix == ".json":
        return _checkpoint(path, verify)
    if path.suffix != ".safetensors":
        raise CheckpointError(f"{path} is neither a run folder nor a checkpoint (rollout-....safetensors)")
    if path.with_suffix(".json").exists():
        return _checkpoint(path.with_suffix(".json"), verify)
    try:
        content = path.read_bytes()
    except OSError as error:
        raise CheckpointError(f"{path} cannot be read: {error}") from error
    tensors = _tensors(path, content)
    weights = {name.removeprefix(PREFIX): tensor for name, tensor in tensors.items() if name.startswith(PREFIX)}
    config, manifest = _facts(path, content, verify)
    sign = config.get("network", {}).get("carried_goal", "goal_to_object")
    return Checkpoint(path, weights or tensors, sign, config, manifest)


def _through_best(path: Path) -> Path:
    """The folder that a file `RUN/best` names, which stands for a link on a disk without links."""
    if path.name != "best" or not path.is_file() or path.stat().st_size > len("validation/rollout-") + 21:
        return path
    named = path.read_bytes().decode(errors="replace").strip()
    return path.parent / named if re.fullmatch("validation/rollout-[0-9]+", named) else path


def _facts(path: Path, content: bytes, verify: bool) -> tuple[dict[str, Any], dict[str, Any]]:
    """Configuration and origin out of the metadata of a policy file; nothing where there are none."""
    begin = 8 + int.from_bytes(content[:8], "little")
    header = json.loads(content[8:begin])
    entry = header.pop("__metadata__", {}).get(ENTRY)
    if entry is None:
        return {}, {}
    try:
        facts = json.loads(entry)
        config = tomllib.loads(facts.get("config", ""))
        manifest = {"frames": int(facts["frames"]), "rollout": int(facts["rollout"]), "run": facts["run"]}
        digest = facts["tensors_sha256"]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise CheckpointError(f"{path} has metadata that cannot be read: {error}") from error
    if verify and _tensors_sha256(header, content[begin:]) != digest:
        raise CheckpointError(f"{path} is damaged: the SHA-256 of its weights is not the one that its metadata name")
    return config, manifest


def _tensors_sha256(header: dict[str, Any], data: bytes) -> str:
    """What a policy file is known by: name, length and bytes of each tensor, by name."""
    digest = hashlib.sha256()
    for name, entry in sorted(header.items()):
        begin, end = entry["data_offsets"]
        digest.update(name.encode() + (end - begin).to_bytes(8, "little") + data[begin:end])
    return digest.hexdigest()


def _newest(folder: Path, rollout: int | None, verify: bool) -> Checkpoint:
    """The newest checkpoint of a folder that is whole: a torn one is followed by the one before it."""
    manifests = sorted([*folder.glob("checkpoints/rollout-*.json"), *folder.glob("rollout-*.json")], reverse=True)
    if rollout is not None:
        manifests = [path for path in manifests if path.stem == f"rollout-{rollout:08}"]
    problem: CheckpointError | None = None
    for manifest in manifests:
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
    try:
        manifest = json.loads(path.read_bytes())
        name, digest = manifest["tensors"], manifest["tensors_sha256"]
        if Path(name).name != name or name == "..":
            raise ValueError(f"it names tensors that are not beside it: {name}")
        config = tomllib.loads(manifest.get("config", ""))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CheckpointError(f"{path} is no manifest of a checkpoint: {error}") from error
    file = path.parent / name
    try:
        content = file.read_bytes()
    except OSError as error:
        raise CheckpointError(f"{path} names tensors that are not there: {error}") from error
    if verify and hashlib.sha256(content).hexdigest() != digest:
        raise CheckpointError(f"{file} is damaged: its SHA-256 is not the one that its manifest names")
    tensors = _tensors(file, content)
    weights = {name.removeprefix(PREFIX): tensor for name, tensor in tensors.items() if name.startswith(PREFIX)}
    return Checkpoint(file, weights, manifest.get("carried_goal", OLDER_SIGN), config, manifest)


def _tensors(path: Path, content: bytes) -> dict[str, NDArray[Any]]:
    try:
        # Sorted: the library gives them in any order.
        tensors = {name: np.asarray(tensor) for name, tensor in sorted(decode(content).items())}
    except SafetensorError as error:
        raise CheckpointError(f"{path} is no safetensors file: {error}") from error
    return {name: array.astype(np.float32) if array.dtype == np.float16 else array for name, array in tensors.items()}
