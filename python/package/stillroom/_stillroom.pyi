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
BUILD: str
"""Which sources it was compiled from."""
FRAME_SIDE: int
"""Width and height of the robot's own depth frame, pixels."""
SUBSTEPS: int
"""Sub-steps of physics that an action takes at least."""
JAM_DEPTH_M: float
"""A contact this deep stops the robot, metres,"""
JAM_GROWTH_M: float
"""if it has become deeper by this much in the motion."""

class CheckpointError(ValueError):
    """A path holds no checkpoint that can be used."""

def is_reserved(name: str) -> bool:
    """Whether the engine has this name for itself."""

def tasks() -> list[str]:
    """Names of the tasks."""

def channels(task: str) -> list[dict[str, Any]]:
    """What a task's environments report: of each channel name, role, dtype, shape, unit, and what it is (doc). An
    observation is called without its unit."""

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
) -> tuple[Path, str, str, str, list[tuple[str, str, list[int], bytes]]]:
    """Of the checkpoint with this manifest: file, manifest as JSON, configuration as TOML, the task's actions as JSON,
    and tensors (name, type, shape, bytes) whose names begin with `prefix`."""

def read_policy(
    path: str | PathLike[str], verify: bool
) -> tuple[tuple[str, int, int, str, str] | None, list[tuple[str, str, list[int], bytes]]]:
    """Of a policy file: configuration as TOML, rollout, frames, run and the task's actions as JSON, unless it is of
    weights alone; tensors."""

class Settings:
    def __init__(
        self,
        *,
        preset: str,
        reward: str,
        depth: str,
        frame_side: int,
        task: str | None = None,
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
    @property
    def task(self) -> str: ...
    @property
    def bounds(self) -> dict[str, list[float]]:
        """Least and greatest number of each observation that is no image, by its name."""
    @property
    def meanings(self) -> dict[str, list[str]]:
        """What numbers in infos stand for, by their name."""

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
    def mjcf(self) -> str:
        """The kitchen, settled, in MuJoCo's format. The robot's links and its body are mocap bodies, the last ones."""

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
    def observations(self) -> dict[str, NDArray[Any]]: ...
    @property
    def threads(self) -> int: ...
    def reset(self, asked: list[tuple[str | None, int | None, int | None] | None]) -> dict[str, Any]: ...
    def step(self, actions: NDArray[np.int64]) -> tuple[Any, ...]: ...
    def way(self, actions: NDArray[np.int64]) -> tuple[NDArray[np.float64], bool]:
        """Where an action takes the robot of the only environment: poses of its body and links [sub-steps, parts, 7], as
        MuJoCo writes them, from where it is on; and whether the action succeeds if nothing stops the robot."""
    def finish(self, actions: NDArray[np.int64], arrived: bool, poses: NDArray[np.float64]) -> tuple[Any, ...]:
        """As `step`, of an action whose way the robot has gone while another engine moved the things to these poses."""
    def ended(self, index: int) -> bool: ...
    def state(self, index: int) -> Any: ...
    def displacements_m(self, index: int) -> NDArray[np.float32]: ...
    def picture(self, index: int, side: int) -> NDArray[np.uint8]: ...
    def snapshot(self, index: int) -> Snapshot: ...
    def restore(self, index: int, snapshot: Snapshot) -> dict[str, Any]: ...
    def oracle(self, variant: str) -> NDArray[np.int64]: ...

def episode_seed(seed: int, environment: int, episode: int) -> int:
    """The seed that a run resets an environment with for an episode: the same reset begins the same episode."""

def hold_lifeline() -> None:
    """Exits as soon as the orchestrator is gone, with all processes that environments have started."""

class Actor:
    """An actor of a run."""

    def __init__(self, number: int, incarnation: int, wire: str, config: str) -> None: ...
    @property
    def environments(self) -> int:
        """How many environments it has."""
    def run(
        self, environments: list[Any], vectors: list[Any], description: str, observed: list[tuple[str, str | None]]
    ) -> None:
        """Takes part in the run until something fails."""

class Replay:
    """Simulates recorded episodes of one run again."""

    def __init__(
        self,
        setup: str,
        environment: Any,
        vectors: list[Any],
        description: str,
        observed: list[tuple[str, str | None]],
    ) -> None: ...
    def verdict(self, line: str) -> str:
        """The verdict on the episode of a further line."""

def tangent(angle_rad: float) -> float:
    """The tangent of an angle: the same bits on every machine, which Python's own is not."""

def sine_cosine(angle_rad: float) -> tuple[float, float]:
    """The sine and cosine of an angle."""

class DepthMesh:
    """Triangles that several things of a `DepthScene` can have."""

    def __init__(self, vertices: NDArray[np.float32], triangles: NDArray[np.uint32]) -> None: ...
    @staticmethod
    def height_field(heights: NDArray[np.float32], half_extents: tuple[float, float], base: float) -> DepthMesh:
        """A grid of heights, row by row, over a rectangle, with walls down to `base` below 0, and a bottom."""

class DepthScene:
    """Things that a camera sees: what `stillroom.DepthCamera` and `stillroom.Scene` are made of."""

    def __init__(self) -> None: ...
    def add(self, number: int, kind: str, size: list[float]) -> None:
        """Adds a thing with this number among the poses."""

    def add_mesh(self, number: int, mesh: DepthMesh) -> None:
        """The same of a mesh."""

    def render(
        self,
        frames: list[
            tuple[list[tuple[NDArray[np.float64], NDArray[np.float64]]], NDArray[np.float64], NDArray[np.float64]]
        ],
        lens: tuple[int, int, tuple[float, float], tuple[float, float], float, float],
        in_metres: bool,
        with_numbers: bool,
        threads: int,
    ) -> tuple[NDArray[Any], NDArray[np.int32] | None]:
        """Depth [frames, rows, columns], and numbers of things if they are wanted. A frame is positions and rotations
        of things, in parts one after the other, and those of the camera."""
