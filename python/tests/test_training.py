"""A run from a script or a notebook."""

from __future__ import annotations

import linecache
from pathlib import Path

import gymnasium
import pytest

import stillroom
from stillroom.training import _place

ORCHESTRATOR = Path(__file__).parents[2] / "target/release/orchestrator"
EXAMPLES = Path(__file__).parents[1] / "examples"
needs_programs = pytest.mark.skipif(not ORCHESTRATOR.exists(), reason="needs `make build`")


def make_cart_pole(**kwargs):
    return gymnasium.make("CartPole-v1", **kwargs)


def start(tmp_path, make_env=make_cart_pole, **more):
    more = {"frames": 2000, "settings": {"ppo.rollout_steps": 32, "learner.device": "cpu"}} | more
    options = ["--actors", "2", "--envs-per-actor", "2"]
    return stillroom.train(make_env, run=tmp_path / "run", options=options, orchestrator=str(ORCHESTRATOR), **more)


@needs_programs
def test_a_run_is_watched_and_its_policy_loaded(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "states"))
    training = start(tmp_path).wait(120)
    assert (training.is_running, training.frames, training.budget, training.progress) == (False, 2000, 2000, 1.0)
    assert training.load().frames == 2000
    assert training.metrics["frames"].iloc[-1] == 2000
    with pytest.raises(stillroom.RunError, match="is there already"):
        start(tmp_path)
    checkpoint, run = training.load(), stillroom.read_run(training.path)
    for one, parts in [(checkpoint, ["2000 frames", "parameters"]), (run, ["run: task", "2000 frames"])]:
        assert "\n" not in repr(one) and len(repr(one)) < 300
        assert all(part in repr(one) for part in ["task make_cart_pole", str(tmp_path), *parts]), repr(one)
    with pytest.raises(ValueError, match="make_cart_pole is no task of the kitchens: .* made by its own code"):
        checkpoint.environment()


@needs_programs
def test_a_network_takes_observations_by_their_names(tmp_path, monkeypatch):
    torch = pytest.importorskip("torch")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "states"))
    network = start(tmp_path).wait(120).load().network()
    assert "\n" not in repr(network) and "observation [rows, 4] to 2 outputs" in repr(network)
    seen = torch.tensor([[0.1, -0.2, 0.3, 0.4]])
    with torch.no_grad():
        by_name, by_order = (network({name: seen}, network.begin())[0] for name in ("observation", "numbers"))
    assert torch.equal(by_name, by_order)
    for wrong in [
        {"observation": seen[0]},
        {"observation": seen[:, :3]},
        {"numbers": seen[:, :3]},
        {"other": seen},
        seen,
    ]:
        with pytest.raises(ValueError, match=r"observation \[rows, 4\]"):
            network(wrong, network.begin())
    # Whole numbers are one-hot.
    network.channels, network.numbers = [("two", [2], (-1, 2))], 4
    given = network.by_name({"two": torch.tensor([[-1, 0], [0, 0]])})
    assert given["numbers"].tolist() == [[1, 0, 0, 1], [0, 1, 0, 1]]


@needs_programs
def test_a_run_is_stopped_before_its_end(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "states"))
    training = start(tmp_path, frames=50_000_000)
    with pytest.raises(TimeoutError):
        training.wait(0.1)
    training.stop()
    assert not training.is_running and training.progress < 1.0


@needs_programs
def test_what_is_wrong_is_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "states"))
    with pytest.raises(stillroom.RunError, match="the environment cannot be made"):
        start(tmp_path, "gymnasium:NoSuchThing-v0")
    with pytest.raises(stillroom.RunError, match=r"no\.such\.setting|no such"):
        start(tmp_path, settings={"no.such.setting": 1})
    with pytest.raises(stillroom.RunError, match=r"tip: here it is `--set ppo.learning_rate=1`"):
        start(tmp_path, settings={"lr": 1})
    with pytest.raises(stillroom.RunError, match="there is no program"):
        stillroom.train(make_cart_pole, frames=1, orchestrator="no-such-program")


