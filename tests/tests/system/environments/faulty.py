"""An environment that does one thing wrong once, in the sixth step of an episode: `fault` says what. The file `marker` is
made just before, and where it is there already nothing is wrong; `always` is no file, and everything is wrong. `trial`
is none either: the trial before a run goes wrong."""

import os
import subprocess
import sys
import time

import gymnasium
import numpy as np

FAULTY_STEP = 5


class Faulty(gymnasium.Env):
    def __init__(self, fault: str = "", marker: str = ""):
        self._fault, self._marker = fault, marker
        space = gymnasium.spaces
        self.action_space = space.Discrete(2)
        self.observation_space = space.Dict(
            {
                "depth_mm": space.Box(0, 65535, (224, 224), np.uint16),
                "goal_m": space.Box(-1.0, 1.0, (3,), np.float32),
            }
        )
        if fault == "child":
            # Its command line says whose it is.
            subprocess.Popen(["sh", "-c", "sleep 1000; :", marker])

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        ended, self._step = getattr(self, "_step", 0) == 10, 0
        if self._fault == "reset" and ended and self._is_time():
            raise ValueError("no start was found")
        return self._seen(), {}

    def step(self, action):
        reward = float(self.np_random.integers(2))
        terminated = self._step == 9
        faulty = self._fault != "reset" and self._step == FAULTY_STEP and self._is_time()
        self._step += 1
        seen = self._seen()
        if faulty:
            match self._fault:
                case "step":
                    raise ZeroDivisionError("the robot fell over")
                case "shape":
                    seen["goal_m"] = seen["goal_m"][:2]
                case "dtype":
                    seen["goal_m"] = seen["goal_m"].astype(np.int16)
                case "range":
                    seen["goal_m"] = seen["goal_m"] + np.float32(7)
                case "nan":
                    seen["goal_m"] = seen["goal_m"] * np.float32("nan")
                case "reward":
                    reward = float("inf")
                case "list":
                    seen["goal_m"] = seen["goal_m"].tolist()
                case "none":
                    reward = None
                case "key":
                    del seen["goal_m"]
                case "tuple":
                    return seen, reward
                case "end":
                    terminated = "yes"
                case "exit":
                    sys.exit("enough")
                case "os_exit" | "child":
                    os._exit(3)
                case "segfault":
                    os.kill(os.getpid(), 11)
                case "hang":
                    time.sleep(1000)
                case "print":
                    print("a line of the environment's own")
        return seen, reward, terminated, False, {}

    def _is_time(self):
        if "--describe" in sys.argv:
            return self._marker == "trial"
        if self._marker == "always":
            return True
        try:
            return bool(self._marker) and os.close(os.open(self._marker, os.O_CREAT | os.O_EXCL)) is None
        except FileExistsError:
            return False

    def _seen(self):
        return {
            "depth_mm": np.full((224, 224), 1000 + self._step, np.uint16),
            "goal_m": np.full(3, self.np_random.uniform(), np.float32),
        }


def make_env(**arguments):
    return Faulty(**arguments)


def make_vector(num_envs: int, mode: str, **arguments):
    envs = [lambda: Faulty(**arguments)] * num_envs
    return gymnasium.vector.SyncVectorEnv(envs, autoreset_mode=gymnasium.vector.AutoresetMode(mode))


class Random(Faulty):
    """Draws from a generator that no seed resets."""

    def _seen(self):
        return super()._seen() | {"goal_m": np.random.default_rng().uniform(-1, 1, 3).astype(np.float32)}


def random_env():
    return Random()


class AtOnce(Faulty):
    def step(self, action):
        seen, _, *more = super().step(action)
        return seen, float("nan"), *more


def at_once():
    return AtOnce()
