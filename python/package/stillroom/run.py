"""Run folders and evaluations as tables of pandas."""

from __future__ import annotations

import csv
import hashlib
import json
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stillroom._stillroom import list_of_run, read_of_run, shown, toml_as_json

if TYPE_CHECKING:
    import pandas as pd

# A table with more cells is none of ours: half a million rollouts have a third of them.
CELLS_MOST = 100_000_000

UNITS = {"_m": "metres", "_s": "seconds", "_rad": "radians"}
SHARE, STEPS, COUNT = "share, 0 to 1", "steps", "count"

COLUMNS = {
    "rollout": "number of the rollout, from 0",
    "frames": "frames trained on",
    "stage": "stage, from 0",
    "at": "when, UTC",
    "incarnation": "which start of the run",
    "timing/simulate_s": "waiting for simulation",
    "timing/infer_s": "inference of the policy",
    "timing/update_s": "PPO epochs",
    "timing/exchange_s": "summing gradients over learners, a part of the update",
    "timing/other_s": "everything else",
    "episode/count": COUNT,
    "episode/return": "undiscounted, under the stage's reward",
    "episode/length": STEPS,
    "policy/entropy": "nats",
    "policy/clip_fraction": SHARE,
    "kitchen": "number of the kitchen",
    "episode": "number of the episode within the kitchen",
    "category": "category of the target, where the task has targets",
    "objects": "seen or novel",
    "end": "terminated or truncated",
    "terminated": "whether the task ended the episode",
    "length": STEPS,
    "state_hash": "hash of the last state",
    "episodes": COUNT,
    "budget": "frames that it is to have",
    "weights": "SHA-256 of the weights",
}

# Columns of episodes.csv by type, beside the returns and metrics of the task, which evaluation.json describes.
EPISODES = {
    "kitchen": "int64",
    "episode": "int64",
    "category": "category",
    "objects": "category",
    "end": "category",
    "length": "int64",
    "prediction_hits": "Int64",
    "prediction_misses": "Int64",
    "prediction_false_alarms": "Int64",
    "prediction_quiet": "Int64",
    "state_hash": "uint64",
    "distribution": "category",
}
KINDS = {"share": "bool", "count": "Int64", "f32": "float32", "f64": "float64"}
# Of evaluation.json. One of an older form has none.
FORMAT = 2
INTEGERS = ("rollout", "frames", "stage", "incarnation", "episodes", "budget", "seed", "parameters", "steps", "kitchen")


class RunError(ValueError):
    """A path holds no run or evaluation that can be read."""


@dataclass(frozen=True)
class Run:
    """What a run or an evaluation leaves, as data frames. `frame.attrs["units"]` says what each column is, and in which
    unit. A frame of what is not there has no rows."""

    path: Path
    """The folder."""
    kind: str
    """"run" or "evaluation"."""
    metrics: pd.DataFrame
    """A row a trained rollout, indexed by its number: frames, stage, times, and all figures of metrics.jsonl."""
    validation: pd.DataFrame
    """A row a validation, indexed by the rollout of the checkpoint."""
    episodes: pd.DataFrame
    """A row an episode of an evaluation; of a run those of all its evaluations, named in the column `evaluation`."""
    evaluations: pd.DataFrame
    """A row an evaluation, indexed by its name: conditions and figures of all its episodes."""
    stages: pd.DataFrame
    """A row a stage of a run that has ended, indexed by its name: figures of the whole stage, of its first tenth and of
    its last tenth."""
    summary: dict[str, Any]
    """summary.json, or evaluation.json of an evaluation; empty where there is none yet."""
    config: dict[str, Any]
    """The configuration."""

    def __repr__(self) -> str:
        """Which one it is, in a line."""
        frames = f", {self.metrics['frames'].iloc[-1]} frames" if len(self.metrics) else ""
        return f"<{self.kind} {self.path.name}: task {self.config.get('task', 'arm_point_nav')}{frames}, {self.path}>"

    @property
    def configuration(self) -> pd.Series:
        """The configuration with one row a key, such as `ppo.learning_rate`: for tables of several runs."""
        import pandas as pd

        flat = _flat(self.config)
        return pd.Series(list(flat.values()), index=pd.Index(flat, name="key"), dtype=object, name=self.path.name)


