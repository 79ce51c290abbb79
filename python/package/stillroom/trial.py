"""An environment while it is tried before a run: each of its calls is checked as a run checks it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from stillroom.description import Described, Refused, check_numbers, check_seen
from stillroom.returned import kind, problem

Report = Callable[[str, str], None]


def no_report(_call: str, _place: str) -> None:
    """Nobody waits for the trial."""


class Tried:
    """Checks what `reset` and `step` return, and reports each call before it is made.

    Args:
        env: an environment, or a column among others.
        described: what its spaces say; without it only the number and kind of the returned values are checked.
        declared: channels that the user adds.
        report: is given a call's name, and where in the trial it is.
    """

    def __init__(
        self,
        env: Any,
        described: Described | None = None,
        declared: Sequence[dict[str, Any]] = (),
        report: Report = no_report,
    ) -> None:
        self._env, self._described, self._report = env, described, report
        observed = [] if described is None else [channel["name"] for channel in described.description["channels"]]
        added = {channel["name"]: channel for channel in declared if channel["role"] != "observation"}
        self._reward = added.pop("reward", {})
        self._of_info = {name: channel for name, channel in added.items() if name not in observed}
        self._seed, self._steps = 0, 0

    def __getattr__(self, name: str) -> Any:
        # Such as its spaces, and `get_state`.
        return getattr(self._env, name)

    def reset(self, *, seed: int) -> tuple[Any, Any]:
        """Begins an episode."""
        self._seed, self._steps = seed, 0
        self._report("reset()", self._place())
        returned = self._env.reset(seed=seed)
        self._judge("reset", returned)
        return returned

    def step(self, action: Any) -> tuple[Any, Any, Any, Any, Any]:
        """A step of the episode; the first is step 1."""
        self._steps += 1
        self._report("step()", self._place())
        returned = self._env.step(action)
        self._judge("step", returned)
        return returned

    def _place(self) -> str:
        what = f"step {self._steps}" if self._steps else "reset()"
        return f"{what} of the episode with seed {self._seed}"

    def _judge(self, method: str, returned: Any) -> None:
        try:
            if wrong := problem(method, returned):
                raise Refused(wrong)
            if self._described is not None:
                check_seen(self._described, returned[0], method)
                if method == "step":
                    self._check_numbers(returned[1], returned[-1])
        except Refused as refusal:
            raise Refused(f"{refusal} ({self._place()})") from None

    def _check_numbers(self, reward: Any, info: Any) -> None:
        if kind(reward) == "None" or getattr(reward, "size", 1) != 1:
            raise Refused(f"step()'s reward is {kind(reward)}, not a number")
        check_numbers("reward", reward, self._reward)
        for name, channel in self._of_info.items():
            if info.get(name) is None:
                raise Refused(f"info of the environment's step() has no `{name}`, which the declaration names")
            check_numbers(f"`{name}` in info", info.get(name), channel)
