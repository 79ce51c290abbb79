"""Wrappers for Gymnasium's environments."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from stillroom.depth import CameraPose, DepthCamera, plain


class Depth(gymnasium.ObservationWrapper):
    """Adds what a depth camera sees to the observation of any environment with a MuJoCo model.

    The observation becomes a dictionary: that of the environment (under "observation" unless it is one already),
    "depth" [height, width], and with `ids` "segmentation" [height, width], both as `stillroom.DepthCamera` gives them.
    Vector environments: `gymnasium.make_vec(ID, num_envs=8, wrappers=[stillroom.wrappers.Depth])`.
    """

    def __init__(
        self,
        env: gymnasium.Env,
        camera: str | int | CameraPose = -1,
        width: int = 224,
        height: int = 224,
        *,
        depth: str = "uint16",
        ids: bool = False,
    ) -> None:
        super().__init__(env)
        self._arguments = (camera, width, height)
        self._depth = depth
        self._ids = ids
        model, _ = mujoco_of(env)
        self._camera = DepthCamera(model, *self._arguments, depth=depth)
        inner = env.observation_space
        self._is_dict = isinstance(inner, spaces.Dict)
        parts = dict(inner.spaces) if isinstance(inner, spaces.Dict) else {"observation": inner}
        shape = (self._camera.height, self._camera.width)
        parts["depth"] = (
            spaces.Box(0, np.inf, shape, np.float32)
            if depth == "float32"
            else spaces.Box(0, 2**16 - 1, shape, np.uint16)
        )
        if ids:
            parts["segmentation"] = spaces.Box(-1, np.iinfo(np.int32).max, shape, np.int32)
        self.observation_space = spaces.Dict(parts)

    def observation(self, observation: Any) -> dict[str, Any]:
        """The observation and what the camera sees."""
        model, data = mujoco_of(self.env)
        if plain(model) is not self._camera.model:
            # Some environments load another model when they are reset.
            self._camera = DepthCamera(model, *self._arguments, depth=self._depth)
        parts = dict(observation) if self._is_dict else {"observation": observation}
        if self._ids:
            parts["depth"], parts["segmentation"] = self._camera.render(data, ids=True)
        else:
            parts["depth"] = self._camera.render(data)
        return parts


def mujoco_of(env: gymnasium.Env) -> tuple[Any, Any]:
    """The MuJoCo model and data of an environment, wherever its package keeps them."""
    inner = env.unwrapped
    inner = getattr(inner, "robot_env", inner)  # FrankaKitchen
    inner = getattr(inner, "physics", None) or getattr(inner, "sim", None) or inner  # dm_control, robosuite
    for names in (("model", "data"), ("_model", "_data")):
        model, data = (getattr(inner, name, None) for name in names)
        if hasattr(plain(model), "ngeom") and hasattr(plain(data), "geom_xpos"):
            return model, data
    raise ValueError(f"{env} has no MuJoCo model that is known here: Depth looks for `model` and `data`")
