"""The kitchens under MuJoCo's physics, beside the module's own."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest

import stillroom
from conftest import random_action

KITCHEN = 2
NEAR_M = 0.002


@pytest.fixture(scope="module")
def env() -> Iterator[Any]:
    pytest.importorskip("mujoco", minversion="3.9")
    with gymnasium.make("stillroom/ArmPointNavMuJoCo-v0", kitchen=KITCHEN, disable_env_checker=True) as made:
        yield made.unwrapped


@pytest.fixture(scope="module")
def ours() -> stillroom.KitchenEnv:
    return stillroom.KitchenEnv(KITCHEN)


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return one.keys() == other.keys() and all(np.array_equal(one[key], other[key]) for key in one)


def drawn_by_mujoco(env: Any) -> np.ndarray:
    """What a camera of MuJoCo's model sees. The kitchens' axes are left-handed: the picture is mirrored."""
    state = env.state()
    x, y, z, w = state["camera_rotation_xyzw"].astype(float)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    pose = stillroom.CameraPose(state["camera_position_m"], rotation * [-1, 1, -1], env.model.cam_fovy[0])
    return stillroom.DepthCamera(env.model, pose).render(env.data)[:, ::-1]


@pytest.mark.parametrize("options", [{"episode": 3}, {"fixed": 41}, {"drawn": 7}])
def test_episodes_begin_alike(env: Any, ours: stillroom.KitchenEnv, options: dict[str, int]) -> None:
    begun, begins = env.reset(seed=5, options=options), ours.reset(seed=5, options=options)
    assert same(begun[0], begins[0]) and begun[1] == begins[1]
    # Bodies stand in MuJoCo's world where the module draws them: silhouettes apart, to the millimetre.
    difference_mm = np.abs(drawn_by_mujoco(env).astype(int) - begun[0]["depth"])
    assert np.mean(difference_mm <= 1) > 0.99


def test_what_is_pushed_moves_in_both(env: Any, ours: stillroom.KitchenEnv) -> None:
    moved: list[set[str]] = []
    for engine in (env, ours):
        found: set[str] = set()
        for episode in range(4):
            engine.reset(options={"fixed": episode})
            oracle, ended = stillroom.oracle(engine), False
            while not ended:
                _, _, terminated, truncated, info = engine.step(oracle())
                ended = terminated or truncated
            assert info["success"], "the oracle's plans hold in either engine"
            found |= {name for name, moved_m in info["displacement_m"].items() if moved_m > 0.01}
        moved.append(found)
    assert moved[0] & moved[1], moved


def test_nothing_moves_by_itself_and_the_same_actions_give_the_same_bits(env: Any) -> None:
    hashes: list[list[int]] = []
    for _ in range(2):
        _, info = env.reset(seed=3)
        hashes.append([info["state_hash"]])
        for step in range(60):
            _, _, _, _, info = env.step(random_action(KITCHEN, 0, 0, step))
            hashes[-1].append(info["state_hash"])
    assert hashes[0] == hashes[1]
    env.reset(seed=3)
    look = env.action_names.index("LookDown")
    for _ in range(20):
        _, _, _, _, info = env.step(look)
    assert info["disturbance_m"] < NEAR_M


def test_what_is_held_follows_the_hand(env: Any) -> None:
    env.reset(options={"fixed": 0})
    oracle, offsets = stillroom.oracle(env), []
    target = env.state()["target_object"]
    while len(offsets) < 30:
        _, _, terminated, truncated, _ = env.step(oracle())
        state = env.state()
        if state["holding"]:
            offsets.append(np.linalg.norm(state["object_positions_m"][target] - state["wrist_position_m"]))
        if terminated or truncated:
            break
    assert len(offsets) > 5 and np.ptp(offsets) < NEAR_M


def test_there_are_no_snapshots(env: Any) -> None:
    env.reset(seed=1)
    for refused in (env.snapshot, lambda: copy.deepcopy(env)):
        with pytest.raises(TypeError, match="has no snapshots"):
            refused()
    with pytest.raises(ValueError, match="arm_point_nav alone"):
        gymnasium.make("stillroom/ArmPointNavMuJoCo-v0", kitchen=KITCHEN, task="point_nav")