def test_what_another_program_says_in_the_place_of_ours_is_passed_on(tmp_path):
    program = tmp_path / "orchestrator"
    program.write_text("#!/bin/sh\necho 'orchestrator: this wheel has no programs' >&2\nexit 1\n")
    program.chmod(0o755)
    with pytest.raises(stillroom.RunError, match="ended with 1: orchestrator: this wheel has no programs"):
        stillroom.train(make_cart_pole, frames=1, run=tmp_path / "run", orchestrator=str(program))


STAGES = [{"name": name, "reward": name, "frames": 128} for name in ("r", "careful", "constrained")]


# No more than a few rollouts: that all parts fit together.
@needs_programs
@pytest.mark.parametrize(
    ("env", "needs", "words", "settings"),
    [
        ("envpool:CartPole-v1", ["envpool"], [], {}),
        ("atari.py:make_env", ["ale_py", "cv2"], ["--config", "atari.toml"], {"ppo.epochs": 1}),
        (
            "cheetah.py:make_env",
            ["mujoco"],
            ["--config", "cheetah_stages.toml", "--env-declaration", "cheetah.toml"],
            {"stages": STAGES},
        ),
    ],
)
def test_an_example_is_trained_on(env, needs, words, settings, tmp_path, monkeypatch):
    for package in needs:
        pytest.importorskip(package)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "states"))
    env = env if env.startswith("envpool") else str(EXAMPLES / env)
    words = [word if word.startswith("--") else str(EXAMPLES / word) for word in words]
    options = [*words, "--preset", "gym", "--actors", "2", "--envs-per-actor", "2"]
    settings = {"ppo.rollout_steps": 32, "ppo.minibatches": 1, "learner.device": "cpu"} | settings
    training = stillroom.train(
        env, run=tmp_path / "run", frames=384, settings=settings, options=options, orchestrator=str(ORCHESTRATOR)
    ).wait(300)
    assert (training.frames, training.budget) == (384, 384)
    if "stages" in settings:
        assert "lagrangian/multiplier" in (training.path / "metrics.jsonl").read_text()


# Without memory half of the turns are right.
@needs_programs
@pytest.mark.parametrize("memory", ["gru", "lstm", "none"])
def test_what_was_shown_at_the_start_is_remembered(memory, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "states"))
    settings = {"network.memory": memory, "network.hidden": 32, "ppo.rollout_steps": 64, "learner.device": "cpu"}
    env, program = str(EXAMPLES / "t_maze.py:make_env"), str(ORCHESTRATOR)
    training = stillroom.train(
        env, run=tmp_path / "run", frames=10_240, settings=settings, options=["--preset", "gym"], orchestrator=program
    ).wait(300)
    mean = training.metrics["episode/return"].tail(5).mean()
    assert abs(mean) < 0.5 if memory == "none" else mean > 0.9


def test_a_function_of_a_notebook_lies_beside_the_run(tmp_path):
    def cell(text):
        name = f"<cell {len(text)}>"
        linecache.cache[name] = (len(text), None, text.splitlines(True), name)
        space = {"__name__": "__main__", "gymnasium": gymnasium, "__builtins__": __builtins__}
        exec(compile(text, name, "exec"), space)
        return space["make_env"]

    import sys

    main, sys.modules["__main__"] = sys.modules["__main__"], type(sys)("__main__")
    try:
        whole = cell("def make_env():\n    import gymnasium\n    return gymnasium.make('CartPole-v1')\n")
        file, _, name = _place(whole, tmp_path / "run").rpartition(":")
        assert (Path(file).parent, name) == (tmp_path, "make_env")
        assert "import gymnasium" in Path(file).read_text()
        with pytest.raises(stillroom.RunError, match="uses `gymnasium` of the notebook"):
            _place(cell("def make_env():\n    return gymnasium.make('CartPole-v1')\n"), tmp_path / "run")
    finally:
        sys.modules["__main__"] = main
    with pytest.raises(stillroom.RunError, match="not inside another"):
        _place(lambda: None, tmp_path / "run")
