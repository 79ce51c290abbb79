"""Every argument, with values of every wrong kind: the right result, or one sentence that names the argument."""

from __future__ import annotations

import copy
import gc
import pickle
import threading
import weakref
from collections.abc import Callable
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded

import stillroom
from conftest import checkpoint, random_action, same

WRONG = [
    *(None, True, False, np.True_, -1, 2**31, 2**32, 2**63, 2**64, 2**70, 10**5000, 1.0, 2.5, float("nan")),
    *(
        float("inf"),
        np.int64(-1),
        np.uint64(2**64 - 1),
        np.float32(1),
        np.array(-1),
        np.array(2.0),
        np.array([1]),
        np.ones(2),
    ),
    *("", "1", "x" * 300, "é", "\ud800", "a\0b", b"x", [], [1, 2, 3], [[1], 2], (None,), {}, {"a": 1}, set(), 1j),
    *(object(), int, iter([1]), np.array(["a"]), np.array([None]), np.datetime64("2026-01-01"), Path("nowhere")),
]
# What the binding, Python and numpy say of an argument that nobody checked.
BARE = (
    *("argument '", "object cannot be", "out of range integral", "convert negative int", "too large to convert"),
    *("truth value of an array", "unhashable", "has no attribute", "has no len", "not iterable", "not subscriptable"),
    *("can't encode", "Exceeds the limit", "only length-1", "list index", "Already", "inhomogeneous", "not supported"),
)


@pytest.fixture(scope="module")
def kitchen(kitchens: dict) -> stillroom.Kitchen:
    return kitchens[8]


def one(room: stillroom.Kitchen, **arguments: object) -> stillroom.ArmPointNav:
    return stillroom.ArmPointNav(**{"kitchen": room, "frame_side": 8, **arguments})


def many(room: stillroom.Kitchen, **arguments: object) -> stillroom.VectorEnv:
    return stillroom.VectorEnv(**{"num_envs": 3, "kitchens": room, "frame_side": 8, "threads": 1, **arguments})


def said(name: str, call: Callable[[], object]) -> None:
    """What `call` raises, if it does, is one documented error with the argument's name."""
    try:
        call()
    except (TypeError, ValueError, IndexError) as error:
        text = str(error)
        assert not any(bare in text for bare in BARE), f"{name}: {text}"
        # A file that is not there is named itself.
        assert name.strip() in text or "there is no such file" in text, f"{name}: {text}"
        assert len(text) < 400 and "\n" not in text, f"{name}: {text}"


TASK = (
    *("number", "preset", "reward", "disturbance_weight", "action_space", "max_steps", "start_distance_max_m"),
    *("goal_distance_max_m", "carried_goal", "depth", "frame_side", "render_mode", "render_side", "kitchen", "scene"),
)
MANY = ("num_envs", "kitchens", "scenes", "autoreset_mode", "threads", "copy", *TASK[1:13])


def test_constructors(kitchen: stillroom.Kitchen) -> None:
    for value in WRONG:
        for name in TASK:
            with_scene = {"kitchen": None} if name == "scene" else {}
            said(name, lambda: one(kitchen, **with_scene, **{name: value}).reset(seed=1))  # noqa: B023
        for name in MANY:
            # An environment of these sizes is made, and large.
            if not (name in ("num_envs", "threads") and isinstance(value, int)):
                with_scene = {"kitchens": None} if name == "scenes" else {}
                with_scene |= {"num_envs": 1} if name != "num_envs" else {}
                said(name.removesuffix("s"), lambda: many(kitchen, **with_scene, **{name: value}).reset(seed=1))  # noqa: B023
        said("kitchen", lambda: stillroom.Kitchen(value) if value is not None else None)  # noqa: B023
        said("scene", lambda: stillroom.Kitchen(scene=value) if value is not None else None)  # noqa: B023
        said("scene", lambda: stillroom.Kitchen(scene="nowhere.toml", scene_index=value))  # noqa: B023
        said("split", lambda: stillroom.kitchens(value))  # noqa: B023
        said("snapshot", lambda: stillroom.Snapshot.from_bytes(value))  # noqa: B023
        said("path", lambda: stillroom.load(value) if not isinstance(value, str | Path) else None)  # noqa: B023
        said("path", lambda: stillroom.read_run(value) if not isinstance(value, str | Path) else None)  # noqa: B023


