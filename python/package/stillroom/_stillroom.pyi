"""The compiled module: private, but for `Kitchen` and `Snapshot`."""

from os import PathLike
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

def kitchens(split: str) -> list[int]:
    """Numbers of the built-in kitchens of a split: "train", "validation" or "test"."""

class Settings:
    def __init__(
        self,
        *,
        preset: str,
        reward: str,
        frame_side: int,
        in_metres: bool,
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
