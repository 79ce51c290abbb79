"""Wrappers for Gymnasium's environments."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from stillroom.depth import CameraPose, DepthCamera, plain
from stillroom.masks import MASK


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


class ActionMasks(gymnasium.Wrapper):
    """Puts into `info["action_mask"]` what the environment's `action_masks()` returns, which sb3-contrib asks for."""

    def __getattr__(self, name: str) -> Any:
        # Such as `get_state`.
        return getattr(self.env, name)

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Begins an episode."""
        observation, info = self.env.reset(**arguments)
        return observation, info | self._mask()

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """A step, and what may be done after it."""
        *seen, info = self.env.step(action)
        return *seen, info | self._mask()  # type: ignore[return-value]

    def _mask(self) -> dict[str, Any]:
        return {MASK: np.asarray(self.env.get_wrapper_attr("action_masks")(), np.bool_).ravel()}


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


# What Gymnasium's environments read of `MjData` beside its state: it is as of the last step's beginning, so that it
# cannot be computed again from the state.
_DERIVED = [
    *("xpos", "xquat", "xmat", "xipos", "ximat", "geom_xpos", "geom_xmat", "site_xpos", "site_xmat", "subtree_com"),
    *("subtree_linvel", "subtree_angmom", "cinert", "cvel", "cacc", "cfrc_int", "cfrc_ext", "actuator_force"),
    *("actuator_length", "actuator_velocity", "qfrc_actuator", "qfrc_constraint", "qacc", "sensordata", "ten_length"),
    *("ten_velocity", "energy"),
]


class MujocoSnapshot(gymnasium.Wrapper):
    """Restores an environment with a MuJoCo model from bytes, and not by its episode's actions.

    The bytes hold the state of `mj_getState`, what was derived from it, the environment's generator `np_random`, and
    the counts of `gymnasium.wrappers.TimeLimit`. It is the outermost wrapper. An environment, or a wrapper, that
    remembers more than these is refused when a run begins: the run tries a snapshot first.
    """

    def __init__(self, env: gymnasium.Env) -> None:
        import mujoco

        super().__init__(env)
        self._mujoco = mujoco
        self._spec = mujoco.mjtState.mjSTATE_INTEGRATION
        inner: Any = env
        data: Any = env.unwrapped.data  # type: ignore[attr-defined]
        # Views of what the model has for good.
        self._derived = [getattr(data, name) for name in _DERIVED if hasattr(data, name)]
        self._limits: list[Any] = []
        while isinstance(inner, gymnasium.Wrapper):
            if hasattr(inner, "_elapsed_steps"):
                self._limits.append(inner)
            inner = inner.env

    def get_state(self) -> bytes:
        """The environment's state: always as many bytes."""
        env: Any = self.unwrapped
        physics = np.empty(self._mujoco.mj_stateSize(env.model, self._spec))
        self._mujoco.mj_getState(env.model, env.data, physics, self._spec)
        generator = env.np_random.bit_generator.state
        words = [*generator["state"].values(), generator["has_uint32"], generator["uinteger"]]
        counts = [-1 if limit._elapsed_steps is None else limit._elapsed_steps for limit in self._limits]
        arrays = [physics, *self._derived, np.array(counts, np.int64)]
        return b"".join([*(word.to_bytes(16, "little") for word in words), *(array.tobytes() for array in arrays)])

    def set_state(self, state: bytes) -> None:
        """Puts the environment into a state that `get_state` returned, of this one or of one that was made alike."""
        env: Any = self.unwrapped
        physics = np.empty(self._mujoco.mj_stateSize(env.model, self._spec))
        counts = np.empty(len(self._limits), np.int64)
        arrays = [physics, *self._derived, counts]
        words, rest = state[:64], memoryview(state)[64:]
        if len(rest) != sum(array.nbytes for array in arrays):
            raise ValueError(f"{len(state)} bytes are no state of this environment")
        for array in arrays:
            array.flat = np.frombuffer(rest[: array.nbytes], array.dtype)
            rest = rest[array.nbytes :]
        self._mujoco.mj_setState(env.model, env.data, physics, self._spec)
        key, increment, has_uint32, uinteger = (int.from_bytes(words[at : at + 16], "little") for at in (0, 16, 32, 48))
        generator = env.np_random.bit_generator
        generator.state = generator.state | {
            "state": {"state": key, "inc": increment},
            "has_uint32": has_uint32,
            "uinteger": uinteger,
        }
        for limit, count in zip(self._limits, counts, strict=True):
            limit._elapsed_steps = None if count < 0 else int(count)