def test_calls(kitchen: stillroom.Kitchen, tmp_path: Path) -> None:
    single, vector = one(kitchen, render_mode="rgb_array", render_side=8), many(kitchen)
    single.reset(seed=1)
    vector.reset(seed=1)
    checkpoint(tmp_path, 7, {"model.a": np.ones(4, np.float32)})
    for value in WRONG:
        for name, call in {
            "seed": lambda: single.reset(seed=value),  # noqa: B023
            "seed ": lambda: vector.reset(seed=value),  # noqa: B023
            "seed  ": lambda: vector.reset(seed=[0, value, None]),  # noqa: B023
            "option": lambda: single.reset(options=value),  # noqa: B023
            "option ": lambda: vector.reset(options=value),  # noqa: B023
            "episode": lambda: single.reset(options={"episode": value}),  # noqa: B023
            "episode ": lambda: vector.reset(options={"episode": value}),  # noqa: B023
            "drawn": lambda: vector.reset(options={"drawn": [0, value, 1]}),  # noqa: B023
            "option  ": lambda: single.reset(options={value: 1} if isinstance(value, str) else None),  # noqa: B023
            "reset_mask": lambda: vector.reset(options={"reset_mask": value}),  # noqa: B023
            "reset_mask ": lambda: vector.reset(options={"reset_mask": [True, value, True]}),  # noqa: B023
            "action": lambda: single.step(value),  # noqa: B023
            "action ": lambda: vector.step(value),  # noqa: B023
            "action  ": lambda: vector.step([0, value, 0]),  # noqa: B023
            "index": lambda: vector.state(value),  # noqa: B023
            "index ": lambda: vector.displacement_m(value),  # noqa: B023
            "index  ": lambda: vector.snapshot(value),  # noqa: B023
            "index   ": lambda: vector.restore(value, vector.snapshot(0)),  # noqa: B023
            "snapshot": lambda: single.restore(value),  # noqa: B023
            "snapshot ": lambda: vector.restore(0, value),  # noqa: B023
            "env": lambda: stillroom.oracle(value),  # noqa: B023
            "variant": lambda: stillroom.oracle(single, value),  # noqa: B023
            "rollout": lambda: stillroom.load(tmp_path, rollout=value),  # noqa: B023
            "verify": lambda: stillroom.load(tmp_path, verify=value),  # noqa: B023
            "reward": lambda: custom(kitchen, value),  # noqa: B023
        }.items():
            if single._ended:
                single.reset(seed=1)
            said(name, call)


def custom(kitchen: stillroom.Kitchen, value: object) -> None:
    """A reward function that returns this."""
    for env, action in ((one(kitchen, reward=lambda _: value), 0), (many(kitchen, reward=lambda _: value), [0] * 3)):
        env.reset(seed=1)
        env.step(action)


def test_a_part_that_a_reward_does_not_have_is_named_beside_those_that_are(kitchen: stillroom.Kitchen) -> None:
    function = {"reward": lambda parts: parts["nope"]}
    for env, action in ((one(kitchen, **function), 0), (many(kitchen, **function), [0] * 3)):
        env.reset(seed=1)
        with pytest.raises(KeyError, match="the reward has no part 'nope'; it has .*, "):
            env.step(action)


def test_ranges_are_said(kitchen: stillroom.Kitchen) -> None:
    single, vector = one(kitchen), many(kitchen)
    single.reset(seed=1)
    vector.reset(seed=1)
    huge = np.array([0, 2**63, 0], np.uint64)
    prime_only = 'counts with reward="r_prime" only'
    for call, error, words in [
        (lambda: one(kitchen, number=-1), ValueError, "number is -1, not 0 to 4294967295"),
        (lambda: one(2**64), ValueError, "kitchen is 18446744073709551616, not 1 to 9999999"),
        (lambda: stillroom.Kitchen(7.0), TypeError, "kitchen is 7.0, not an integer"),
        (lambda: stillroom.VectorEnv(2.0), TypeError, "num_envs is 2.0, not an integer"),
        (lambda: stillroom.VectorEnv(0), ValueError, "num_envs is 0, not 1 to 65536"),
        (lambda: vector.state(-1), IndexError, "index is -1, not 0 to 2"),
        (lambda: vector.snapshot(3), IndexError, "index is 3, not 0 to 2"),
        (lambda: vector.displacement_m(99), IndexError, "index is 99, not 0 to 2"),
        (lambda: vector.state(1.0), TypeError, "index is 1.0, not an integer"),
        (lambda: single.step(2**63), ValueError, "action is 9223372036854775808, not 0 to 20"),
        (lambda: single.step(True), TypeError, "action is True, not an integer"),
        (lambda: vector.step(huge), ValueError, "environment 1: there are actions 0 to 20, not 9223372036854775808"),
        (lambda: one(kitchen, disturbance_weight=15), ValueError, prime_only),
        (lambda: many(kitchen, disturbance_weight=15, reward=max), ValueError, prime_only),
        (lambda: one(kitchen, start_distance_max_m=np.nan), ValueError, "start_distance_max_m is NaN: it must be 0"),
        (lambda: one(kitchen, reward="r_prime", disturbance_weight=-1), ValueError, "disturbance_weight is -1: it "),
        (lambda: one(1, scene="a.toml"), ValueError, "either a kitchen or a scene"),
        (lambda: vector.reset(seed=2**64 - 2), ValueError, f"seed is {2**64 - 2}, not 0 to {2**64 - 3}"),
        (lambda: stillroom.oracle(one(kitchen, action_space="small")), ValueError, "needs all 21 actions"),
        (lambda: stillroom.load("models", rollout=-1), ValueError, "rollout is -1, not 0 to"),
        (lambda: stillroom.load(__file__, rollout=1), ValueError, "rollout chooses a checkpoint of a folder"),
    ]:
        with pytest.raises(error, match=words):
            call()


