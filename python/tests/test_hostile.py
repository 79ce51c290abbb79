"""Files that somebody else made: whatever is in them, `load` loads or raises a `CheckpointError`, soon and in little
memory."""

from __future__ import annotations

import hashlib
import json
import os
import random
import resource
import socket
import time
import warnings
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save

import stillroom
from conftest import checkpoint, sealed

NASTY = [
    *(None, True, -1, 0, 1.5, 2**63, 2**64, 10**400, 1e308, float("nan"), "", "x" * 10_000, "..", "/dev/zero", "a\0b"),
    *("\ud800", "é", [], {}, [[]], {"a": 1}, [2**63, 0], "0", "1e5", "=", "[network]\ngoal = 3", "network = 3"),
    *('[episode]\nmax_steps = "many"', "[network]\ncarried_goal = []", "x = " + "[" * 5000),
]


def memory_kb() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def attempt(path: Path) -> bool:
    """Whether the file was loaded; any other error than the documented one fails the test, and so does a long wait."""
    begun = time.monotonic()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = stillroom.load(path)
    except stillroom.CheckpointError as error:
        # Where a manifest names tensors, theirs.
        assert path.name in str(error) or str(path.parent) in str(error), f"the file is named: {error}"
        return False
    finally:
        assert time.monotonic() - begun < 10
    assert found.goal in ("polar", "cartesian") and isinstance(found.frames, int | None)
    assert all(isinstance(array, np.ndarray) for array in found.weights.values())
    assert found.environment()["carried_goal"] in ("goal_to_object", "object_to_goal")
    return True


def with_header(header: bytes, data: bytes) -> bytes:
    return len(header).to_bytes(8, "little") + header + data


def mutated(content: bytes, chance: random.Random) -> bytes:
    """Flipped, cut, doubled or foreign bytes."""
    changed = bytearray(content)
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(changed) + 1)
        match chance.randrange(4):
            case 0 if at < len(changed):
                changed[at] ^= 1 << chance.randrange(8)
            case 1:
                del changed[at : at + chance.randrange(40)]
            case 2:
                changed[at:at] = changed[max(at - chance.randrange(40), 0) : at]
            case _:
                changed[at:at] = json.dumps(chance.choice(NASTY)).encode()
    return bytes(changed)


def nested(table: dict, chance: random.Random) -> dict:
    """One value, somewhere in the table, is another one, missing, or under another name."""
    table = dict(table)
    name = chance.choice(list(table))
    if isinstance(table[name], dict) and table[name] and chance.random() < 0.8:
        return table | {name: nested(table[name], chance)}
    if chance.random() < 0.2:
        table[chance.choice(["", "__metadata__", "\ud800", "x" * 300])] = table.pop(name)
    else:
        table[name] = chance.choice(NASTY)
    return table


@pytest.mark.parametrize("seed", range(4))
def test_no_content_of_a_file_raises_another_error(tmp_path: Path, seed: int) -> None:
    chance = random.Random(seed)
    facts = {"config": "", "frames": "4", "rollout": "1", "run": "0", "weights_sha256": "", "tensors_sha256": ""}
    policy = save({"actor.weight": np.ones((2, 3), np.float16)}, {"stillroom": json.dumps(facts)})
    length = int.from_bytes(policy[:8], "little")
    header, data = json.loads(policy[8 : 8 + length]), policy[8 + length :]
    manifest = checkpoint(tmp_path, 7, {"model.a": np.ones(4, np.float32), "other": np.ones(4, np.float32)})
    tensors = manifest.with_suffix(".safetensors").read_bytes()
    fields = json.loads(manifest.read_bytes())
    loaded, before = 0, memory_kb()
    for number in range(800):
        kind = number % 5
        path = tmp_path / f"{number}.safetensors"
        if kind == 0:
            path.write_bytes(mutated(policy, chance))
        elif kind == 1:
            path.write_bytes(with_header(json.dumps(nested(header, chance)).encode(), data))
        elif kind == 2:
            metadata = {"stillroom": json.dumps(nested(facts, chance))}
            path.write_bytes(save({"actor.weight": np.ones((2, 3), np.float16)}, metadata))
        elif kind == 3:
            # A manifest with the right checksum, and with one that is as damaged as the rest.
            path = tmp_path / f"rollout-{number}.json"
            found = sealed(**nested(fields, chance))
            path.write_bytes(found if chance.random() < 0.7 else mutated(found, chance))
        else:
            # Tensors that are as their manifest says, whatever they are.
            changed = mutated(tensors, chance)
            checkpoint(tmp_path, number, {"model.a": np.ones(1, np.float32)})
            path = tmp_path / f"rollout-{number:08}.safetensors"
            path.write_bytes(changed)
            digest = hashlib.sha256(changed).hexdigest()
            path.with_suffix(".json").write_bytes(
                sealed(tensors=path.name, tensors_bytes=len(changed), tensors_sha256=digest)
            )
        loaded += attempt(path)
    assert 0 < loaded < 700, "some load, and most do not"
    assert memory_kb() - before < 200_000


