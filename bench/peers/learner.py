"""Our learner beside PyTorch: the same network and batch, in the same run on the same device.

Inference is a whole step, from frames on the host to actions on the host. Ours takes the frames from the shared memory
in which actors wrote them: on a CPU it copies them, a GPU reads them there. Theirs have them in pinned memory already.
An epoch is forward and backward pass of a rollout with the optimiser's step. In ours episodes begin and end inside of
it; in theirs none does, so that their GRU is one call.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from .learner_table import table

#: Preset of the network that is compared: the paper's, with batches for a GPU; and those of other tasks.
PRESETS = {"kitchen": "recipe", "atari": "gym", "vector": "gym"}
#: Batches, steps and frames of a rollout of the other tasks.
SIZES = {"atari": ([16, 128, 512], [128], 8192), "vector": ([16, 128, 512], [128], 8192)}
#: Our program has not answered after this long: it hangs.
LIMIT_S = 1800


def numbers(text: str) -> list[int]:
    """Numbers with commas between."""
    return [int(word) for word in text.split(",")]


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="peers.learner", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--learner", type=Path, required=True, help="our program")
    parser.add_argument("--device", choices=["auto", "cpu", "cuda"], default="auto")
    parser.add_argument(
        "--shape",
        choices=PRESETS,
        default="kitchen",
        help="the kitchens' network; DQN's convolutions over 4 × 84 × 84 u8; two MLPs of 64 × 64",
    )
    parser.add_argument("--encoder", choices=["resnet", "cnn"], default="resnet", help="of the kitchens")
    parser.add_argument("--hidden", type=int, default=512, help="width of the kitchens' GRU")
    parser.add_argument("--batches", type=numbers, help="of inference, with commas between [10,19,152,304,608]")
    parser.add_argument("--steps", type=numbers, help="of the rollouts of updates, with commas between [32,128]")
    parser.add_argument("--rollout-frames", type=int, default=0, help="of each update [9728; on a CPU 1216]")
    parser.add_argument("--seconds", type=float, default=1.0, help="for each figure of inference")
    parser.add_argument("--minutes", type=float, default=15.0, help="begin nothing new after so long")
    parser.add_argument("--json", type=Path, help="write everything that was measured here")
    return parser.parse_args()


@dataclass
class Measured:
    """Seconds of ours and of each variant of theirs, by batch and by steps."""

    inference: dict[int, dict[str, float | None]] = field(default_factory=dict)
    epoch: dict[tuple[int, int], dict[str, float | None]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def ours(options: argparse.Namespace, cuda_library: Path | None) -> dict:
    """What `learner bench` measures."""
    device = "cuda" if cuda_library else "cpu"
    # One step of the optimiser an epoch, of all frames, as theirs takes it.
    settings = ["ppo.minibatches=1"]
    if options.shape == "kitchen":
        settings += [f"network.encoder={options.encoder}", f"network.hidden={options.hidden}"]
    if options.shape == "atari" and cuda_library:
        # As the fastest of theirs.
        settings += ["learner.encoder_precision=bfloat16"]
    preset = PRESETS[options.shape]
    command = [options.learner, "bench", "--device", device, "--preset", preset, "--json"]
    if options.shape != "kitchen":
        command += ["--task", Path(__file__).with_name(f"{options.shape}.toml")]
    command += [word for setting in settings for word in ("--set", setting)]
    command += ["--seconds", str(options.seconds), "--rollout-frames", str(options.rollout_frames)]
    command += ["--batches", ",".join(map(str, options.batches)), "--steps", ",".join(map(str, options.steps))]
    environment = dict(os.environ)
    if cuda_library:
        before = environment.get("LD_LIBRARY_PATH", "")
        environment["LD_LIBRARY_PATH"] = f"{cuda_library}:{before}" if before else str(cuda_library)
    words = [str(word) for word in command]
    print("+", *words, file=sys.stderr, flush=True)
    finished = subprocess.run(words, env=environment, stdout=subprocess.PIPE, text=True, timeout=LIMIT_S, check=True)
    return json.loads(finished.stdout)


def measure(options: argparse.Namespace) -> tuple[Measured, str]:
    """Ours, then theirs; what the device is called."""
    began = time.monotonic()
    try:
        import torch  # noqa: PLC0415 - only this command needs it
    except ImportError as error:
        sys.exit(f"bench-learner: this Python has no torch ({error}); PYTHON=/path/to/python names one that has 2.11")
    from . import learner_peer as peer  # noqa: PLC0415 - needs torch

    cuda = options.device != "cpu" and torch.cuda.is_available()
    if options.device == "cuda" and not cuda:
        sys.exit("bench-learner: --device cuda, but torch finds no CUDA device")
    default = ([10, 19, 152, 304, 608], [32, 128], 9728 if cuda else 1216)
    batches, steps, frames = SIZES.get(options.shape, default)
    options.batches, options.steps = options.batches or batches, options.steps or steps
    options.rollout_frames = options.rollout_frames or frames
    own = ours(options, Path(torch.__file__).parent / "lib" if cuda else None)
    device = torch.device("cuda" if cuda else "cpu")
    if not cuda:
        # As our configuration has it.
        torch.set_num_threads(1)

    measured = Measured()
    for row in own["inference"]:
        measured.inference[row["batch"]] = {"ours": row["p50_s"]}
    for row in own["updates"]:
        measured.epoch[row["steps"], row["environments"]] = {"ours": row["epoch_s"]}

    def left(what: str) -> bool:
        if time.monotonic() - began < 60 * options.minutes:
            print(f"{time.monotonic() - began:5.0f} s  {what}", file=sys.stderr, flush=True)
            return True
        measured.notes.append(f"not measured, no time left: {what}")
        return False

    make = partial(peer.make, options.shape, options.encoder, options.hidden)

    def take(row: dict[str, float | None], name: str, what: str, call: Callable[[], float]) -> None:
        if left(f"{name}, {what}"):
            row[name], problem = peer.attempt(call)
            measured.notes.extend([f"{name}, {what}: {problem}"] if problem else [])

    for shape, row in measured.epoch.items():
        for variant in peer.variants(device, training=True):
            what = f"{shape[0]} × {shape[1]}"
            take(row, variant.name, what, lambda v=variant, s=shape: peer.epoch_s(make, s, v, device))
    for batch, row in measured.inference.items():
        for variant in peer.variants(device, training=False):
            run = partial(peer.inference_s, make, batch, variant, device, options.seconds)
            take(row, variant.name, f"batch {batch}", run)
    name = torch.cuda.get_device_name() if cuda else "CPU, 1 thread"
    return measured, f"{name}, torch {torch.__version__}; {own['encoder']}, {own['parameters'] / 1e6:.2f} M weights"


def main() -> int:
    """The program."""
    options = arguments()
    measured, machine = measure(options)
    if options.json:
        epoch = {f"{steps} x {environments}": row for (steps, environments), row in measured.epoch.items()}
        document = {"machine": machine, "inference_s": measured.inference, "epoch_s": epoch, "notes": measured.notes}
        options.json.write_text(json.dumps(document, indent=1))
    print(table(measured.inference, measured.epoch, machine))
    print(*measured.notes, sep="\n", end="\n" if measured.notes else "")
    return 0


if __name__ == "__main__":
    sys.exit(main())
