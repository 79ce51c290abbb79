"""Learning curves of Stillroom beside CleanRL and Stable-Baselines3, with the settings that the peers have for a task.

    make bench-curves ARGS="--tasks CartPole-v1,Pendulum-v1 --seeds 5 --jobs 2 --picture curves.png"

`cleanrl` has the defaults of CleanRL's single files, `sb3` the settings of RL Baselines3 Zoo (MiniGrid's are below);
`stillroom-cleanrl` and `stillroom-sb3` are Stillroom with the same, as far as it has them. A run has as many cores as
`--cores` says for all its processes; times are of the whole command. Runs that are in the results already are not
repeated. An Atari game wants `--device cuda`, and a task that only one peer has settings for is run with that one.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import runpy
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

CLEANRL = "https://raw.githubusercontent.com/vwxyzjn/cleanrl/fe8d8a03c41a7ef5b523e2e354bd01c363e786bb/cleanrl/"
SHA256 = {
    "ppo.py": "d8dfbb7ac0b21e747b77d6e6673e566db4d6cdacc83bcebcd19cf87ad0e459ae",
    "ppo_atari.py": "5fa8e1a1b609a6a5cc69ec7a4cddb957101f175e056a20471c7ac403182155b9",
    "ppo_continuous_action.py": "326dd8678bf9cc51abec833eb551ef2409a3804d604b689e1f0a084eca41f655",
}
# Episodes at the end of training whose mean return is a run's result; points of a curve.
LAST_EPISODES, POINTS = 100, 50
# A row of what a run leaves: frames so far, mean return of the episodes that ended there, how many.
Rows = list[tuple[int, float, int]]


class Recipe(NamedTuple):
    """PPO for a task. The network is two MLPs of 64 and 64 (tanh), and all else has the same value in all systems.

    A memory is an LSTM: Stable-Baselines3 has one for each of actor and critic, and the MLPs behind it; Stillroom has
    one LSTM behind one MLP. An Atari game has DQN's convolutions in their place.
    """

    frames: int
    environments: int
    steps: int
    minibatches: int
    epochs: int
    rate: float
    rate_falls: bool = False
    gamma: float = 0.99
    gae_lambda: float = 0.95
    entropy: float = 0.0
    # Of half the squared error: CleanRL's is 0.5 as here, Stable-Baselines3's is half of this.
    value: float = 1.0
    clip_value: bool = False
    normalize: bool = False
    bootstrap: bool = True
    clip: float = 0.2
    # The clip range falls as the rate does.
    clip_falls: bool = False
    # Stable-Baselines3 alone: state-dependent noise, drawn every so many steps.
    sde_steps: int = 0
    # Width of the LSTM, if there is one.
    memory: int = 0
    # Stillroom alone: the reward of each stage, all of as many frames.
    rewards: tuple[str, ...] = ("r",)


PPO = Recipe(500_000, 4, 128, 4, 4, 2.5e-4, True, entropy=0.01, value=0.5, clip_value=True, bootstrap=False)
CONTINUOUS = Recipe(1_000_000, 1, 2048, 32, 10, 3e-4, True, value=0.5, clip_value=True, normalize=True, bootstrap=False)
# The Zoo's `mujoco-defaults`, not what it has tuned for Hopper-v4 and HalfCheetah-v4.
MUJOCO = Recipe(1_000_000, 1, 2048, 32, 10, 3e-4, normalize=True)
ATARI = PPO._replace(frames=2_500_000, environments=8, clip=0.1)
# Those of lcswillems/rl-starter-files, which the Zoo's MiniGrid follows, for sb3-contrib's RecurrentPPO, but
# that the LSTM has 64 in place of 256, by which a run of the peer takes minutes and not an hour.
MEMORY = Recipe(400_000, 16, 128, 8, 4, 1e-3, entropy=0.01, memory=64)
# The Zoo's are of hyperparams/ppo.yml at 22e3ff24. CleanRL has none for Pendulum: the frames are the Zoo's.
RECIPES = {
    ("cleanrl", "CartPole-v1"): PPO,
    ("sb3", "CartPole-v1"): Recipe(100_000, 8, 32, 1, 20, 1e-3, True, 0.98, 0.8, clip_falls=True),
    ("cleanrl", "Acrobot-v1"): PPO,
    ("sb3", "Acrobot-v1"): Recipe(1_000_000, 16, 256, 64, 4, 3e-4, gae_lambda=0.94, normalize=True),
    ("cleanrl", "Pendulum-v1"): CONTINUOUS._replace(frames=100_000),
    ("sb3", "Pendulum-v1"): Recipe(100_000, 4, 1024, 64, 10, 1e-3, gamma=0.9, sde_steps=4),
    ("cleanrl", "Hopper-v5"): CONTINUOUS,
    ("sb3", "Hopper-v5"): MUJOCO,
    ("cleanrl", "HalfCheetah-v5"): CONTINUOUS,
    ("sb3", "HalfCheetah-v5"): MUJOCO,
    ("sb3", "MiniGrid-MemoryS7-v0"): MEMORY,
    ("cleanrl", "PongNoFrameskip-v4"): ATARI,
    ("cleanrl", "MetaWorld/Reach-v3"): CONTINUOUS._replace(frames=500_000),
}
PEERS = {"cleanrl": "CleanRL", "sb3": "SB3"}
# Whose these are.
SETTINGS = {"cleanrl": "CleanRL's", "sb3": "the Zoo's"}
# Colours of a report's charts.
INKS = {"Stillroom": "#0072b2", "CleanRL": "#d55e00", "SB3": "#009e73"}
PAPER, LINE, INK, SOFT = "#fbfaf8", "#e4e1db", "#22262c", "#5d646e"
TASKS = list(dict.fromkeys(task for _, task in RECIPES))
# Those of a minute come first; of the others all systems of a seed come before the next seed.
SHORT = TASKS[:3]
SYSTEMS = ["sb3", "cleanrl", "stillroom-sb3", "stillroom-cleanrl"]


def make_env(task: str) -> gym.Env:
    """A task as the peers have it, and Stillroom's actors if Gymnasium alone does not make it."""
    if task.startswith("MetaWorld"):
        from stillroom.pools import PoolEnv

        return PoolEnv(task)
    if not task.startswith("MiniGrid"):
        return gym.make(task)
    from minigrid.wrappers import ImgObsWrapper, OneHotPartialObsWrapper

    # The 7 x 7 cells in sight: kind, colour and state of each.
    cells = gym.spaces.Box(0.0, 1.0, (7 * 7 * 20,), np.float32)
    env = ImgObsWrapper(OneHotPartialObsWrapper(gym.make(task)))
    return gym.wrappers.TransformObservation(env, lambda seen: seen.ravel().astype(np.float32), cells)