def test_headers_promise_nothing(tmp_path: Path) -> None:
    before = memory_kb()
    deep = b'{"__metadata__": ' + b'{"a":' * 100_000 + b"1" + b"}" * 100_000 + b"}"
    files = {
        "deep.safetensors": with_header(deep, b""),
        "deep.json": deep,
        "long.safetensors": (2**63).to_bytes(8, "little"),
        "short.safetensors": b"\x01",
        "empty.safetensors": with_header(b"{}", b""),
        "list.safetensors": with_header(b"[]", b""),
        "e.json": b"",
        "latin.json": b"\xe4",
    }
    types = [(kind, kind, [8], 8) for kind in ("BF16", "F64", "U64", "BOOL", "F8_E5M2", "E8M0", "X", "f32")]
    shapes = [[0, 2**63], [0, 2**62], [1] * 100, [-1], [2**64], [0]]
    for name, kind, shape, length in [*types, *((f"s{at}", "F32", shape, 0) for at, shape in enumerate(shapes))]:
        entry = {"dtype": kind, "shape": [1] if kind in ("F64", "U64") else [4] if kind == "BF16" else shape}
        header = json.dumps({"a": entry | {"data_offsets": [0, length]}}).encode()
        files[f"{name}.safetensors"] = with_header(header, b"\x02" * length)
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    loads = {name for name in files if attempt(tmp_path / name)}
    assert loads == {f"{name}.safetensors" for name in ("BF16", "F64", "U64", "BOOL", "s5")}
    for path in (tmp_path / ("x" * 300), tmp_path / "a\0b", Path("\ud800.safetensors"), Path("\udcff"), Path()):
        assert not attempt(path)
    assert memory_kb() - before < 300_000


def test_only_ordinary_files_of_a_bounded_size_are_read(tmp_path: Path) -> None:
    before = memory_kb()
    for suffix in ("json", "safetensors"):
        os.mkfifo(tmp_path / f"pipe.{suffix}")
        (tmp_path / f"zero-{suffix}.{suffix}").symlink_to("/dev/zero")
        (tmp_path / f"loop.{suffix}").symlink_to(f"loop.{suffix}")
        (tmp_path / f"sparse-{suffix}.{suffix}").touch()
        os.truncate(tmp_path / f"sparse-{suffix}.{suffix}", 200 << 30)
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind(str(tmp_path / "socket.safetensors"))
    for path in sorted(tmp_path.iterdir()):
        assert not attempt(path), path.name
    assert memory_kb() - before < 300_000


def test_what_a_folder_names_is_a_plain_file_in_it(tmp_path: Path) -> None:
    before, whole = memory_kb(), {"model.a": np.ones(4, np.float32)}
    for name in ("pipe", "link", "zero", "sparse", "longer", "folder"):
        folder = tmp_path / name
        folder.mkdir()
        fields = {"tensors_bytes": 2**64 - 1 if name != "longer" else 8}
        tensors = checkpoint(folder, 7, whole, **fields).with_suffix(".safetensors")
        if name != "longer":
            tensors.rename(folder / "elsewhere")
        match name:
            case "pipe":
                os.mkfifo(tensors)
            case "link" | "zero":
                tensors.symlink_to("/dev/zero" if name == "zero" else folder / "elsewhere")
            case "sparse":
                tensors.touch()
                os.truncate(tensors, 200 << 30)
            case "folder":
                tensors.mkdir()
        assert not attempt(folder) and not attempt(tensors.with_suffix(".json")), name
    (tmp_path / "named").mkdir()
    checkpoint(tmp_path / "named", 9, whole)
    (tmp_path / "best").symlink_to("named")
    assert attempt(tmp_path / "best"), "a folder may be a link: the user named it"
    linked = tmp_path / "run"
    linked.mkdir()
    (linked / "checkpoints").symlink_to(tmp_path / "named")
    assert not attempt(linked)
    (linked / "rollout-00000003.json").symlink_to("/dev/zero")
    assert not attempt(linked)
    assert memory_kb() - before < 300_000


