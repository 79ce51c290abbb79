"""Recorded episodes as Parquet tables or as a LeRobotDataset v3.

The input is a folder of `stillroom export --format npz`. Needs pandas, pyarrow and pillow:

    python -m stillroom.dataset parquet ARRAYS OUT    # steps.parquet and episodes.parquet
    python -m stillroom.dataset lerobot ARRAYS OUT
"""

from __future__ import annotations

import argparse
import io
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

# Of a LeRobotDataset: steps a second (an action has no duration), and the sizes of its files.
FPS = 5
FILE_BYTES = 100 << 20
FILES_EACH = 1000
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
# Names without rows.
ABOUT = ("kitchen", "environment", "episode", "fixed_episode", "outcome", "seed")
# Columns of LeRobot's that are not `next.NAME`.
LEROBOT = {"action": "action", "ended": "next.done"}


def to_parquet(arrays: Path, out: Path) -> None:
    """Writes `steps.parquet`, a row an action, and `episodes.parquet`, a row an episode.

    Frames are PNGs in columns named `CAMERA_png`. What was seen after the last action is in `episodes.parquet`.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    out.mkdir(parents=True)
    rows, first, writer = [], 0, None
    for number, episode in enumerate(_episodes(arrays)):
        count = len(episode["action"])
        seen = _seen(episode)
        hashes = seen.pop("state_hash")
        pictures = {f"{camera}_png": _pngs(frames) for camera, frames in _cameras(episode).items()}
        columns: dict[str, Any] = {"episode_index": np.full(count, number), "step": np.arange(count)}
        columns |= {name: np.full(count, episode[name]) for name in ("kitchen", "environment", "episode")}
        columns |= {name: values[:-1] for name, values in pictures.items()}
        columns |= {name: _rows(episode, name, values[:-1]) for name, values in seen.items()}
        columns |= {name: _rows(episode, name, values) for name, values in _of_steps(episode).items()}
        columns["state_hash"] = hashes[1:]
        table = pa.table(columns)
        if writer is None:
            names = json.dumps([str(name) for name in episode["action_names"]])
            writer = pq.ParquetWriter(out / "steps.parquet", table.schema.with_metadata({"actions": names}))
        writer.write_table(table.cast(writer.schema))
        row: dict[str, Any] = {"episode_index": number, "first_row": first, "steps": count}
        row |= {name: episode[name][()] for name in ABOUT}
        rewards = {name: values for name, values in episode.items() if name.startswith("reward_")}
        row |= {f"return_{name[7:]}": values.astype(np.float64).sum() for name, values in rewards.items()}
        row |= {name[7:]: episode[name][()] for name in episode if name.startswith("metric_")}
        row |= {f"last_{name}": values[-1] for name, values in pictures.items()}
        row |= {f"last_{name}": _rows(episode, name, values)[-1] for name, values in seen.items()}
        rows.append({name: value.item() if isinstance(value, np.generic) else value for name, value in row.items()})
        first += count
    if writer is None:
        raise ValueError(f"{arrays}: no episode-*.npz: `stillroom export RUN --format npz --out DIR` makes them")
    writer.close()
    seed = {"seed": pa.array([row.pop("seed") for row in rows], pa.uint64())}
    episodes = pa.Table.from_pylist(rows)
    pq.write_table(episodes.append_column("seed", seed["seed"]), out / "episodes.parquet")
    _copy_about(arrays, out)


def to_lerobot(arrays: Path, out: Path) -> None:
    """Writes a LeRobotDataset v3. All that begins with `next.` is of the moment after the action.

    Frames are PNGs inside the data: depth has 16 bits and is in millimetres, which a video would not keep.
    """
    import pandas as pd
    import pyarrow as pa

    out.mkdir(parents=True)
    data, episodes = _Files(out / "data"), _Files(out / "meta/episodes")
    tasks: list[str] = []
    features: dict[str, Any] = {}
    all_stats: list[dict[str, dict[str, Array]]] = []
    names: list[str] = []
    total = 0
    picture = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    for number, episode in enumerate(_episodes(arrays)):
        count = len(episode["action"])
        names_of = {
            name: _rows(episode, name, values)
            for name, values in _of_steps(episode).items()
            if _has_names(episode, name)
        }
        task = ", ".join(
            [str(episode["task"]).replace("_", " "), *(f"{name} {values[0]}" for name, values in names_of.items())]
        )
        if task not in tasks:
            tasks.append(task)
        cameras = {f"observation.images.{name}": frames[:-1] for name, frames in _cameras(episode).items()}
        observed = [episode[name][:-1].reshape(count, -1) for name in episode["observation_names"]]
        numbers: dict[str, Array] = {"observation.state": np.hstack(observed).astype(np.float32)} if observed else {}
        numbers["observation.previous_action"] = episode["previous_action"][:-1]
        steps = _of_steps(episode)
        # The task's last reward has all of its parts.
        last = [name for name in steps if name.startswith("reward_")][-1:]
        names_there = LEROBOT | dict.fromkeys(last, "next.reward")
        numbers |= {names_there.get(name, f"next.{name}"): values for name, values in steps.items()}
        numbers |= {name: np.full(count, episode[name]) for name in ("kitchen", "environment")}
        numbers["episode_number"] = np.full(count, episode["episode"])
        numbers["timestamp"] = (np.arange(count) / FPS).astype(np.float32)
        numbers |= {"frame_index": np.arange(count), "episode_index": np.full(count, number)}
        numbers |= {"index": np.arange(total, total + count), "task_index": np.full(count, tasks.index(task))}
        columns: dict[str, Any] = {
            name: pa.array([{"bytes": png, "path": None} for png in _pngs(frames)], picture)
            for name, frames in cameras.items()
        }
        columns |= {name: list(values) if values.ndim > 1 else values for name, values in numbers.items()}
        stats = {name: _stats(frames.reshape(count, *frames.shape[1:3], -1)) for name, frames in cameras.items()}
        stats |= {name: _stats(values.reshape(count, -1)) for name, values in numbers.items()}
        if not features:
            axes = [
                f"{name}_{axis}" if episode[name].ndim > 1 else str(name)
                for name in episode["observation_names"]
                for axis in range(episode[name][0].size)
            ]
            features = _features(cameras, numbers, axes)
            names = [str(name) for name in episode["action_names"]]
        data.add(pa.table(columns))
        row: dict[str, Any] = {"episode_index": number, "tasks": [task], "length": count}
        row |= {"data/chunk_index": data.at[0], "data/file_index": data.at[1]}
        row |= {"dataset_from_index": total, "dataset_to_index": total + count, "outcome": str(episode["outcome"])}
        row |= {f"stats/{name}/{key}": value.tolist() for name, of in stats.items() for key, value in of.items()}
        row |= {"meta/episodes/chunk_index": episodes.at[0], "meta/episodes/file_index": episodes.at[1]}
        episodes.add(pa.Table.from_pylist([row]))
        all_stats.append(stats)
        total += count
    if not all_stats:
        raise ValueError(f"{arrays}: no episode-*.npz: `stillroom export RUN --format npz --out DIR` makes them")
    data.close()
    episodes.close()
    index = pd.Index(tasks, name="task")
    pd.DataFrame({"task_index": range(len(tasks))}, index=index).to_parquet(out / "meta/tasks.parquet")
    info = {
        "codebase_version": "v3.0",
        "robot_type": "stillroom",
        "total_episodes": len(all_stats),
        "total_frames": total,
        "total_tasks": len(tasks),
        "chunks_size": FILES_EACH,
        "data_files_size_in_mb": FILE_BYTES >> 20,
        "video_files_size_in_mb": 2 * (FILE_BYTES >> 20),
        "fps": FPS,
        "splits": {"train": f"0:{len(all_stats)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": features,
        "actions": names,
    }
    (out / "meta/info.json").write_text(json.dumps(info, indent=2))
    merged = {name: _merged([stats[name] for stats in all_stats]) for name in all_stats[0]}
    (out / "meta/stats.json").write_text(json.dumps(merged, indent=2, default=np.ndarray.tolist))
    _copy_about(arrays, out)


class _Files:
    """Parquet files of at most `FILE_BYTES`: `chunk-000/file-000.parquet` and so on."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.number = 0
        self.writer: Any = None
        self.sink: Any = None

    @property
    def at(self) -> tuple[int, int]:
        """Chunk and file that the last table went to."""
        return divmod(self.number, FILES_EACH)

    def add(self, table: Any) -> None:
        import pyarrow.parquet as pq

        if self.writer is not None and self.sink.tell() + table.nbytes > FILE_BYTES:
            self.close()
            self.number += 1
        if self.writer is None:
            chunk, file = self.at
            path = self.folder / f"chunk-{chunk:03}/file-{file:03}.parquet"
            path.parent.mkdir(parents=True, exist_ok=True)
            self.sink = path.open("wb")
            self.writer = pq.ParquetWriter(self.sink, table.schema)
        self.writer.write_table(table)

    def close(self) -> None:
        self.writer.close()
        self.sink.close()
        self.writer = None


