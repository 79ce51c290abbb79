"""Run folders and evaluations as data frames."""

from __future__ import annotations

import hashlib
import json
import os
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import stillroom

CONFIG = 'preset = "demo"\nseed = 3\n\n[ppo]\nlearning_rate = 1e-3\n'
EPISODES = (
    "kitchen,episode,category,objects,end,length,return_r,success,disturbance_m,pickup_step,prediction_hits,"
    "state_hash\n"
    "26,6,Potato,novel,terminated,102,17.7,1,0.25,40,,f704605d84d5a5a5\n"
    "27,7,Mug,novel,truncated,200,-1.5,0,0,,3,00000000000000ff\n"
)
KINDS = {"length": "count", "return_r": "f64", "success": "share", "disturbance_m": "f32", "pickup_step": "count"}
DESCRIBED = [
    {"name": name, "kind": kind, "label": "", "unit": "", "doc": f"What {name} is."} for name, kind in KINDS.items()
]


def line(rollout: int, frames: int, **metrics: float) -> str:
    """A line of metrics.jsonl."""
    row = {"rollout": rollout, "frames": frames, "stage": 0, "at_unix_s": 1795374391, "incarnation": 1}
    return json.dumps(row | {"timing": {"update_s": 0.5}, "metrics": metrics})


def folder(path: Path, **files: str) -> Path:
    """A run's folder with these files, `config` and others by their names."""
    path.mkdir(parents=True, exist_ok=True)
    for name, text in {"config.toml": CONFIG, **files}.items():
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_text(text)
    return path


def test_metrics_are_those_that_count(tmp_path: Path) -> None:
    lines = [
        line(0, 100, **{"episode/disturbance_m": 0.5, "loss/value": 1}),
        line(1, 200, **{"loss/value": 2}),
        line(2, 300, **{"loss/value": 3}),
        # A learner began again with its checkpoint: what came after is void.
        line(1, 200, **{"loss/value": 7}),
    ]
    run = stillroom.read_run(folder(tmp_path / "a", **{"metrics.jsonl": "\n".join([*lines, '{"rollout": 2, "fr'])}))
    assert run.kind == "run" and list(run.metrics.index) == [0, 1]
    assert list(run.metrics["loss/value"]) == [1.0, 7.0] and run.metrics["frames"].dtype == np.int64
    assert list(run.metrics["episode/disturbance_m"].isna()) == [False, True]
    assert run.metrics["at"].iloc[0] == pd.Timestamp("2026-11-22T19:06:31Z")
    units = run.metrics.attrs["units"]
    assert units["timing/update_s"].endswith("seconds") and units["episode/disturbance_m"].endswith("metres")
    assert run.configuration["ppo.learning_rate"] == 1e-3 and run.configuration["preset"] == "demo"
    for frame in (run.validation, run.episodes, run.evaluations, run.stages):
        assert len(frame) == 0
    assert run.summary == {}

    metrics = '[[metrics]]\nname = "success"\n[[metrics]]\nname = "success_without_disturbance"\n'
    run = stillroom.read_run(folder(tmp_path / "b", **{"task.toml": metrics}))
    assert run.evaluations[["success", "success_without_disturbance"]].empty


def test_rollouts_that_the_file_has_lost_are_those_of_the_checkpoint(tmp_path: Path) -> None:
    kept = "\n".join([line(0, 100), line(1, 200, **{"loss/value": 2}), line(2, 300)]) + "\n"
    manifest = {"run": "abc", "figures_sha256": hashlib.sha256(kept.encode()).hexdigest()}
    files = {
        "run.toml": 'id = "abc"\n',
        "checkpoints/rollout-00000003.json": json.dumps(manifest),
        "checkpoints/rollout-00000003.jsonl": kept,
        "metrics.jsonl": "\n".join([line(1, 200, **{"loss/value": 7}), line(3, 400), ""]),
    }
    run = stillroom.read_run(folder(tmp_path / "a", **files))
    assert list(run.metrics.index) == [0, 1, 2, 3] and run.metrics["loss/value"][1] == 7.0
    assert list(stillroom.read_run(folder(tmp_path / "b", **{**files, "metrics.jsonl": ""})).metrics.index) == [0, 1, 2]
    for other in ({"run.toml": 'id = "other"\n'}, {"checkpoints/rollout-00000003.jsonl": kept + " "}):
        assert list(stillroom.read_run(folder(tmp_path / "c", **{**files, **other})).metrics.index) == [1, 3]
    # A pipe in the place of one would be waited for.
    for name in ("checkpoints/rollout-00000003.json", "checkpoints/rollout-00000003.jsonl"):
        piped = folder(tmp_path / f"pipe{name[-1]}", **files)
        (piped / name).unlink()
        os.mkfifo(piped / name)
        assert list(stillroom.read_run(piped).metrics.index) == [1, 3]