def test_a_reset_that_fails_leaves_all_as_they_are(kitchen: stillroom.Kitchen) -> None:
    env = many(kitchen, copy=True)
    observations, infos = env.reset(seed=1)
    chance = env.np_random.bit_generator.state
    for seed in (None, 5, [5, 6, 7]):
        with pytest.raises(ValueError, match="0 to 719, not 720"):
            env.reset(seed=seed, options={"fixed": [0, 720, 1]})
    assert env.np_random.bit_generator.state == chance
    assert [env.state(index)["state_hash"] for index in range(3)] == infos["state_hash"].tolist()
    assert same(dict(env._views), observations)


def test_whatever_counts_as_an_integer_is_taken(kitchen: stillroom.Kitchen) -> None:
    expected = None
    for number in (3, np.int64(3), np.uint64(3), np.uint8(3), np.array(3)):
        single = one(kitchen, number=number, max_steps=number, render_side=np.int64(64))
        vector = many(kitchen, num_envs=number, threads=number)
        hashes = [
            single.reset(seed=number, options={"episode": number})[1]["state_hash"],
            single.step(number)[4]["state_hash"],
            *vector.reset(seed=number, options={"episode": number})[1]["state_hash"],
            *vector.step(np.full(3, number))[4]["state_hash"],
            vector.state(np.array(2))["state_hash"],
        ]
        expected = expected or hashes
        assert hashes == expected


def test_actions_may_lie_in_any_array(kitchen: stillroom.Kitchen) -> None:
    env, expected = many(kitchen), None
    still = np.array([3, 4, 5])
    still.flags.writeable = False
    column = np.stack([still, still], 1)[:, 0]
    for actions in (still, [3, 4, 5], still.astype(">i2"), still.astype(np.uint64), column, column[::-1][::-1]):
        env.reset(seed=1)
        # What they leave behind is what the next step overwrites, and may be its actions.
        env.step(actions)
        observations, *_, infos = env.step(env._views["previous_action"])
        expected = expected or infos["state_hash"].tolist()
        assert infos["state_hash"].tolist() == expected
        assert observations["previous_action"].tolist() == [3, 4, 5]
    # Whoever makes its view read-only does not stop the environment.
    observations["depth"].flags.writeable = False
    env.step(actions)


@pytest.mark.parametrize("make", [one, many])
def test_nothing_is_answered_before_the_first_episode(kitchen: stillroom.Kitchen, make: Callable) -> None:
    env = make(kitchen, render_mode="rgb_array")
    index = () if make is one else (1,)
    calls = [env.render, lambda: env.step([0] * 3 if index else 0), stillroom.oracle(env)]
    calls += [lambda call=call: call(*index) for call in (env.state, env.snapshot, env.displacement_m)]
    for call in calls:
        with pytest.raises(ResetNeeded, match="reset"):
            call()
    if index:
        # One that has begun answers, and the others do not.
        _, infos = env.reset(seed=4, options={"reset_mask": [False, True, False]})
        assert infos["_step"].tolist() == [False, True, False]
        assert env.state(1)["seed"] == 5
        for call in (lambda: env.state(0), *calls[:3]):
            with pytest.raises(ResetNeeded):
                call()
    env.reset()
    for call in calls:
        call()
    seeds = {env.state(*([i] if index else []))["seed"] for i in range(3 if index else 1)}
    assert 0 not in seeds, "without a seed it is drawn"