@pytest.mark.parametrize("kind", ["BF16", "F64"])
def test_other_types_of_weights_keep_their_numbers(tmp_path: Path, kind: str) -> None:
    numbers = np.array([1.0, -2.5], np.float32 if kind == "BF16" else np.float64)
    data = numbers.tobytes() if kind == "F64" else (numbers.view(np.uint32) >> 16).astype(np.uint16).tobytes()
    header = json.dumps({"a": {"dtype": kind, "shape": [2], "data_offsets": [0, len(data)]}}).encode()
    (tmp_path / "a.safetensors").write_bytes(with_header(header, data))
    assert stillroom.load(tmp_path / "a.safetensors").weights["a"].tolist() == [1.0, -2.5]


def test_no_snapshot_raises_another_error(kitchens: dict) -> None:
    chance = random.Random(5)
    env = stillroom.ArmPointNav(kitchens[8], frame_side=8)
    env.reset(seed=1)
    for action in range(4):
        env.step(action)
    whole = env.snapshot().to_bytes()
    read = 0
    for number in range(600):
        changed = mutated(whole, chance) if number % 2 else json.dumps(nested(json.loads(whole), chance)).encode()
        begun = time.monotonic()
        try:
            env.restore(stillroom.Snapshot.from_bytes(changed))
            read += 1
        except ValueError as error:
            assert str(error)
        assert time.monotonic() - begun < 10
    assert read < 300


@pytest.mark.parametrize("seed", range(2))
def test_no_run_folder_raises_another_error(tmp_path: Path, seed: int) -> None:
    chance = random.Random(seed)
    line = {
        "rollout": 1,
        "frames": 2,
        "stage": 0,
        "at_unix_s": 1,
        "incarnation": 1,
        "timing": {"a": 1},
        "metrics": {"b": 1},
    }
    score = {"rollout": 4, "frames": 900, "weights": "ab", "result": "r", "episodes": 8, "success": 1, "at_unix_s": 1}
    stage = {"name": "I", "reward": "r", "frames": 9, "budget": 9, "whole": {"x": 1}, "last_tenth": {"y": 2}}
    described = [{"name": "success", "kind": "share", "unit": "", "doc": "Yes."}]
    result = {"subject": {"preset": "demo"}, "conditions": {}, "overall": {"episodes": 2}, "cost": {"s": 1}}
    result |= {"format": 2, "described": described}
    read = 0
    for number in range(150):
        folder = tmp_path / str(number)
        (folder / "evaluations/e").mkdir(parents=True)
        tables = {"metrics.jsonl": line, "validation.jsonl": score, "summary.json": {"stages": [stage]}}
        tables |= {"evaluations/e/evaluation.json": result}
        chosen = chance.choice(list(tables))
        for name, table in tables.items():
            if name == "summary.json" and name == chosen and chance.random() < 0.5:
                table = {"stages": [nested(stage, chance)]}
            elif name == chosen:
                table = nested(table, chance)
            text = json.dumps(table) + "\n"
            (folder / name).write_bytes(mutated(text.encode(), chance) if number % 5 == 0 else text.encode())
        (folder / "config.toml").write_text("seed = 1\n")
        (folder / "evaluations/e/episodes.csv").write_text("kitchen,episode\n1,2\n")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                read += stillroom.read_run(folder).kind == "run"
        except stillroom.RunError as error:
            assert str(folder) in str(error)
    assert 0 < read < 150
