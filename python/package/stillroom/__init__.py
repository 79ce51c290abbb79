"""Kitchens for mobile manipulators that leave everything as they found it.

`gymnasium.make("stillroom/ArmPointNav-v0", kitchen=7)` makes one environment, `stillroom.VectorEnv` many that threads
step together; `stillroom.tasks()` lists the tasks. Observations and all else that they return are described in
`stillroom.types`. "stillroom/ArmPointNavMuJoCo-v0" has MuJoCo's physics in place of ours.
`stillroom.DepthCamera`, `stillroom.Scene` and `stillroom.wrappers.Depth` give depth images of any MuJoCo model or scene.

`stillroom.serve(make_env)` lets an environment of your own take part in a run, and `stillroom.train(make_env,
frames=...)` starts one (docs/your-simulator.md); `stillroom.wrappers.MujocoSnapshot` restores a MuJoCo environment from
bytes.
"""

from __future__ import annotations

import gymnasium

import stillroom._processor  # noqa: F401  # before the compiled module, which would die of an illegal instruction
from stillroom import wrappers
from stillroom._stillroom import (
    ACTIONS,
    FRAME_SIDE,
    TARGETS,
    Kitchen,
    Snapshot,
    __version__,
    channels,
    episode_seed,
    kitchens,
    tasks,
)
from stillroom.checkpoint import Checkpoint, CheckpointError, load
from stillroom.depth import CameraPose, DepthCamera, Scene
from stillroom.env import ArmPointNav, KitchenEnv
from stillroom.oracle import Oracle, oracle
from stillroom.run import Run, RunError, read_run
from stillroom.serving import serve
from stillroom.training import Training, train
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
    "KitchenEnv",
    "Oracle",
    "Run",
    "RunError",
    "Scene",
    "Snapshot",
    "Training",
    "VectorEnv",
    "__version__",
    "channels",
    "episode_seed",
    "kitchens",
    "load",
    "oracle",
    "read_run",
    "serve",
    "tasks",
    "train",
    "wrappers",
]

for _task in tasks():
    gymnasium.register(
        # arm_point_nav is ArmPointNav.
        id=f"stillroom/{_task.title().replace('_', '')}-v0",
        entry_point="stillroom.env:KitchenEnv",
        vector_entry_point="stillroom.vector:VectorEnv",
        kwargs={"task": _task},
        # An episode's own limit, `max_steps`, is part of the task.
        max_episode_steps=None,
    )

gymnasium.register(
    id="stillroom/ArmPointNavMuJoCo-v0",
    entry_point="stillroom.mujoco_kitchen:MujocoKitchenEnv",
    max_episode_steps=None,
)
