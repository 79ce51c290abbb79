"""`orchestrator export` of episodes: tables, arrays and LeRobot's reader hold what the environment gives for the same
actions."""

from __future__ import annotations

import io
import json
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from PIL import Image

import stillroom
from conftest import REPOSITORY
from stillroom.dataset import _Files, to_lerobot, to_parquet

# Of the libraries of others.
pytestmark = pytest.mark.filterwarnings("ignore")

# Those of a step that the environment tells under the same name.
SAME = (
    "disturbance_m",
    "peak_disturbance_m",
    "farthest_m",
    "wrist_object_m",
    "object_goal_m",
    "picked_up",
    "disturbed_objects",
    "ever_disturbed_objects",
    "target",
)
# The same under another one.
OTHER = {"goal_success": "success", "held": "holding", "failed_action": "action_failed"}
PARTS = ("wrist_object_progress_m", "object_goal_progress_m", "disturbance_progress_m")


@pytest.fixture(scope="session")
def orchestrator() -> Path:
    """The built program; it starts the others, which lie beside it."""
    program = Path(os.environ.get("STILLROOM_ORCHESTRATOR", REPOSITORY / "target/release/orchestrator"))
    if not program.exists():
        pytest.skip(f"{program} is not there: make build")
    return program


def call(program: Path, *words: object) -> subprocess.CompletedProcess[str]:
    """Runs it."""
    return subprocess.run([program, *map(str, words)], check=False, capture_output=True, text=True, timeout=240)