def read_run(path: str | PathLike[str]) -> Run:
    """Reads the folder of a run or of an evaluation, also while it runs. Needs pandas.

    Of `metrics.jsonl` those lines are read that count: a line makes all before it with the same or a higher rollout
    void. Of `validation.jsonl` the last line of each rollout is read. A last line that is cut off is left out. Any
    other damaged line is an error. Whatever is wrong with a folder is a `RunError`.
    """
    if not isinstance(path, str | PathLike):
        raise TypeError(f"path is {shown(path)}, not a path")
    try:
        import pandas  # noqa: F401
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("stillroom.read_run needs pandas: pip install pandas") from error
    try:
        return _run(Path(path))
    except RunError:
        raise
    # The folder may be anybody's, and what is in its files of any shape.
    except (ArithmeticError, AttributeError, LookupError, OSError, RecursionError, TypeError, ValueError) as error:
        raise RunError(f"{path} holds what no run of this version does: {error}") from error


def read_progress(path: Path) -> tuple[int, int]:
    """Frames that a run has trained on, and those that it is to have. Needs no pandas."""
    files = _Files(path)
    try:
        budget = sum(int(stage["frames"]) for stage in (files.toml("config.toml") or {})["stages"])
        lines = files.lines("metrics.jsonl", voids=True)
        return int(lines[-1]["frames"]) if lines else 0, budget
    except (LookupError, TypeError, ValueError) as error:
        raise RunError(f"{path} holds what no run of this version does: {error}") from error


def _run(path: Path) -> Run:
    if path.is_file() and path.name in ("evaluation.json", "episodes.csv", "summary.json", "config.toml"):
        path = path.parent
    if not path.is_dir():
        raise RunError(f"{path} is no folder: give that of a run or of an evaluation")
    files = _Files(path)
    config = files.toml("config.toml")
    if config is None:
        raise RunError(f"{path} is no folder of a run or of an evaluation: it has no config.toml")
    if "evaluation" in config:
        return _evaluation(files, config)
    summary = files.json("summary.json") or {}
    read = {name: _result(files, f"{name}/evaluation.json") for name in files.folders("evaluations")}
    results = {name: result for name, result in read.items() if result}
    declared = _declared(files)
    return Run(
        path=path,
        kind="run",
        metrics=_metrics(files, declared),
        validation=_validation(files, declared),
        episodes=_all_episodes(files, results),
        evaluations=_results(results, declared),
        stages=_stages(summary),
        summary=summary,
        config=config,
    )


def _evaluation(files: _Files, config: dict[str, Any]) -> Run:
    name = files.root.name
    result = _result(files, "evaluation.json")
    results = {name: result} if result else {}
    described = _described(results.values())
    return Run(
        path=files.root,
        kind="evaluation",
        metrics=_metrics(files, described),
        validation=_validation(files, described),
        episodes=_episodes(files, "episodes.csv", described),
        evaluations=_results(results, described),
        stages=_stages({}),
        summary=results.get(name, {}),
        config=config,
    )