def _episodes(arrays: Path) -> Iterator[dict[str, Array]]:
    for file in sorted(arrays.glob("episode-*.npz")):
        with np.load(file, allow_pickle=False) as archive:
            yield dict(archive)


def _is_image(values: Array) -> bool:
    return values.ndim >= 3 and values.dtype in (np.uint8, np.uint16)


def _cameras(episode: dict[str, Array]) -> dict[str, Array]:
    found = {name.rsplit("_", 1)[0]: values for name, values in episode.items() if _is_image(values)}
    return dict(sorted(found.items(), key=lambda item: item[0] in ("robot", "outside")))


def _with_rows(episode: dict[str, Array], count: int) -> dict[str, Array]:
    """The arrays of so many rows but images and lists of names."""
    names = {
        name for name, values in episode.items() if name.endswith("_names") or values.ndim == 0 or _is_image(values)
    }
    return {name: values for name, values in episode.items() if name not in names and len(values) == count}


def _seen(episode: dict[str, Array]) -> dict[str, Array]:
    """What has a row more than there were actions."""
    return _with_rows(episode, len(episode["state_hash"]))


def _of_steps(episode: dict[str, Array]) -> dict[str, Array]:
    return _with_rows(episode, len(episode["state_hash"]) - 1)


def _has_names(episode: dict[str, Array], name: str) -> bool:
    return name != "action" and f"{name}_names" in episode