@pytest.fixture(scope="session")
def run(orchestrator: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short run that recorded."""
    folder = tmp_path_factory.mktemp("runs") / "a"
    words = ("--actors", 2, "--envs-per-actor", 1, "--frames", 1200, "--seed", 3, "--run", folder)
    done = call(orchestrator, "up", "--preset", "demo", *words)
    assert done.returncode == 0, done.stderr
    return folder


def export(program: Path, run: Path, out: Path, *words: object) -> Path:
    """Exports episodes."""
    done = call(program, "export", run, "--out", out, *words)
    assert done.returncode == 0, done.stderr
    assert "all as recorded" in done.stdout
    return out


def played(kitchen: int, episode: int, actions: list[int]) -> dict[str, Any]:
    """What the environment gives for these actions."""
    env = stillroom.ArmPointNav(kitchen, preset="demo", reward="r_prime")
    observation, info = env.reset(seed=3, options={"episode": episode})
    seen, told, rewards = [observation], [info], []
    for action in actions:
        observation, reward, terminated, truncated, info = env.step(action)
        seen.append({name: np.copy(value) for name, value in observation.items()})
        told.append(info | {"terminated": terminated, "truncated": truncated})
        rewards.append(reward)
    return {"seen": seen, "told": told, "rewards": rewards}


def depth_of(png: bytes) -> np.ndarray:
    """A frame from a 16-bit PNG."""
    return np.asarray(Image.open(io.BytesIO(png))).astype(np.uint16)


def arrays_of(program: Path, run: Path, out: Path, *words: object) -> Path:
    """Exports episodes as archives."""
    return export(program, run, out, "--format", "npz", *words)


def test_tables_hold_what_the_environment_gives(orchestrator: Path, run: Path, tmp_path: Path) -> None:
    out = tmp_path / "tables"
    to_parquet(arrays_of(orchestrator, run, tmp_path / "arrays", "--kitchen", 1, "--limit", 5), out)
    steps = pd.read_parquet(out / "steps.parquet")
    episodes = pd.read_parquet(out / "episodes.parquet")
    actions = json.loads(pq.read_schema(out / "steps.parquet").metadata[b"actions"])
    assert actions == stillroom.ACTIONS
    assert len(episodes) == 5 and episodes["steps"].sum() == len(steps)
    assert set(episodes["kitchen"]) == {1} and list(episodes["episode"]) == list(range(5))
    for _, about in episodes.iterrows():
        rows = steps.iloc[about["first_row"] : about["first_row"] + about["steps"]].reset_index(drop=True)
        assert set(rows["episode_index"]) == {about["episode_index"]} and list(rows["step"]) == list(range(len(rows)))
        truth = played(1, about["episode"], list(rows["action"]))
        for step, row in rows.iterrows():
            before, told = truth["seen"][step], truth["told"][step + 1]
            assert np.array_equal(depth_of(row["depth_png"]), before["depth"]), "bit for bit"
            assert np.array_equal(np.array(row["goal_m"], np.float32), before["goal"])
            assert row["previous_action"] == before["previous_action"]
            assert np.float32(truth["rewards"][step]) == np.float32(row["reward_r_prime"])
            for name in SAME:
                # Distances are told once of the vectors and once of the places.
                close = 1e-6 if name in ("wrist_object_m", "object_goal_m") else 0
                assert row[name] == (told[name] if name == "target" else pytest.approx(told[name], abs=close, rel=0)), (
                    name
                )
            for name, theirs in OTHER.items():
                assert row[name] == told[theirs], name
            for name in PARTS:
                assert np.float32(row[name]) == np.float32(told["reward_parts"][name]), name
            assert (row["terminated"], row["truncated"]) == (told["terminated"], told["truncated"])
            assert row["ended"] == (step + 1 == len(rows))
        assert np.array_equal(depth_of(about["last_depth_png"]), truth["seen"][-1]["depth"])
        assert np.array_equal(np.array(about["last_goal_m"], np.float32), truth["seen"][-1]["goal"])
        assert about["return_r_prime"] == pytest.approx(sum(truth["rewards"]))
        assert about["success"] == truth["told"][-1]["success"]
        assert about["disturbance_m"] == pytest.approx(truth["told"][-1]["disturbance_m"])
        assert about["outcome"] in ("failure", "time-limit", "success", "success-without-disturbance")


def test_arrays_hold_what_tables_hold(orchestrator: Path, run: Path, tmp_path: Path) -> None:
    words = ("--kitchen", 1, "--episode", "1,2", "--pictures", "robot,outside", "--side", 32)
    arrays, tables = arrays_of(orchestrator, run, tmp_path / "arrays", *words), tmp_path / "tables"
    to_parquet(arrays, tables)
    steps = pd.read_parquet(tables / "steps.parquet")
    files = sorted(arrays.glob("*.npz"))
    assert [file.name for file in files] == [f"episode-{number:06}.npz" for number in range(2)]
    for number, file in enumerate(files):
        episode = np.load(file, allow_pickle=False)
        rows = steps[steps["episode_index"] == number].reset_index(drop=True)
        assert episode["target_names"][episode["target"][0]] == rows["target"][0]
        assert int(episode["kitchen"]) == rows["kitchen"][0]
        assert episode["depth_mm"].shape == (len(rows) + 1, 224, 224) and episode["depth_mm"].dtype == np.uint16
        for name in ("robot", "outside"):
            pictures = episode[f"{name}_rgb"]
            assert pictures.shape == (len(rows) + 1, 32, 32, 3) and pictures.std() > 5
            assert np.array_equal(pictures[0], np.asarray(Image.open(io.BytesIO(rows[f"{name}_png"][0]))))
        for step, row in rows.iterrows():
            assert np.array_equal(episode["depth_mm"][step], depth_of(row["depth_png"]))
        for name in ("action", "reward_r", "disturbance_m", "goal_success", "ended"):
            assert np.array_equal(episode[name], rows[name]), name
            assert episode[name].dtype == rows[name].dtype
        assert np.array_equal(episode["state_hash"][1:], rows["state_hash"].to_numpy())
        assert np.array_equal(episode["previous_action"][1:], rows["action"])
        assert np.array_equal(episode["goal_m"][:-1], np.stack(rows["goal_m"]))


@pytest.fixture(scope="module")
def lerobot(orchestrator: Path, run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lerobot")
    to_lerobot(arrays_of(orchestrator, run, folder / "arrays", "--limit", 6), folder / "a")
    return folder / "a"


def test_lerobots_layout_is_whole(lerobot: Path) -> None:
    """What its reader relies on, for machines without it."""
    info = json.loads((lerobot / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    data = pq.read_table(lerobot / info["data_path"].format(chunk_index=0, file_index=0))
    episodes = pq.read_table(lerobot / "meta/episodes/chunk-000/file-000.parquet").to_pandas()
    tasks = pd.read_parquet(lerobot / "meta/tasks.parquet")
    assert set(data.column_names) == set(info["features"])
    assert (info["total_frames"], info["total_episodes"], info["total_tasks"]) == (len(data), 6, len(tasks))
    assert info["splits"] == {"train": "0:6"}
    steps = data.drop(["observation.images.depth"]).to_pandas()
    assert list(steps["index"]) == list(range(len(steps)))
    stats = json.loads((lerobot / "meta/stats.json").read_text())
    assert set(stats) == set(info["features"])
    for _, episode in episodes.iterrows():
        rows = steps.iloc[episode["dataset_from_index"] : episode["dataset_to_index"]]
        assert set(rows["episode_index"]) == {episode["episode_index"]} and len(rows) == episode["length"]
        assert list(rows["frame_index"]) == list(range(len(rows)))
        assert np.allclose(rows["timestamp"], rows["frame_index"] / info["fps"])
        assert [tasks.iloc[number].name for number in set(rows["task_index"])] == list(episode["tasks"])
        assert list(rows["next.done"]) == [False] * (len(rows) - 1) + [True]
        for name in ("action", "next.reward", "next.disturbance_m"):
            values = rows[name].to_numpy(np.float64)
            assert episode[f"stats/{name}/mean"] == pytest.approx(values.mean(), abs=1e-6)
            assert episode[f"stats/{name}/std"] == pytest.approx(values.std(), abs=1e-6)
            assert episode[f"stats/{name}/q90"] == pytest.approx(np.quantile(values, 0.9), abs=1e-6)
    for name in ("action", "next.reward", "observation.previous_action"):
        values = steps[name].to_numpy(np.float64)
        assert stats[name]["mean"] == pytest.approx([values.mean()], abs=1e-6)
        assert stats[name]["std"] == pytest.approx([values.std()], abs=1e-6)
    goals = np.stack(steps["observation.state"])
    assert stats["observation.state"]["min"] == pytest.approx(goals.min(0), abs=1e-6)
    frames = np.stack([depth_of(frame["bytes"]) for frame in data["observation.images.depth"].to_pylist()])
    depth = stats["observation.images.depth"]
    assert np.array(depth["mean"]).shape == (1, 1, 1)
    assert depth["mean"] == [[[pytest.approx(frames.mean(dtype=np.float64))]]]
    assert (depth["min"], depth["max"]) == ([[[frames.min()]]], [[[frames.max()]]])


def test_a_file_is_followed_by_the_next_before_it_is_too_large(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("stillroom.dataset.FILE_BYTES", 50_000)
    files, places = _Files(tmp_path), []
    for _ in range(4):
        files.add(pa.table({"noise": [os.urandom(20_000)]}))
        places.append(files.at)
    files.close()
    assert places == [(0, 0), (0, 0), (0, 1), (0, 1)]
    assert all(path.stat().st_size < 50_000 for path in tmp_path.glob("*/*.parquet"))


def test_lerobots_own_reader_takes_it(
    lerobot: Path, orchestrator: Path, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It brings torch with CUDA, 3 GB: CI has it not."""
    pytest.importorskip("lerobot", reason="lerobot is not installed: pip install lerobot")
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("local/stillroom", root=lerobot)
    arrays = arrays_of(orchestrator, run, tmp_path / "arrays", "--limit", 6)
    episodes = [np.load(file) for file in sorted(arrays.glob("*.npz"))]
    assert dataset.num_episodes == 6 and len(dataset) == sum(len(episode["action"]) for episode in episodes)
    at = 0
    for episode in episodes:
        for step, action in enumerate(episode["action"]):
            row = dataset[at]
            assert np.array_equal(row["observation.images.depth"].numpy()[0], episode["depth_mm"][step])
            assert np.array_equal(row["observation.state"].numpy(), episode["goal_m"][step])
            assert row["action"].item() == action
            assert row["task"].endswith(f"target {episode['target_names'][episode['target'][0]]}")
            assert row["next.reward"].item() == episode["reward_r_prime"][step]
            at += 1


def test_what_is_not_to_be_written_is_not(orchestrator: Path, run: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    there = call(orchestrator, "export", run, "--format", "npz", "--out", mine)
    assert there.returncode == 2 and "mine exists" in there.stderr
    none = call(
        orchestrator,
        "export",
        run,
        "--format",
        "npz",
        "--only",
        "success_without_disturbance",
        "--out",
        tmp_path / "none",
    )
    assert none.returncode == 1 and "nothing is written" in none.stderr
    filtered = call(orchestrator, "export", run, "--limit", 3, "--out", tmp_path / "policy.onnx")
    assert filtered.returncode == 2 and "choose episodes" in filtered.stderr
    missing = call(orchestrator, "export", run, "--format", "npz", "--kitchen", 9, "--out", tmp_path / "none")
    assert missing.returncode == 2 and "no kitchen 9" in missing.stderr
    assert {path.name for path in tmp_path.iterdir()} == {"mine"}, "nothing half done is left"