class _Files:
    """The files of a run folder, which may be anybody's. Whatever is not there is None, or nothing."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def text(self, name: str) -> str | None:
        path = self.root / name
        try:
            return read_of_run(self.root, path).decode()
        except FileNotFoundError:
            return None
        except (OSError, UnicodeDecodeError) as error:
            raise RunError(f"{path} cannot be read: {error}") from error

    def json(self, name: str) -> dict[str, Any] | None:
        return self._table(name, self.text(name))

    def toml(self, name: str) -> dict[str, Any] | None:
        return self._table(name, self.text(name), toml_as_json)

    def _table(self, name: str, text: str | None, as_json: Callable[[str], str] = str) -> dict[str, Any] | None:
        if text is None:
            return None
        try:
            content = json.loads(as_json(text))
        except ValueError as error:
            raise RunError(f"{self.root / name} cannot be read: {error}") from error
        if not isinstance(content, dict):
            raise RunError(f"{self.root / name} holds no object")
        return content

    def lines(self, name: str, voids: bool) -> list[dict[str, Any]]:
        """The last line of each rollout; with `voids` a line makes earlier ones with higher rollouts void."""
        lines = (self.text(name) or "").split("\n")
        kept: dict[int, dict[str, Any]] = {}
        for number, line in enumerate(lines, 1):
            if not line:
                continue
            try:
                row = json.loads(line)
                rollout = int(row["rollout"])
            except (ValueError, KeyError, TypeError) as error:
                if number == len(lines):
                    break
                path = self.root / name
                raise RunError(f"{path}, line {number} is damaged: `stillroom resume` mends it") from error
            # They ascend: what this one makes void stands at the end.
            while voids and kept and next(reversed(kept)) >= rollout:
                kept.popitem()
            kept[rollout] = row
        return [kept[rollout] for rollout in sorted(kept)]

    def folders(self, name: str) -> list[str]:
        """The folders in a folder, by name."""
        return sorted(f"{name}/{path.name}" for path, is_folder in self._list(name) if is_folder)

    def files(self, name: str) -> list[str]:
        """The files in a folder, by name."""
        return sorted(f"{name}/{path.name}" for path, is_folder in self._list(name) if not is_folder)

    def _list(self, name: str) -> list[tuple[Path, bool]]:
        return list_of_run(self.root, self.root / name)


def _result(files: _Files, name: str) -> dict[str, Any]:
    """The result file of an evaluation; empty where there is none."""
    path, result = files.root / name, files.json(name)
    if result is None:
        return {}
    if "format" not in result and "schema_version" in result:
        raise RunError(f"{path} is the result of an older version, which the package of commit 0e4cae3e reads")
    if result.get("format") != FORMAT:
        raise RunError(f"{path} has format {result.get('format')}, this package reads format {FORMAT}")
    return result


def _described(results: Iterable[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """What the numbers of these results are, by name."""
    return {one["name"]: one for result in results for one in result.get("described", [])}


def _declared(files: _Files) -> dict[str, dict[str, Any]]:
    """What the metrics of a run are, by name: its task declares them."""
    metrics = (files.toml("task.toml") or {}).get("metrics", [])
    is_share = [one.get("over") in ("last", "any") and "all_of" in one for one in metrics]
    return {
        one["name"]: one | {"kind": "share" if share else "f64"} for one, share in zip(metrics, is_share, strict=True)
    }


def _of_checkpoint(files: _Files) -> list[dict[str, Any]]:
    """The lines of all rollouts before the newest checkpoint, which keeps them; none where it has none."""
    try:
        run = (files.toml("run.toml") or {}).get("id")
    except RunError:
        run = None
    manifests = [name for name in files.files("checkpoints") if re.search(r"/rollout-\d+\.json$", name)]
    for name in reversed(manifests):
        try:
            manifest = files.json(name) or {}
            of_another = manifest.get("run") and run and manifest["run"] != run
            text = files.text(name.removesuffix("json") + "jsonl") or ""
            if not of_another and hashlib.sha256(text.encode()).hexdigest() == manifest.get("figures_sha256"):
                return [json.loads(line) for line in text.splitlines()]
        except (RunError, ValueError):
            continue
    return []


def _metrics(files: _Files, described: dict[str, dict[str, Any]]) -> pd.DataFrame:
    lines = {line["rollout"]: line for line in [*_of_checkpoint(files), *files.lines("metrics.jsonl", voids=True)]}
    rows = []
    for line in (lines[rollout] for rollout in sorted(lines)):
        row = {name: line.get(name) for name in ("rollout", "frames", "stage", "at_unix_s", "incarnation")}
        row.update({f"timing/{name}": value for name, value in line.get("timing", {}).items()})
        row.update(line.get("metrics", {}))
        rows.append(row)
    return _frame(rows, "rollout", ["rollout", "frames", "stage", "at_unix_s", "incarnation"], described)


def _validation(files: _Files, described: dict[str, dict[str, Any]]) -> pd.DataFrame:
    names = ["rollout", "frames", "weights", "result", "episodes", "at_unix_s"]
    return _frame(files.lines("validation.jsonl", voids=False), "rollout", names, described)


def _episodes(files: _Files, name: str, described: dict[str, dict[str, Any]]) -> pd.DataFrame:
    """A table of episodes; one without rows where there is no file."""
    return _table_of_episodes(files.root / name, files.text(name), described)


def _table_of_episodes(path: Path | None, text: str | None, described: dict[str, dict[str, Any]]) -> pd.DataFrame:
    import pandas as pd

    kinds = EPISODES | {name: KINDS[one["kind"]] for name, one in described.items() if name not in EPISODES}
    rows = list(csv.reader((text or ",".join(EPISODES)).splitlines()))
    names = rows[0] if rows else []
    unknown = [name for name in names if name not in kinds]
    if not names or unknown or any(len(row) != len(names) for row in rows[1:]):
        raise RunError(f"{path} is no table of episodes" + (f": there is no column {unknown[0]}" if unknown else ""))
    columns: dict[str, Any] = {}
    for index, name in enumerate(names):
        values: list[Any] = [row[index] for row in rows[1:]]
        try:
            columns[name] = _typed(values, kinds[name], is_hash=name == "state_hash")
        except (ValueError, OverflowError) as error:
            raise RunError(f"{path}, column {name}: {error}") from error
    return _told(pd.DataFrame(columns), described)


def _typed(values: list[Any], kind: str, is_hash: bool) -> Any:
    import pandas as pd

    if is_hash:
        values = [int(value, 16) for value in values]
    elif kind == "bool":
        if any(value not in ("0", "1", "") for value in values):
            raise ValueError("a flag is neither 0 nor 1")
        # An older table lacks the column's numbers.
        kind = "boolean" if "" in values else "bool"
        values = [value == "1" if value else None for value in values]
    elif kind == "Int64":
        values = [int(value) if value else None for value in values]
    elif kind == "int64":
        values = [int(value) for value in values]
    elif kind.startswith("float"):
        values = [float(value) if value else float("nan") for value in values]
    return pd.Series(values, dtype=kind)


def _all_episodes(files: _Files, results: dict[str, dict[str, Any]]) -> pd.DataFrame:
    import pandas as pd

    tables = []
    for name, result in results.items():
        table = _episodes(files, f"{name}/episodes.csv", _described([result]))
        table.insert(0, "evaluation", name.rpartition("/")[2])
        tables.append(table.astype(dict.fromkeys(table.select_dtypes("category").columns, "object")))
    if not tables:
        table = _table_of_episodes(None, None, {})
        table.insert(0, "evaluation", pd.Series([], dtype="object"))
        return _told(table, {})
    whole = pd.concat(tables, ignore_index=True)
    kinds = {name: kind for name, kind in EPISODES.items() if kind == "category" and name in whole}
    return _told(whole.astype(kinds), _described(results.values()))


def _results(results: dict[str, dict[str, Any]], declared: dict[str, dict[str, Any]]) -> pd.DataFrame:
    rows = []
    for folder, result in results.items():
        row: dict[str, Any] = {"evaluation": folder.rpartition("/")[2]}
        for part in ("subject", "conditions", "cost", "overall"):
            for name, value in _flat(result.get(part, {})).items():
                if not isinstance(value, list):
                    row[f"{part}.{name}" if part in ("subject", "conditions") else name] = value
        rows.append(row)
    # Without a row the metrics are columns, too: no name of theirs is an error before the first evaluation.
    names = ["evaluation", "episodes", *(() if rows else declared)]
    return _frame(rows, "evaluation", names, _described(results.values()))


def _stages(summary: dict[str, Any]) -> pd.DataFrame:
    rows = []
    for stage in summary.get("stages", []):
        row = {name: stage.get(name) for name in ("name", "reward", "frames", "budget")}
        for part in ("whole", "first_tenth", "last_tenth"):
            row.update({f"{part}/{name}": value for name, value in (stage.get(part) or {}).items()})
        rows.append(row)
    return _frame(rows, "name", ["name", "reward", "frames", "budget"], {})


def _frame(
    rows: list[dict[str, Any]], index: str, names: list[str], described: dict[str, dict[str, Any]]
) -> pd.DataFrame:
    """Rows of figures with their types: counts, texts, and all else as 64-bit floats, NaN where a row lacks one."""
    import pandas as pd

    names = list(dict.fromkeys([*names, *(name for row in rows for name in row)]))
    if len(names) * len(rows) > CELLS_MOST:
        raise RunError(f"a table of {len(rows)} rows has {len(names)} columns: no run has so many figures")
    texts = {"weights", "result", "reward"} | ({index} - {"rollout"})
    columns: dict[str, Any] = {}
    for name in names:
        values = [row.get(name) for row in rows]
        if name == "at_unix_s":
            columns["at"] = pd.to_datetime(pd.Series(values, dtype="Int64"), unit="s", utc=True)
        elif name in texts or any(isinstance(value, (str, bool)) for value in values):
            columns[name] = pd.Series(values, dtype="object")
        elif name.rpartition("/")[2].rpartition(".")[2] in INTEGERS and all(isinstance(v, int) for v in values):
            columns[name] = pd.Series(values, dtype="int64")
        else:
            columns[name] = pd.Series([float("nan") if v is None else v for v in values], dtype="float64")
    frame = pd.DataFrame(columns)
    if index == "rollout":
        frame["rollout"] = frame["rollout"].astype("int64")
    return _told(frame.set_index(index), described)


def _told(frame: pd.DataFrame, described: dict[str, dict[str, Any]]) -> pd.DataFrame:
    """Says what its columns are; `described`: those of the task, by name."""
    units = {}
    for name in map(str, frame.columns):
        last = name.rpartition("/")[2].rpartition(".")[2]
        one = described.get(last, {})
        about = one.get("doc", "").rstrip(".") or COLUMNS.get(name) or COLUMNS.get(last) or ""
        share = SHARE if one.get("kind") == "share" and frame[name].dtype == float else ""
        unit = next((unit for end, unit in UNITS.items() if last.endswith(end)), one.get("unit", ""))
        told = ", ".join(part for part in (about, share, unit) if part)
        if told:
            units[name] = told
    frame.attrs["units"] = units
    return frame


def _flat(table: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested tables as one, with points in its keys."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, dict):
            flat.update(_flat(value, f"{prefix}{key}."))
        else:
            flat[f"{prefix}{key}"] = value
    return flat