def run_cleanrl(task: str, seed: int, recipe: Recipe, folder: Path) -> Rows:
    """CleanRL's file, which is of Gymnasium 0.29, as it is under Gymnasium 1, without its log."""
    rows: Rows = []
    is_atari = task.endswith("NoFrameskip-v4")

    # A game takes as long as the network: its environments have processes, which give the same numbers.
    class Noted(gym.vector.AsyncVectorEnv if is_atari else gym.vector.SyncVectorEnv):
        """Resets in the step that ends an episode, as 0.29 did."""

        def __init__(self, makers: Any) -> None:
            super().__init__(makers, autoreset_mode=gym.vector.AutoresetMode.SAME_STEP)
            self._frames = 0

        def step(self, actions: Any) -> Any:
            *seen, infos = super().step(actions)
            self._frames += self.num_envs
            if "episode" in (final := infos.get("final_info", {})):
                rows.extend((self._frames, float(one), 1) for one in final["episode"]["r"][final["_episode"]])
            return *seen, {}

    if is_atari:
        import ale_py
        from stable_baselines3.common import atari_wrappers

        gym.register_envs(ale_py)
        gym.wrappers.GrayScaleObservation = gym.wrappers.GrayscaleObservation
        gym.wrappers.FrameStack = gym.wrappers.FrameStackObservation
        # CleanRL has a copy of these.
        sys.modules["cleanrl_utils"] = sys.modules["cleanrl_utils.atari_wrappers"] = atari_wrappers
        name = "ppo_atari.py"
    else:
        made = gym.make
        gym.make = lambda task, **kwargs: make_env(task) if task.startswith("MetaWorld") else made(task, **kwargs)
        name = "ppo_continuous_action.py" if recipe.normalize else "ppo.py"
    transform = gym.wrappers.TransformObservation
    gym.vector.SyncVectorEnv = Noted
    gym.wrappers.TransformObservation = lambda env, change: transform(env, change, env.observation_space)
    log = SimpleNamespace(add_text=lambda *_: None, add_scalar=lambda *_: None, close=lambda: None)
    settings = {
        "env_id": task, "seed": seed, "total_timesteps": recipe.frames, "num_envs": recipe.environments,
        "num_steps": recipe.steps, "num_minibatches": recipe.minibatches, "update_epochs": recipe.epochs,
        "learning_rate": recipe.rate, "anneal_lr": recipe.rate_falls, "gamma": recipe.gamma,
        "gae_lambda": recipe.gae_lambda, "ent_coef": recipe.entropy, "vf_coef": recipe.value,
        "clip_vloss": recipe.clip_value, "clip_coef": recipe.clip,
    }  # fmt: skip
    stubs = {
        "tyro": SimpleNamespace(cli=lambda arguments: arguments(**settings)),
        "torch.utils.tensorboard": SimpleNamespace(SummaryWriter=lambda _: log),
    }
    sys.modules.update(stubs)  # type: ignore[arg-type]
    runpy.run_path(str(folder / name), run_name="__main__")
    return rows


