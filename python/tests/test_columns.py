"""Vector environments in a run: a column is what a single environment is, whatever its vector's autoreset mode."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

from stillroom.columns import Among, Vector, check_sizes, halves, takes_size
from stillroom.description import Refused
from stillroom.determinism import prove
from stillroom.pools import PoolEnv


class Walk(gymnasium.Env):
    """A random walk that ends after 5 to 9 steps, and says how far it went."""

    observation_space = gymnasium.spaces.Dict({"at": gymnasium.spaces.Box(-1e3, 1e3, (2,), np.float64)})
    action_space = gymnasium.spaces.Discrete(3)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.left, self.at = int(self.np_random.integers(5, 10)), self.np_random.normal(size=2)
        return {"at": self.at.copy()}, {"start": float(self.at[0])}

    def step(self, action):
        self.left -= 1
        self.at += self.np_random.normal(size=2) * (action + 1)
        return {"at": self.at.copy()}, float(self.at[1]), self.left == 0, False, {"far": float(abs(self.at).sum())}


class Masked(Walk):
    """Fails if a forbidden action is taken; at its end it allows nothing."""

    def reset(self, *, seed=None, options=None):
        seen, info = super().reset(seed=seed)
        return seen, info | self._mask()

    def step(self, action):
        assert self.mask[action]
        *seen, info = super().step(action)
        return *seen, info | self._mask()

    def _mask(self):
        self.mask = (self.np_random.random(3) < 0.3) | (np.arange(3) == self.np_random.integers(3))
        return {"action_mask": self.mask.astype(np.int8) * (self.left > 0)}


def vector(mode, kind=SyncVectorEnv, count=3):
    return Vector(kind([Walk] * count, autoreset_mode=mode))


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_columns_are_single_environments_whoever_acts(mode):
    """Columns act or do not, begin episodes when they have ended, and other ones in their middle."""
    random = np.random.default_rng(3)
    served, alone = vector(mode), [Walk() for _ in range(3)]
    for index, (column, env) in enumerate(zip(served.columns, alone, strict=True)):
        assert_same(column.reset(seed=index), env.reset(seed=index), "start")
    for step in range(300):
        actions = [None if random.random() < 0.1 else int(random.integers(3)) for _ in alone]
        served.take(actions)
        for index, (column, env, action) in enumerate(zip(served.columns, alone, actions, strict=True)):
            if action is None:
                continue
            given, expected = column.step(action), env.step(action)
            assert given[1:4] == expected[1:4], (step, index)
            assert_same((given[0], given[4]), (expected[0], expected[4]), "far")
            if expected[2] or random.random() < 0.05:
                seed = int(random.integers(1 << 31))
                assert_same(column.reset(seed=seed), env.reset(seed=seed), "start")


def assert_same(given, expected, key):
    assert np.array_equal(given[0]["at"], expected[0]["at"])
    assert given[1][key] == expected[1][key]
    with pytest.raises(KeyError):
        given[1]["nothing"]


def test_a_vector_whose_columns_have_seeds_of_their_own_is_proven():
    for mode in AutoresetMode:
        prove(Among(vector(mode)), Walk)
        prove(Among(Vector(SyncVectorEnv([Masked] * 3, autoreset_mode=mode))), Masked)
    served = vector(AutoresetMode.NEXT_STEP, AsyncVectorEnv, 2)
    prove(Among(served), Walk)


class Deaf(SyncVectorEnv):
    """Resets all when one is to be reset."""

    def reset(self, *, seed=None, options=None):
        return super().reset(seed=seed)


class Coupled(SyncVectorEnv):
    """What a column sees depends on the others."""

    def step(self, actions):
        seen, *rest = super().step(actions)
        return {"at": seen["at"] + np.sum(actions)}, *rest


def test_a_vector_that_a_run_cannot_rebuild_is_refused_in_a_sentence():
    for kind in (Deaf, Coupled):
        with pytest.raises(Refused, match=r"the environment does not repeat itself.*reset_mask"):
            prove(Among(vector(AutoresetMode.NEXT_STEP, kind)), Walk)
    with pytest.raises(Refused, match="takes no seed for each column"):
        prove(Among(Vector(gymnasium.make_vec("CartPole-v1", 3, vectorization_mode="vector_entry_point"))), Walk)
    nameless = SyncVectorEnv([Walk])
    nameless.metadata = {}
    with pytest.raises(Refused, match="autoreset_mode"):
        Vector(nameless)


def test_vectors_are_the_halves_of_an_actors_environments():
    assert [halves(count) for count in (1, 2, 5, 16)] == [[1], [1, 1], [3, 2], [8, 8]]
    assert takes_size(lambda num_envs: num_envs) and not takes_size(lambda: 0)
    check_sizes([vector(AutoresetMode.DISABLED)] * 2, 6)
    with pytest.raises(Refused, match="--envs-per-actor 6"):
        check_sizes([vector(AutoresetMode.DISABLED)] * 2, 8)


# Its spaces are of other types than their bounds.
@pytest.mark.filterwarnings("ignore:.*precision lowered by casting")
def test_an_environment_of_envpool_has_a_pool_for_each_episode():
    envpool = pytest.importorskip("envpool")
    prove(PoolEnv("CartPole-v1"), Walk)
    with pytest.raises(Refused, match="--env envpool:ID"):
        Vector(envpool.make("CartPole-v1", env_type="gymnasium", num_envs=2))