@pytest.mark.parametrize("make", [one, many])
def test_a_closed_environment_is_free_and_says_so(make: Callable) -> None:
    kitchen = stillroom.Kitchen(3)
    env = make(kitchen, render_mode="rgb_array")
    oracle = stillroom.oracle(env)
    observations, _ = env.reset(seed=1)
    kept = {name: np.copy(array) for name, array in observations.items()}
    snapshot = env.snapshot(*([] if make is one else [0]))
    before = weakref_of_arrays(env)
    with env as same_env:
        assert same_env is env
    env.close()
    gc.collect()
    if make is one:
        assert before() is None, "the frames are free"
    assert same(dict(observations), kept), "what was observed stays"
    index = [] if make is one else [0]
    for call in [
        *(env.reset, env.render, oracle, lambda: stillroom.oracle(env)()),
        *(lambda: env.step(0 if make is one else [0] * 3), lambda: env.restore(*index, snapshot)),
        *(lambda: env.state(*index), lambda: env.snapshot(*index), lambda: env.displacement_m(*index)),
        *(lambda: env.kitchen if make is one else env.kitchens, lambda: env.batch),
    ]:
        with pytest.raises(ClosedEnvironmentError, match="is closed: make another one"):
            call()
    assert copy.deepcopy(env).action_space == pickle.loads(pickle.dumps(env)).action_space == env.action_space


def weakref_of_arrays(env: stillroom.ArmPointNav | stillroom.VectorEnv) -> weakref.ref:
    return weakref.ref(env._views["depth"].base)


def test_one_that_could_not_be_made_is_closed_in_silence(kitchen: stillroom.Kitchen) -> None:
    with pytest.raises(ValueError, match="max_steps"):
        many(kitchen, max_steps=0)
    gc.collect()


def advanced(env: stillroom.ArmPointNav | stillroom.VectorEnv, steps: int) -> list:
    """What some steps return."""
    found = []
    for step in range(steps):
        actions = [random_action(8, index, 0, step) for index in range(3)]
        observations, rewards, *_, infos = env.step(actions if isinstance(env, stillroom.VectorEnv) else actions[0])
        found.append((copy.deepcopy(observations), copy.copy(rewards), infos["state_hash"]))
    return found


@pytest.mark.parametrize("make", [one, many])
@pytest.mark.parametrize("copied", [copy.deepcopy, copy.copy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_to_the_same_bits(kitchen: stillroom.Kitchen, make: Callable, copied: Callable) -> None:
    # In the vector environment episodes end, and begin again, before and after the copy is made.
    steps = {"max_steps": 10} if make is many else {}
    env = make(kitchen, reward="r_prime", disturbance_weight=3, render_mode="depth_array", **steps)
    fresh = copied(env)
    with pytest.raises(ResetNeeded):
        fresh.step(0)
    env.reset(seed=4)
    advanced(env, 12)
    twin = copied(env)
    assert twin.observation_space == env.observation_space and twin.action_names == env.action_names
    expected, found = advanced(env, 12), advanced(twin, 12)
    for a, b in zip(expected, found, strict=True):
        assert same(a[0], b[0]) and np.array_equal(a[1], b[1]) and np.array_equal(a[2], b[2])
    # They share nothing.
    env.reset(seed=9)
    assert same(dict(found[-1][0]), dict(copy.deepcopy(twin._views))) if make is many else twin.state()["step"] == 24
    assert twin.reset()[1]["episode_number"] is not None
    env.close()
    twin.step([0] * 3 if make is many else 0)


def test_gymnasiums_wrappers_are_copied(kitchen: stillroom.Kitchen) -> None:
    env = gymnasium.make("stillroom/ArmPointNav-v0", kitchen=kitchen, frame_side=8)
    env.reset(seed=2)
    twin = copy.deepcopy(env)
    assert twin.step(3)[4]["state_hash"] == env.step(3)[4]["state_hash"]
    ended = one(kitchen, max_steps=1)
    ended.reset(seed=2)
    ended.step(0)
    with pytest.raises(ResetNeeded):
        copy.deepcopy(ended).step(0)


def test_two_threads_in_one_environment_are_refused_in_a_sentence(kitchen: stillroom.Kitchen) -> None:
    env = many(kitchen, num_envs=16, frame_side=224)
    env.reset(seed=1)
    refused: list[str] = []
    others: list[Exception] = []

    def work() -> None:
        for _ in range(30):
            try:
                env.step(np.full(16, 17))
                env.state(3)
            except RuntimeError as error:
                refused.append(str(error))
            except Exception as error:
                others.append(error)

    threads = [threading.Thread(target=work) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not others and refused and all("belongs to one thread at a time" in text for text in refused)
    # One after the other they may.
    done = threading.Thread(target=lambda: env.reset(seed=2))
    done.start()
    done.join()
    assert env.state(0)["seed"] == 2