def run_sb3(task: str, seed: int, recipe: Recipe, device: str) -> Rows:
    """As RL Baselines3 Zoo sets it up."""
    import stable_baselines3 as sb3
    from stable_baselines3.common import callbacks, env_util, vec_env

    rows: Rows = []

    class Note(callbacks.BaseCallback):
        def _on_step(self) -> bool:
            ended = (info["episode"] for info in self.locals["infos"] if "episode" in info)
            rows.extend((self.num_timesteps, float(episode["r"]), 1) for episode in ended)
            return True

    def falling(value: float, falls: bool) -> Any:
        return (lambda left: left * value) if falls else value

    algorithm: Any = sb3.PPO
    policy, widths = "MlpPolicy", {}
    if recipe.memory:
        from sb3_contrib import RecurrentPPO

        algorithm, policy, widths = RecurrentPPO, "MlpLstmPolicy", {"lstm_hidden_size": recipe.memory}
    env = env_util.make_vec_env(make_env, recipe.environments, seed=seed, env_kwargs={"task": task})
    model = algorithm(
        policy, vec_env.VecNormalize(env, gamma=recipe.gamma) if recipe.normalize else env,
        learning_rate=falling(recipe.rate, recipe.rate_falls), clip_range=falling(recipe.clip, recipe.clip_falls),
        n_steps=recipe.steps, batch_size=recipe.steps * recipe.environments // recipe.minibatches,
        n_epochs=recipe.epochs, gamma=recipe.gamma, gae_lambda=recipe.gae_lambda, ent_coef=recipe.entropy,
        vf_coef=recipe.value / 2, use_sde=recipe.sde_steps > 0, sde_sample_freq=recipe.sde_steps or -1,
        policy_kwargs=widths, seed=seed, device=device,
    )  # fmt: skip
    model.learn(recipe.frames, callback=Note())
    return rows


