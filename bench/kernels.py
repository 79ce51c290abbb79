"""What each kernel of the learner does with a GPU: time, memory bandwidth and tensor cores, by Nsight Compute.

Nsight Compute runs kernels one at a time, each several times over, and reads the chip's counters; so the times say
where work is, not how long a step takes (that is `learner bench`). Clocks and caches are left as they are.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

#: Time of a launch.
TIME = "gpu__time_duration.sum"
#: Percent of what the memory could carry in that time.
MEMORY = "dram__throughput.avg.pct_of_peak_sustained_elapsed"
#: Bytes that went from and to memory.
BYTES = "dram__bytes.sum"
#: Percent of the time in which the tensor cores worked. Which of them there is depends on the chip.
TENSOR = [
    "sm__pipe_tensor_cycles_active.avg.pct_of_peak_sustained_elapsed",
    "sm__pipe_tensor_op_hmma_cycles_active.avg.pct_of_peak_sustained_elapsed",
    "sm__inst_executed_pipe_tensor.avg.pct_of_peak_sustained_elapsed",
]
#: What kernels are for, by what their names have in them; the first that fits.
FAMILIES = {
    "convolutions of cuDNN": ["fprop", "dgrad", "wgrad", "convolve", "cudnn::Kernel", "nhwcToNchw", "nchwToNhwc"],
    "GRU and matrix products": ["GRU", "RNN", "gemm", "gemv", "cutlass::Kernel", "nvjet", "cublasLt"],
    "blocks of the first stage, backward": ["block_backward"],
    "blocks of the first stage, forward": ["block_forward"],
    "stem, backward": ["stem_backward"],
    "stem, forward": ["stem_forward"],
    "norms, backward": ["norm_backward"],
    "norms, forward": ["norm_forward"],
}
#: The profiler has not ended after this long: it hangs.
LIMIT_S = 1800


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--learner", type=Path, required=True, help="our program")
    parser.add_argument("--ncu", default="ncu", help="Nsight Compute's program [%(default)s]")
    parser.add_argument("--what", choices=["inference", "update"], action="append", help="only that [both]")
    parser.add_argument("--preset", default="recipe", help="of the network [%(default)s]")
    parser.add_argument("--batch", type=int, default=152, help="frames of a step of inference [%(default)s]")
    parser.add_argument("--rollout-frames", type=int, default=19456, help="of an update [%(default)s]")
    parser.add_argument("--steps", type=int, default=32, help="of its rollout [%(default)s]")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting; repeat it for more")
    parser.add_argument("--lines", type=int, default=40, help="kinds of launches that are printed [%(default)s]")
    parser.add_argument("--json", type=Path, help="write every launch here")
    return parser.parse_args()


@dataclass
class Launch:
    """One kernel, once."""

    kernel: str
    #: Blocks; they tell the launches of one kernel for different maps apart.
    grid: str
    time_us: float
    #: Percent of the bandwidth; percent of the tensor cores' time.
    memory: float
    tensor: float
    megabytes: float


@dataclass
class Group:
    """Launches that are told of together."""

    name: str
    grid: str
    launches: list[Launch] = field(default_factory=list)

    @property
    def time_us(self) -> float:
        """Of all of them."""
        return sum(launch.time_us for launch in self.launches)

    @property
    def megabytes(self) -> float:
        """From and to memory."""
        return sum(launch.megabytes for launch in self.launches)

    def share(self, of: str) -> float:
        """Mean over time, percent."""
        weighted = sum(getattr(launch, of) * launch.time_us for launch in self.launches)
        return weighted / self.time_us if self.time_us else 0.0


class ProfileError(Exception):
    """Nsight Compute did not measure; the text says what it said."""


def known(ncu: str) -> set[str]:
    """Metrics of this chip, without their suffixes."""
    try:
        listed = subprocess.run([ncu, "--query-metrics"], capture_output=True, text=True, timeout=LIMIT_S, check=False)
    except OSError as error:
        raise ProfileError(f"{error}: Nsight Compute is needed, --ncu /path/to/ncu names it") from error
    metrics = {line.split()[0] for line in listed.stdout.splitlines() if "__" in line}
    if not metrics:
        raise ProfileError(f"{ncu} --query-metrics names none:\n{(listed.stdout + listed.stderr)[-1000:]}")
    return metrics


def launches(lines: list[str], tensor: str) -> list[Launch]:
    """What `ncu --csv --page raw` prints: a line of names, a line of units, then a line for each launch."""
    rows = csv.DictReader(line for line in lines if line.startswith('"'))
    units = next(rows, {})
    to_us = {"ns": 1e-3, "nsecond": 1e-3, "us": 1.0, "usecond": 1.0, "ms": 1e3, "msecond": 1e3, "s": 1e6, "second": 1e6}
    to_mb = {"byte": 1e-6, "Kbyte": 1e-3, "Mbyte": 1.0, "Gbyte": 1e3, "B": 1e-6, "KB": 1e-3, "MB": 1.0, "GB": 1e3}

    def number(row: dict[str, str], name: str) -> float:
        return float(row[name].replace(",", ""))

    try:
        found = [
            Launch(
                kernel=row["Kernel Name"],
                grid=row["Grid Size"].replace(" ", ""),
                time_us=number(row, TIME) * to_us[units[TIME]],
                memory=number(row, MEMORY),
                tensor=number(row, tensor),
                megabytes=number(row, BYTES) * to_mb[units[BYTES]],
            )
            for row in rows
        ]
    except (KeyError, ValueError) as error:
        raise ProfileError(f"the profiler's table is not as this program knows it: {error!r}") from error
    if not found:
        said = "\n".join(line for line in lines if line.startswith("=="))
        hint = "counters are for root, or for all with the driver's NVreg_RestrictProfilingToAdminUsers=0; "
        hint = hint if "ERR_NVGPUCTRPERM" in said else ""
        raise ProfileError(f"{hint}the profiler saw no kernel:\n{said[-2000:]}")
    return found


def profile(options: argparse.Namespace, what: str, tensor: str) -> list[Launch]:
    """Every launch of a step of inference, or of an update of one epoch."""
    learner = [options.learner, "bench", "--device", "cuda", "--preset", options.preset, "--mark", what]
    learner += ["--seconds", "0.001", "--batches", options.batch, "--steps", options.steps]
    # Where the step of inference is looked at, updates shall be over soon.
    learner += ["--rollout-frames", options.rollout_frames if what == "update" else 16 * options.steps]
    learner += [word for setting in options.set for word in ("--set", setting)]
    command = [options.ncu, "--csv", "--page", "raw", "--print-units", "base", "--profile-from-start", "off"]
    command += ["--target-processes", "all", "--clock-control", "none", "--cache-control", "none"]
    command += ["--metrics", ",".join([TIME, MEMORY, BYTES, tensor])]
    words = [str(word) for word in [*command, *learner]]
    print("+", *words, file=sys.stderr, flush=True)
    finished = subprocess.run(words, stdout=subprocess.PIPE, text=True, timeout=LIMIT_S, check=False)
    if finished.returncode != 0:
        raise ProfileError(f"the profiler ended with status {finished.returncode}:\n{finished.stdout[-2000:]}")
    return launches(finished.stdout.splitlines(), tensor)


def bare(kernel: str) -> str:
    """Its name without types and arguments, which have names of other things in them."""
    return kernel.replace("<unnamed>::", "").split("(", maxsplit=1)[0].split("<", maxsplit=1)[0].removeprefix("void ")


def family(kernel: str) -> str:
    """What it is for."""
    name = bare(kernel)
    return next(
        (family for family, parts in FAMILIES.items() if any(part in name for part in parts)), "everything else"
    )


def groups(found: list[Launch], key: Callable[[Launch], tuple[str, str]]) -> list[Group]:
    """By their time, the longest first."""
    by_key: dict[tuple[str, str], Group] = {}
    for launch in found:
        by_key.setdefault(key(launch), Group(*key(launch))).launches.append(launch)
    return sorted(by_key.values(), key=lambda group: -group.time_us)


def table(what: str, found: list[Launch], lines: int) -> str:
    """What kernels are for, then each kernel with one number of blocks."""
    form = "{:<46} {:<15} {:>8} {:>7} {:>9} {:>9} {:>7} {:>7}"
    total_us = sum(launch.time_us for launch in found)

    def line(group: Group) -> str:
        count = len(group.launches)
        share, time_us, megabytes = group.time_us / total_us, group.time_us / count, group.megabytes / count
        cells = [group.name[:46], group.grid, count, f"{share:.1%}", f"{time_us:.1f}", f"{megabytes:.1f}"]
        return form.format(*cells, *(f"{group.share(of):.0f}%" for of in ("memory", "tensor")))

    kernels = groups(found, lambda launch: (bare(launch.kernel), launch.grid))
    text = [f"{what}: {len(found)} launches, {total_us / 1e3:.3f} ms one after the other"]
    text += [form.format("for", "", "launches", "time", "µs each", "MB each", "memory", "tensor")]
    text += [line(group) for group in groups(found, lambda launch: (family(launch.kernel), ""))]
    text += [form.format("kernel", "blocks", "launches", "time", "µs each", "MB each", "memory", "tensor")]
    text += [line(group) for group in kernels[:lines]]
    if rest := kernels[lines:]:
        share = sum(group.time_us for group in rest) / total_us
        text.append(f"{f'{len(rest)} more':<62} {sum(len(group.launches) for group in rest):>8} {share:>7.1%}")
    return "\n".join(text)


def main() -> None:
    """Checks, measures, and says what went wrong."""
    options = arguments()
    if not os.access(options.learner, os.X_OK):
        sys.exit(f"bench-kernels: {options.learner}: no such program; `make build` makes it")
    try:
        measure(options)
    except (ProfileError, subprocess.TimeoutExpired) as error:
        sys.exit(f"bench-kernels: {error}")


def measure(options: argparse.Namespace) -> None:
    """Profiles, prints, writes."""
    metrics = known(options.ncu)
    tensor = next((name for name in TENSOR if name.split(".")[0] in metrics), None)
    if tensor is None:
        raise ProfileError(f"this chip has none of {', '.join(TENSOR)}")
    everything = {}
    for what in options.what or ["inference", "update"]:
        found = profile(options, what, tensor)
        everything[what] = [vars(launch) for launch in found]
        print(table(what, found, options.lines), end="\n\n", flush=True)
    if options.json:
        options.json.write_text(
            json.dumps({"tensor": tensor, "launches": everything}, indent=1) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main()
