"""Kitchens for mobile manipulators that leave everything as they found it.

`gymnasium.make("stillroom/ArmPointNav-v0", kitchen=7)` makes one environment, `stillroom.VectorEnv` many that threads
step together. `stillroom.DepthCamera`, `stillroom.Scene` and `stillroom.wrappers.Depth` give depth images of any MuJoCo
model or scene. Observations and all else that they return are described in `stillroom.types`.
"""

from __future__ import annotations

import gymnasium

import stillroom._processor  # noqa: F401  # before the compiled module, which would die of an illegal instruction
from stillroom import wrappers
from stillroom._stillroom import ACTIONS, FRAME_SIDE, TARGETS, Kitchen, Snapshot, __version__, kitchens
from stillroom.checkpoint import Checkpoint, CheckpointError, load
from stillroom.depth import CameraPose, DepthCamera, Scene
from stillroom.env import ArmPointNav
from stillroom.oracle import Oracle, oracle
from stillroom.run import Run, RunError, read_run
from stillroom.vector import VectorEnv

__all__ = [
    "ACTIONS",
    "FRAME_SIDE",
    "TARGETS",
    "ArmPointNav",
    "CameraPose",
    "Checkpoint",
    "CheckpointError",
    "DepthCamera",
    "Kitchen",
    "Oracle",
    "Run",
    "RunError",
    "Scene",
    "Snapshot",
    "VectorEnv",
    "__version__",
    "kitchens",
    "load",
    "oracle",
    "read_run",
    "wrappers",
]

gymnasium.register(
    id="stillroom/ArmPointNav-v0",
    entry_point="stillroom.env:ArmPointNav",
    vector_entry_point="stillroom.vector:VectorEnv",
    # An episode's own limit, `max_steps`, is part of the task.
    max_episode_steps=None,
)