def stillroom_environment(task: str) -> tuple[list[str], int]:
    """Words that name the environment, and the limit of its steps."""
    examples = Path(__file__).parent / "examples"
    if task == "SafetyHopperVelocity-v1":
        words = [f"{examples}/cheetah.py:make_env", "--env-declaration", f"{examples}/cheetah.toml"]
        return [*words, "--env-kwargs", json.dumps({"task": "Hopper-v5", "limit_m_s": 0.7402})], 1000
    if task.endswith("NoFrameskip-v4"):
        kwargs = {"game": task.removesuffix("NoFrameskip-v4")}
        return [f"{examples}/atari.py:make_env", "--env-kwargs", json.dumps(kwargs)], 27_000
    if task.startswith("MetaWorld"):
        return [f"envpool:{task}"], 500
    env = make_env(task)
    if env.spec and env.spec.max_episode_steps:
        return [f"gymnasium:{task}"], env.spec.max_episode_steps
    limit: int = env.get_wrapper_attr("max_steps")
    return [f"{__file__}:make_env", "--env-kwargs", json.dumps({"task": task})], limit


def stillroom_words(task: str, seed: int, recipe: Recipe, folder: Path, options: argparse.Namespace) -> list[str]:
    """What `orchestrator` is called with."""
    divisors = (number for number in range(options.cores, recipe.environments) if recipe.environments % number == 0)
    actors = next(divisors, recipe.environments)
    environment, limit = stillroom_environment(task)
    settings = {
        "actors.count": actors, "actors.environments_per_actor": recipe.environments // actors,
        "episode.max_steps": limit, "ppo.rollout_steps": recipe.steps,
        "ppo.minibatches": recipe.minibatches, "ppo.epochs": recipe.epochs, "ppo.learning_rate": recipe.rate,
        "ppo.learning_rate_end": 0.0 if recipe.rate_falls else 1.0, "ppo.gamma": recipe.gamma,
        "ppo.gae_lambda": recipe.gae_lambda, "ppo.entropy_coefficient": recipe.entropy,
        "ppo.clip": recipe.clip, "ppo.clip_end": 0.0 if recipe.clip_falls else 1.0, "ppo.normalize_by_minibatch": True,
        "ppo.value_coefficient": recipe.value, "ppo.clip_value": recipe.clip_value,
        "ppo.bootstrap_time_limits": recipe.bootstrap, "normalize.observations": recipe.normalize,
        "normalize.rewards": recipe.normalize, "recording.enabled": False, "recording.tensorboard": False,
        "learner.device": options.device, "network.memory": "lstm" if recipe.memory else "none",
        "network.hidden": recipe.memory or 512,
    }  # fmt: skip
    words = ["up", "--preset", "gym", "--env", *environment, "--python", sys.executable, "--run", str(folder)]
    frames = recipe.frames // len(recipe.rewards)
    stages = [f'{{name = "{at}", reward = "{of}", frames = {frames}}}' for at, of in enumerate(recipe.rewards)]
    words += ["--seed", str(seed), "--set", f"stages=[{', '.join(stages)}]"]
    return words + [word for name, value in settings.items() for word in ("--set", f"{name}={json.dumps(value)}")]


def read_stillroom(folder: Path, metric: str = "episode/return") -> Rows:
    """A row a rollout in which episodes ended. Nothing has interrupted the run, so every line counts."""
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    found = ((line["frames"], line["metrics"]) for line in lines)
    return [(frames, of[metric], int(of["episode/count"])) for frames, of in found if of["episode/count"]]


def last(rows: Rows) -> float | None:
    """Mean of the last episodes."""
    values: list[float] = []
    for _, value, count in reversed(rows):
        values += [value] * min(count, LAST_EPISODES - len(values))
    return round(float(np.mean(values)), 3) if values else None