def test_episodes_have_types(tmp_path: Path) -> None:
    result = {
        "format": 2,
        "described": DESCRIBED,
        "subject": {"preset": "demo", "frames": 4000, "weights": "ab"},
        "conditions": {"split": "test", "deterministic": False},
        "overall": {"episodes": 2, "success": 0.5, "disturbance_m": None, "prediction": {"hits": 3}},
        "kitchens": [],
    }
    files = {"evaluation.json": json.dumps(result), "episodes.csv": EPISODES}
    evaluation = stillroom.read_run(folder(tmp_path / "e", **files | {"config.toml": CONFIG + "[evaluation]\nx = 1\n"}))
    table = evaluation.episodes
    assert evaluation.kind == "evaluation" and evaluation.summary == result
    assert list(table["success"]) == [True, False] and table["success"].dtype == bool
    assert list(table["state_hash"]) == [0xF704605D84D5A5A5, 255] and table["state_hash"].dtype == np.uint64
    assert table["disturbance_m"].dtype == np.float32 and table["return_r"].dtype == np.float64
    assert table["prediction_hits"].isna().tolist() == [True, False] and table["prediction_hits"][1] == 3
    assert table["pickup_step"].isna().tolist() == [False, True] and table["pickup_step"][0] == 40
    assert table.attrs["units"]["disturbance_m"] == "What disturbance_m is, metres"
    assert evaluation.evaluations.attrs["units"]["success"] == "What success is, share, 0 to 1"
    assert table["category"].dtype == "category"
    assert table.groupby("category", observed=True)["length"].mean()["Mug"] == 200
    assert evaluation.evaluations.loc["e", "success"] == 0.5
    assert evaluation.evaluations.loc["e", "subject.frames"] == 4000
    assert np.isnan(evaluation.evaluations.loc["e", "disturbance_m"])

    inside = {f"evaluations/{name}/{file}": text for name in ("b", "a") for file, text in files.items()}
    run = stillroom.read_run(folder(tmp_path / "run", **inside))
    assert list(run.evaluations.index) == ["a", "b"] and list(run.episodes["evaluation"]) == ["a", "a", "b", "b"]
    assert run.episodes["category"].dtype == "category" and run.episodes["state_hash"].dtype == np.uint64


def test_summaries_and_validations(tmp_path: Path) -> None:
    tenth = {"episodes": 5, "mean_return": 1.5, "success": 0.25}
    summary = {"id": "x", "stages": [{"name": "I", "reward": "r", "frames": 9, "budget": 9, "last_tenth": tenth}]}
    score = {"rollout": 4, "frames": 900, "weights": "ab", "result": "r", "episodes": 8, "success": 1, "at_unix_s": 1}
    # One that was made at the next start comes after those of later rollouts; what is made again counts.
    rows = [score | {"rollout": 5}, score | {"success": 0.0}, score]
    files = {"summary.json": json.dumps(summary), "validation.jsonl": "".join(json.dumps(row) + "\n" for row in rows)}
    run = stillroom.read_run(folder(tmp_path / "a", **files))
    assert run.stages.loc["I", "last_tenth/mean_return"] == 1.5 and run.stages["frames"].dtype == np.int64
    assert list(run.validation.index) == [4, 5]
    assert run.validation.loc[4, "success"] == 1.0 and run.validation["episodes"].dtype == np.int64
    assert run.summary == summary


