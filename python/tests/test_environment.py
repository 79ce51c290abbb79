"""One environment."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
import tomllib
from gymnasium.utils.env_checker import check_env

import stillroom
from conftest import REPOSITORY, pushing, random_action, same

# Of actor/simulator/tests/behaviour/determinism.rs: kitchen, hash of the first state, fold over 200 steps.
GOLDEN = [
    (1, 0xDC3C01C67293817B, 0x1467E7B06F73C953),
    (8, 0x3BC5D18B29BEF64A, 0xEBBA76E1CE653EFE),
    (30, 0x23A8D8D5D0D0439A, 0x31A9FCC827209ED9),
]


@pytest.mark.parametrize(("kitchen", "start", "fold"), GOLDEN)
def test_states_are_those_of_the_simulator(kitchen: int, start: int, fold: int) -> None:
    env = stillroom.ArmPointNav(kitchen)
    _, info = env.reset(seed=1)
    assert info["state_hash"] == start
    found = 0
    for step in range(200):
        *_, truncated, info = env.step(random_action(kitchen, 0, 0, step))
        rotated = (found << 7 | found >> 57) & (2**64 - 1)
        found = rotated * 0x9E3779B97F4A7C15 & (2**64 - 1) ^ int(info["state_hash"])
        assert truncated == (step == 199)
    assert found == fold


@pytest.mark.parametrize("arguments", [{}, {"depth": "float32", "frame_side": 56, "action_space": "small"}])
def test_gymnasiums_checker_finds_nothing(kitchens: dict, arguments: dict) -> None:
    env = gymnasium.make("stillroom/ArmPointNav-v0", kitchen=kitchens[1], render_mode="rgb_array", **arguments)
    # Any warning is an error: see pyproject.toml.
    check_env(env.unwrapped)
    assert env.action_space == gymnasium.spaces.Discrete(13 if arguments else 21)


def test_seeds_and_numbers_choose_episodes(kitchens: dict) -> None:
    env = stillroom.ArmPointNav(kitchens[1])
    hashes = [env.reset(seed=5)[1]["state_hash"], env.reset()[1]["state_hash"], env.reset()[1]["state_hash"]]
    assert len(set(hashes)) == 3
    for number in (2, 0, 1):
        _, info = env.reset(seed=5, options={"episode": number})
        assert (info["state_hash"], info["episode_number"]) == (hashes[number], number)
    assert stillroom.ArmPointNav(kitchens[1], number=1).reset(seed=5)[1]["state_hash"] not in hashes
    fresh = {stillroom.ArmPointNav(kitchens[1]).reset()[1]["state_hash"] for _ in range(2)}
    assert len(fresh) == 2, "without a seed episodes are random"


def test_fixed_and_drawn_episodes(kitchens: dict) -> None:
    assert (kitchens[8].fixed_episodes, kitchens[1].fixed_episodes) == (720, 0)
    env = stillroom.ArmPointNav(kitchens[8])
    targets = [env.reset(options={"fixed": number})[1]["target"] for number in range(12)]
    assert sorted(targets) == sorted(stillroom.TARGETS)
    # They do not depend on the seed, and the next one follows.
    first = env.reset(seed=1, options={"fixed": 3})[1]["state_hash"]
    assert env.reset(seed=2, options={"fixed": 3})[1]["state_hash"] == first
    assert env.reset()[1]["state_hash"] == env.reset(options={"fixed": 4})[1]["state_hash"]
    drawn = env.reset(seed=1, options={"drawn": 3})[1]["state_hash"]
    assert env.reset(seed=2, options={"drawn": 3})[1]["state_hash"] == drawn != first
    with pytest.raises(ValueError, match="0 to 719, not 720"):
        env.reset(options={"fixed": 720})
    with pytest.raises(ValueError, match="kitchen 1 has no fixed episodes"):
        stillroom.ArmPointNav(kitchens[1]).reset(options={"fixed": 0})


def test_rewards_are_composed_of_their_parts(kitchens: dict) -> None:
    def mine(parts: dict) -> float:
        return parts["failed_action"] + 100.0 * parts["disturbance_progress_m"]

    envs = [stillroom.ArmPointNav(kitchens[8], reward=reward) for reward in ("r", "r_prime", mine)]
    for env in envs:
        env.reset(options={"fixed": 0})
    failed = moved = 0
    for action in pushing(kitchens[8]):
        (r, info), (r_prime, _), (own, _) = [
            (reward, info) for _, reward, _, _, info in (env.step(action) for env in envs)
        ]
        parts = info["reward_parts"]
        task = -0.01 - 0.03 * parts["failed_action"] + 5 * parts["picked_up"] + 10 * parts["goal_success"]
        task += parts["wrist_object_progress_m"] + parts["object_goal_progress_m"]
        assert r == pytest.approx(task, abs=1e-6)
        assert r_prime == pytest.approx(task + 15 * parts["disturbance_progress_m"], abs=1e-5)
        assert own == pytest.approx(mine(parts))
        assert sum(info["displacement_m"].values()) == pytest.approx(info["disturbance_m"], abs=1e-5)
        failed += info["action_failed"]
        moved = max(moved, len(info["displacement_m"]))
    assert failed > 0 and moved > 0, "the test has seen failures and disturbance"


def test_depth_is_the_same_in_both_units_and_in_pictures(kitchens: dict) -> None:
    millimetres = stillroom.ArmPointNav(kitchens[1], render_mode="depth_array")
    metres = stillroom.ArmPointNav(kitchens[1], depth="float32", render_mode="rgb_array", render_side=128)
    (a, _), (b, _) = millimetres.reset(seed=1), metres.reset(seed=1)
    assert a["depth"].dtype == np.uint16 and a["depth"].shape == (224, 224)
    assert 300 < np.median(a["depth"]) < 5000, "a room is metres wide"
    assert np.allclose(b["depth"], a["depth"] / 1000.0, atol=1e-6)
    assert np.array_equal(millimetres.render(), b["depth"])
    before = metres.render()
    assert before.dtype == np.uint8 and before.shape[2] == 3 and before.std() > 20
    metres.step(metres.action_names.index("RotateRightContinuous"))
    assert not np.array_equal(metres.render(), before)
    assert not np.array_equal(a["depth"], millimetres.step(17)[0]["depth"]), "observations are copies"


def test_the_privileged_state_agrees_with_what_is_seen(kitchens: dict) -> None:
    env = stillroom.ArmPointNav(kitchens[1])
    observation, info = env.reset(seed=2)
    state = env.state()
    assert np.array_equal(state["wrist_to_object_m"], observation["goal"])
    assert np.linalg.norm(state["wrist_position_m"] - state["target_position_m"]) == pytest.approx(
        info["wrist_object_m"], abs=1e-5
    )
    place = state["object_positions_m"][state["target_object"]]
    assert np.array_equal(place, state["target_position_m"])
    assert len(kitchens[1].objects) == len(kitchens[1].masses_kg) == len(state["object_rotations_xyzw"])
    assert np.allclose(np.linalg.norm(state["object_rotations_xyzw"], axis=1), 1.0, atol=1e-4)


def test_what_is_told_is_what_the_task_declares(kitchens: dict) -> None:
    declared = tomllib.loads((REPOSITORY / "actor/simulator/src/tasks/arm_point_nav/task.toml").read_text())

    def named(role: str) -> list[str]:
        return [channel["name"] for channel in declared["channels"] if channel["role"] == role]

    _, info = stillroom.ArmPointNav(kitchens[1]).reset(seed=2)
    assert list(info["reward_parts"]) == named("part")
    assert set(named("outcome")) - set(info) == {"held"}


def test_a_scene_of_your_own() -> None:
    env = stillroom.ArmPointNav(scene=REPOSITORY / "scenes/studio/scene.toml")
    observation, _ = env.reset(seed=1)
    assert env.kitchen.number == 128 and observation["depth"].any()
    check_env(env, skip_render_check=True)
    with pytest.raises(ValueError, match=r"missing\.toml"):
        stillroom.ArmPointNav(scene="missing.toml")


def test_what_is_wrong_is_said(kitchens: dict) -> None:
    def make(**arguments: object) -> stillroom.ArmPointNav:
        return stillroom.ArmPointNav(kitchens[1], **arguments)

    for arguments, words in [
        ({"render_mode": "human"}, "opens no window"),
        ({"reward": "r2"}, 'none of "r"'),
        ({"depth": "uint8"}, 'none of "uint16"'),
        ({"action_space": "tiny"}, 'none of "large"'),
        ({"preset": "pepper"}, "paper"),
        ({"frame_side": 4}, "8 to 1024"),
        ({"max_steps": 0}, "max_steps"),
        ({"scene": "a.toml"}, "either a kitchen or a scene"),
        ({"render_side": 0}, "8 to 4096"),
        ({"reward": 3}, 'reward is 3, none of "r"'),
        ({"max_steps": -5}, "max_steps is -5, not 1 to 100000"),
        ({"frame_side": -224}, "frame_side is -224"),
        ({"frame_side": 2**40}, "frame_side is 1099511627776"),
    ]:
        with pytest.raises(ValueError, match=words):
            make(**arguments)
    for number in (28, -1, 2**40):
        with pytest.raises(ValueError, match=f"kitchen (is )?{number}"):
            stillroom.Kitchen(number)
    with pytest.raises(ValueError, match="kitchen is -3"):
        stillroom.VectorEnv(2, kitchens=[1, -3])
    env = make(max_steps=1)
    for options, error, words in [
        ({"episode": -1}, ValueError, "episode is -1"),
        ({"drawn": 2**32}, ValueError, "drawn is 4294967296"),
        ({"episode": 1.5}, TypeError, "episode is 1.5, not an integer"),
    ]:
        with pytest.raises(error, match=words):
            env.reset(options=options)
    with pytest.raises(ValueError, match=f"seed is {2**70}"):
        env.reset(seed=2**70)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(0)
    with pytest.raises(ValueError, match="no option 'mixed'"):
        env.reset(options={"mixed": 1})
    env.reset(seed=1)
    with pytest.raises(ValueError, match="action is 21, not 0 to 20"):
        env.step(21)
    for action in (1.7, np.array([1])):
        with pytest.raises(TypeError, match="not an integer"):
            env.step(action)
    assert env.step(0)[3]
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(0)


def test_kitchens_are_listed_by_their_splits() -> None:
    assert stillroom.kitchens("test") == [2, 8, 14, 20, 26]
    assert len(stillroom.kitchens("train")) == 19 and len(stillroom.kitchens("validation")) == 5
    with pytest.raises(ValueError, match='none of "train", "validation", "test"'):
        stillroom.kitchens("val")


def test_another_kitchen_is_another_room(kitchens: dict) -> None:
    frames = [stillroom.ArmPointNav(kitchen).reset(seed=1)[0] for kitchen in kitchens.values()]
    assert not same(*frames)
    assert same(frames[0], stillroom.ArmPointNav(1).reset(seed=1)[0])
