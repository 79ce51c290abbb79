"""The compiled module: private, but for `Kitchen` and `Snapshot`."""

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

__version__: str
ACTIONS: list[str]
"""Names of all actions."""
TARGETS: list[str]
"""Names of the categories of targets, by number."""
FRAME_SIDE: int
"""Width and height of the robot's own depth frame, pixels."""

class CheckpointError(ValueError):
    """A path holds no checkpoint that can be used."""

def kitchens(split: str) -> list[int]:
    """Numbers of the built-in kitchens of a split: "train", "validation" or "test"."""

def whole(name: str, value: Any, most: int, least: int = 0) -> int:
    """An integer from `least` to `most`, of whatever can be an index but a bool; errors name it `name`."""

def choice(name: str, value: Any, choices: list[str]) -> str:
    """One of the texts; an error names it `name`."""

def shown(value: Any) -> str:
    """A value for an error: as Python writes it, but no more than a line."""

def read_of_run(root: Path, path: Path) -> bytes: ...
def list_of_run(root: Path, path: Path) -> list[tuple[Path, bool]]: ...
def toml_as_json(text: str) -> str: ...
def read_checkpoint(
    path: str | PathLike[str], prefix: str, verify: bool
) -> tuple[Path, str, str, list[tuple[str, str, list[int], bytes]]]:
    """Of the checkpoint with this manifest: file, manifest as JSON, configuration as TOML, and tensors (name, type,
    shape, bytes) whose names begin with `prefix`."""

def read_policy(
    path: str | PathLike[str], verify: bool
) -> tuple[tuple[str, int, int, str] | None, list[tuple[str, str, list[int], bytes]]]:
    """Of a policy file: configuration as TOML, rollout, frames and run, unless it is of weights alone; tensors."""

class Settings:
    def __init__(
        self,
        *,
        preset: str,
        reward: str,
        depth: str,
        frame_side: int,
        action_space: str | None = None,
        max_steps: int | None = None,
        start_distance_max_m: float | None = None,
        goal_distance_max_m: float | None = None,
        disturbance_weight: float | None = None,
        carried_goal: str | None = None,
    ) -> None: ...
    @property
    def actions(self) -> list[str]: ...
    @property
    def max_steps(self) -> int: ...

class Kitchen:
    """A kitchen, built or read. Environments in the same one share it."""

    def __init__(
        self, number: int | None = None, *, scene: str | PathLike[str] | None = None, scene_index: int = 0
    ) -> None: ...
    @property
    def number(self) -> int: ...
    @property
    def objects(self) -> list[str]: ...
    @property
    def masses_kg(self) -> list[float]: ...
    @property
    def fixed_episodes(self) -> int: ...

class Snapshot:
    """A moment of one environment. Pickling keeps the episode's actions; reading simulates them again."""

    @property
    def state_hash(self) -> int: ...
    @property
    def step(self) -> int: ...
    def to_bytes(self) -> bytes: ...
    @staticmethod
    def from_bytes(bytes: bytes) -> Snapshot: ...

class Batch:
    def __init__(
        self,
        settings: Settings,
        kitchens: list[Kitchen],
        numbers: list[int],
        autoreset: str,
        threads: int,
    ) -> None: ...
    @property
    def depth(self) -> NDArray[Any]: ...
    @property
    def goal(self) -> NDArray[np.float32]: ...
    @property
    def previous_action(self) -> NDArray[np.int64]: ...
    @property
    def threads(self) -> int: ...
    def reset(self, asked: list[tuple[str | None, int | None, int | None] | None]) -> dict[str, Any]: ...
    def step(self, actions: NDArray[np.int64]) -> tuple[Any, ...]: ...
    def ended(self, index: int) -> bool: ...
    def state(self, index: int) -> Any: ...
    def displacements_m(self, index: int) -> NDArray[np.float32]: ...
    def picture(self, index: int, side: int) -> NDArray[np.uint8]: ...
    def snapshot(self, index: int) -> Snapshot: ...
    def restore(self, index: int, snapshot: Snapshot) -> dict[str, Any]: ...
    def oracle(self, variant: str) -> NDArray[np.int64]: ...