def test_what_cannot_be_read_is_said(tmp_path: Path) -> None:
    cases = [
        (tmp_path / "nowhere", "is no folder"),
        (tmp_path, "has no config.toml"),
        (folder(tmp_path / "toml", **{"config.toml": "x = ["}), "config.toml cannot be read"),
        (folder(tmp_path / "json", **{"summary.json": "[]"}), "summary.json holds no object"),
        (folder(tmp_path / "line", **{"metrics.jsonl": "x\n" + line(0, 1)}), "line 1 is damaged"),
    ]
    evaluation = CONFIG + "[evaluation]\n"
    for name, table, problem in [
        ("flag", EPISODES.replace("17.7,1", "17.7,2"), "column success: a flag is neither 0 nor 1"),
        ("column", EPISODES.replace("length", "lenght"), "there is no column lenght"),
        ("cells", EPISODES + "1,2\n", "is no table of episodes"),
        ("hash", EPISODES.replace("f704605d84d5a5a5", "1f704605d84d5a5a5"), "column state_hash"),
    ]:
        result = json.dumps({"format": 2, "described": DESCRIBED})
        files = {"config.toml": evaluation, "evaluation.json": result, "episodes.csv": table}
        cases.append((folder(tmp_path / name, **files), problem))
    for name, result, problem in [
        ("older", {"schema_version": 3}, "result of an older version, which the package of commit 0e4cae3e reads"),
        ("later", {"format": 9}, "has format 9, this package reads format 2"),
    ]:
        files = {"evaluations/e/evaluation.json": json.dumps(result)}
        cases.append((folder(tmp_path / name, **files), problem))
    for path, problem in cases:
        with pytest.raises(stillroom.RunError, match=problem):
            stillroom.read_run(path)


def test_no_file_of_a_folder_leads_out_of_it_or_is_without_an_end(tmp_path: Path) -> None:
    private = folder(tmp_path / "private", **{"evaluation.json": json.dumps({"format": 2})})
    (private / "rollout-00000001.json").write_text("{}")
    cases = []
    for name, content in [("config.toml", "link"), ("metrics.jsonl", "link"), ("evaluations/e", "folder")]:
        one = folder(tmp_path / name.partition("/")[0])
        (one / name).parent.mkdir(exist_ok=True)
        (one / name).unlink(missing_ok=True)
        (one / name).symlink_to(private if content == "folder" else private / "config.toml")
        cases.append((one, name))
    for name, size in [("metrics.jsonl", 257 << 20), ("summary.json", 17 << 20), ("config.toml", 5 << 20)]:
        one = folder(tmp_path / f"long-{name}")
        with (one / name).open("w") as file:
            file.truncate(size)
        cases.append((one, name))
    for one, name in cases:
        if name == "evaluations/e":
            assert not len(stillroom.read_run(one).evaluations), "a link to a folder is no evaluation"
            continue
        with pytest.raises(stillroom.RunError, match=f"{name} cannot be read"):
            stillroom.read_run(one)


@pytest.mark.parametrize("text", ["[" + "a." * 20_000 + "b]", "a" + ".a" * 20_000 + " = 1", "x = " + "[" * 50_000])
def test_no_text_takes_long(tmp_path: Path, text: str) -> None:
    begun = time.monotonic()
    with pytest.raises(stillroom.RunError, match="config.toml cannot be read"):
        stillroom.read_run(folder(tmp_path, **{"config.toml": text}))
    assert time.monotonic() - begun < 10
    rows = "".join(json.dumps({"rollout": at, "frames": at, "metrics": {f"m{at}": 1}}) + "\n" for at in range(20_000))
    with pytest.raises(stillroom.RunError, match="no run has so many figures"):
        stillroom.read_run(folder(tmp_path / "wide", **{"metrics.jsonl": rows}))
    assert time.monotonic() - begun < 20