def _rows(episode: dict[str, Array], name: str, values: Array) -> Any:
    """Numbers that stand for names as those; several numbers a row as lists."""
    if _has_names(episode, name):
        values = episode[f"{name}_names"][values]
    return values.tolist() if values.ndim > 1 else values


def _pngs(frames: Array) -> list[bytes]:
    from PIL import Image

    pngs = []
    for frame in frames:
        png = io.BytesIO()
        Image.fromarray(frame).save(png, "png", compress_level=1)
        pngs.append(png.getvalue())
    return pngs


def _features(cameras: dict[str, Array], numbers: dict[str, Array], axes: list[str]) -> dict[str, Any]:
    features: dict[str, Any] = {}
    for name, frames in cameras.items():
        is_depth = frames.ndim == 3
        info = {"is_depth_map": is_depth} | ({"unit": "millimetre", "bits": 16} if is_depth else {})
        shape = [*frames.shape[1:3], 1 if is_depth else frames.shape[3]]
        features[name] = {"dtype": "image", "shape": shape, "names": ["height", "width", "channels"], "info": info}
    for name, values in numbers.items():
        of = axes if name == "observation.state" else None
        features[name] = {"dtype": str(values.dtype), "shape": [*values.shape[1:]] or [1], "names": of}
    return features


def _stats(values: Array) -> dict[str, Array]:
    """Statistics over all but the last axis. Those of pictures are channels × 1 × 1, colours from 0 to 1."""
    is_picture = values.ndim == 4
    flat = values.reshape(-1, values.shape[-1]).astype(np.float64)
    if is_picture and values.shape[-1] == 3:
        flat /= 255
    found = {"min": flat.min(0), "max": flat.max(0), "mean": flat.mean(0), "std": flat.std(0)}
    found |= {name: np.quantile(flat, share, axis=0) for name, share in QUANTILES.items()}
    if is_picture:
        found = {name: value.reshape(-1, 1, 1) for name, value in found.items()}
    return found | {"count": np.array([len(values)])}


def _merged(stats: list[dict[str, Array]]) -> dict[str, Array]:
    """Those of all episodes, as LeRobot merges them: quantiles are means of the episodes' quantiles."""
    counts = np.array([of["count"][0] for of in stats])
    weights = counts / counts.sum()

    def mean(name: str) -> Array:
        return sum(weight * of[name] for weight, of in zip(weights, stats, strict=True))

    middle = mean("mean")
    variance = sum(
        weight * (of["std"] ** 2 + (of["mean"] - middle) ** 2) for weight, of in zip(weights, stats, strict=True)
    )
    merged = {"min": np.min([of["min"] for of in stats], 0), "max": np.max([of["max"] for of in stats], 0)}
    merged |= {"mean": middle, "std": np.sqrt(variance), "count": np.array([counts.sum()])}
    return merged | {name: mean(name) for name in QUANTILES}


def _copy_about(arrays: Path, out: Path) -> None:
    for file in [*arrays.glob("config*.toml"), *arrays.glob("README.md")]:
        shutil.copy(file, out / file.name)


def main() -> None:
    """`python -m stillroom.dataset`."""
    parser = argparse.ArgumentParser("python -m stillroom.dataset", description=__doc__.split("\n")[0])
    parser.add_argument("format", choices=["parquet", "lerobot"])
    parser.add_argument("arrays", type=Path, help="folder of `stillroom export --format npz`")
    parser.add_argument("out", type=Path, help="folder to be made")
    given = parser.parse_args()
    try:
        (to_parquet if given.format == "parquet" else to_lerobot)(given.arrays, given.out)
    except (OSError, ValueError, ImportError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