def result(rows: Rows, frames: int) -> dict[str, Any]:
    """Mean return of the last episodes, and of those that ended in each part of the training."""
    curve = [[0.0, 0] for _ in range(POINTS)]
    for at, value, count in rows:
        part = curve[min((at - 1) * POINTS // frames, POINTS - 1)]
        part[0], part[1] = part[0] + value * count, part[1] + count
    return {
        "final": last(rows),
        "curve": [round(total / count, 3) if count else None for total, count in curve],
    }


def recipe_of(system: str, task: str, options: argparse.Namespace) -> Recipe:
    """The settings, with other frames for a rehearsal."""
    recipe = RECIPES[system.removeprefix("stillroom-"), task]
    return recipe._replace(frames=options.frames) if options.frames else recipe


def timed(words: list[str], deadline: float, device: str) -> dict[str, float] | None:
    """Times of a command, on the cores of this thread; none if time is over before its end."""
    environment = os.environ | {"OMP_NUM_THREADS": "1"} | ({"CUDA_VISIBLE_DEVICES": ""} if device == "cpu" else {})
    with tempfile.TemporaryFile() as log:
        began = time.monotonic()
        process = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=log, stderr=log, env=environment)
        overdue = threading.Timer(deadline - began, process.terminate)
        overdue.start()
        _, status, used = os.wait4(process.pid, 0)
        ended = time.monotonic()
        overdue.cancel()
        process.returncode = os.waitstatus_to_exitcode(status)
        if ended >= deadline:
            return None
        if process.returncode:
            log.seek(max(0, log.seek(0, os.SEEK_END) - 2000))
            raise RuntimeError(f"{words[:4]} ended with {process.returncode}: {log.read().decode(errors='replace')}")
    return {"wall_s": round(ended - began, 2), "cpu_s": round(used.ru_utime + used.ru_stime, 2)}


def measure(job: Any, deadline: float, options: argparse.Namespace) -> dict[str, Any] | None:
    """A run in processes of its own; none if time is over before its end."""
    system, task, seed = job
    recipe, is_ours = recipe_of(system, task, options), system.startswith("stillroom")
    with tempfile.TemporaryDirectory(prefix="curves-") as place:
        run = Path(place, "run")
        words = [sys.executable, __file__, "--one", json.dumps([*job, str(run)]), "--cleanrl", str(options.cleanrl)]
        words += ["--frames", str(recipe.frames), "--device", options.device]
        if is_ours:
            words = [options.orchestrator, *stillroom_words(task, seed, recipe, run, options)]
        times = timed(words, deadline, options.device)
        if not times:
            return None
        rows = read_stillroom(run) if is_ours else json.loads(run.read_text())
    of = {"system": system, "task": task, "seed": seed, "frames": recipe.frames, "cores": options.cores}
    of |= {"device": options.device} if options.device != "cpu" else {}
    return of | times | result(rows, recipe.frames)


def run_all(jobs: list[Any], options: argparse.Namespace, measure: Callable[..., dict[str, Any] | None]) -> bool:
    """All runs, some at a time; whether none has failed."""
    there = sorted(os.sched_getaffinity(0))
    if len(there) < options.jobs * options.cores:
        sys.exit(f"bench-curves: {options.jobs} jobs of {options.cores} cores, but {len(there)} cores are there")
    deadline = time.monotonic() + options.seconds
    waiting, one_at_a_time, failures = iter(jobs), threading.Lock(), []

    def work(slot: int) -> None:
        # Of this thread, and so of the processes that it starts.
        os.sched_setaffinity(0, there[slot * options.cores : (slot + 1) * options.cores])
        while time.monotonic() < deadline:
            with one_at_a_time:
                job = next(waiting, None)
            if job is None:
                return
            try:
                run = measure(job, deadline, options)
            except (KeyError, OSError, RuntimeError, ValueError) as error:
                failures.append(job)
                print(f"bench-curves: {error}", file=sys.stderr)
                continue
            if run:
                with one_at_a_time, options.out.open("a") as out:
                    out.write(json.dumps(run) + "\n")
                print({name: value for name, value in run.items() if name != "curve"}, file=sys.stderr)

    workers = [threading.Thread(target=work, args=(slot,)) for slot in range(options.jobs)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    return not failures


def read(options: argparse.Namespace) -> list[dict[str, Any]]:
    """The runs that are there, with these frames and cores."""
    runs = [json.loads(line) for line in options.out.read_text().splitlines()] if options.out.exists() else []
    of = [(run, recipe_of(run["system"], run["task"], options).frames) for run in runs]
    at = (options.cores, options.device)
    return [run for run, frames in of if (run["frames"], run["cores"], run.get("device", "cpu")) == (frames, *at)]


def interval(values: list[float]) -> tuple[float, float, float]:
    """Interquartile mean over seeds (rliable, Agarwal et al. 2021), and the 95% interval of a bootstrap over them."""

    def iqm(of: np.ndarray) -> np.ndarray:
        cut = of.shape[-1] // 4
        return np.sort(of)[..., cut : of.shape[-1] - cut].mean(axis=-1)

    drawn = iqm(np.random.default_rng(0).choice(values, (10_000, len(values))))
    return float(iqm(np.asarray(values))), float(np.quantile(drawn, 0.025)), float(np.quantile(drawn, 0.975))


def pairs(runs: list[dict[str, Any]], task: str, peer: str) -> list[list[dict[str, Any]]]:
    """The peer's runs of a task in which episodes ended, and ours with its settings."""
    of = [run for run in runs if run["task"] == task and run["final"] is not None]
    return [[run for run in of if run["system"] == system] for system in (peer, f"stillroom-{peer}")]


def table(runs: list[dict[str, Any]]) -> str:
    """A row for each task and peer, in Markdown."""
    head = "| task | settings | frames | seeds | peer | Stillroom | frames/s: peer | Stillroom | times |"
    rows = [head, "|---" * 9 + "|"]
    for task, (peer, name) in ((task, peer) for task in TASKS for peer in PEERS.items()):
        both = pairs(runs, task, peer)
        if all(both):
            finals = [interval([one["final"] for one in of]) for of in both]
            returns = " | ".join("{:.4g} [{:.4g}, {:.4g}]".format(*final) for final in finals)
            seeds = ", ".join(dict.fromkeys(str(len(of)) for of in both))
            theirs, ours = (float(np.median([one["frames"] / one["wall_s"] for one in of])) for of in both)
            speeds = f"{theirs:,.0f} | {ours:,.0f} | {ours / theirs:.2f}"
            rows.append(f"| {task} | {name} | {both[0][0]['frames']:,} | {seeds} | {returns} | {speeds} |")
    return "\n".join(rows)


def draw(runs: list[dict[str, Any]], picture: Path) -> None:
    """IQM and interval of each part of the training, as reports draw curves: a row for each peer."""
    from matplotlib import lines, patches, pyplot

    tasks = [task for task in TASKS if any(run["task"] == task for run in runs)]
    figure, axes = pyplot.subplots(2, len(tasks), figsize=(5.4 * len(tasks), 8.4), squeeze=False, facecolor=PAPER)
    figure.subplots_adjust(0.045, 0.075, 0.975, 0.88, 0.24, 0.44)
    for (peer, name), row in zip(PEERS.items(), axes, strict=True):
        for task, axis in zip(tasks, row, strict=True):
            for of, label in zip(pairs(runs, task, peer), (name, "Stillroom"), strict=True):
                points = []
                for part in range(POINTS):
                    if values := [run["curve"][part] for run in of if run["curve"][part] is not None]:
                        points.append(((part + 1) / POINTS * of[0]["frames"], *interval(values)))
                if points:
                    frames, middle, low, high = zip(*points, strict=True)
                    axis.plot(frames, middle, INKS[label], linewidth=2)
                    axis.fill_between(frames, low, high, color=INKS[label], alpha=0.16, linewidth=0)
            axis.set_visible(bool(axis.lines))
            settle(axis, f"{task}, {SETTINGS[peer]} settings")
            if axis.lines:
                left, bottom, width, height = axis.get_position().bounds
                card = {"facecolor": "white", "edgecolor": LINE, "zorder": -1, "transform": figure.transFigure}
                corner, size = (left - 0.037, bottom - 0.06), (width + 0.053, height + 0.12)
                figure.add_artist(patches.FancyBboxPatch(corner, *size, "round,pad=0,rounding_size=0.006", **card))
    keys = [lines.Line2D([], [], color=ink, linewidth=2, label=name) for name, ink in INKS.items()]
    figure.legend(handles=keys, loc="upper left", ncols=3, frameon=False, fontsize=13, labelcolor=INK)
    figure.savefig(picture, dpi=100, facecolor=PAPER)
    pyplot.close(figure)


def settle(axis: Any, title: str) -> None:
    """Grid, numbers and title of a report's chart."""

    def short(value: float, _at: int) -> str:
        unit, letter = (1e6, "M") if value >= 1e6 else (1e3, "k") if value >= 1e3 else (1, "")
        return f"{value / unit:g}{letter}"

    axis.set_title(title, fontsize=13, fontweight="bold", loc="left", color=INK, pad=14)
    axis.set_facecolor("white")
    axis.spines[:].set_visible(False)
    axis.grid(color=LINE)
    axis.set_axisbelow(True)
    axis.tick_params(labelsize=11, length=0, labelcolor=SOFT)
    axis.xaxis.set_major_formatter(short)
    axis.locator_params(nbins=5)
    axis.set_xlabel("return over frames", fontsize=11, color=SOFT)
    axis.set_xlim(left=0)
    axis.margins(x=0)


def fetch(folder: Path) -> None:
    """CleanRL's files, once."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, digest in SHA256.items():
        if not (folder / name).exists():
            with urllib.request.urlopen(CLEANRL + name) as answer:
                (folder / name).write_bytes(answer.read())
        if hashlib.sha256((folder / name).read_bytes()).hexdigest() != digest:
            sys.exit(f"bench-curves: {folder / name} is not the file of the pinned commit: remove it")


def add_arguments(parser: argparse.ArgumentParser, out: Path) -> None:
    """Those of `run_all`."""
    parser.add_argument("--seeds", type=int, default=5, help="seeds of each, from 1 on: %(default)s")
    parser.add_argument("--jobs", type=int, default=1, help="runs at a time: %(default)s")
    parser.add_argument("--cores", type=int, default=1, help="cores of a run: %(default)s")
    parser.add_argument("--device", default="cpu", choices=["cpu", "cuda"], help="of all networks: %(default)s")
    parser.add_argument("--frames", type=int, help="other frames than the settings', for a rehearsal")
    parser.add_argument("--seconds", type=float, default=1e9, help="when runs that have not ended are given up")
    parser.add_argument("--out", type=Path, default=out, help="results: %(default)s")
    parser.add_argument("--orchestrator", default="orchestrator", help="%(default)s")


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--systems", default=",".join(SYSTEMS), help="%(default)s")
    parser.add_argument("--tasks", default=",".join(TASKS), help="%(default)s")
    add_arguments(parser, Path("curves.jsonl"))
    parser.add_argument("--picture", type=Path, help="a PNG of the curves, too")
    parser.add_argument("--cleanrl", type=Path, default=Path("cleanrl"), help="folder of CleanRL's files: %(default)s")
    parser.add_argument("--one", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.one:
        system, task, seed, rows = json.loads(options.one)
        of = (task, seed, recipe_of(system, task, options))
        found = run_sb3(*of, options.device) if system == "sb3" else run_cleanrl(*of, options.cleanrl)
        Path(rows).write_text(json.dumps(found))
        return
    tasks, seeds = options.tasks.split(","), range(1, options.seeds + 1)
    order = [(task, seed) for task in tasks if task in SHORT for seed in seeds]
    order += [(task, seed) for seed in seeds for task in tasks if task not in SHORT]
    jobs = [(system, task, seed) for task, seed in order for system in options.systems.split(",")]
    jobs = [job for job in jobs if (job[0].removeprefix("stillroom-"), job[1]) in RECIPES]
    done = {(run["system"], run["task"], run["seed"]) for run in read(options)}
    if "cleanrl" in options.systems.split(","):
        fetch(options.cleanrl)
    all_well = run_all([job for job in jobs if job not in done], options, measure)
    print(table(runs := read(options)))
    if options.picture:
        draw([run for run in runs if run["task"] in tasks], options.picture)
    sys.exit(not all_well)


if __name__ == "__main__":
    main()
