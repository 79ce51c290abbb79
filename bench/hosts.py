"""Measures what a second host costs a run: the same two learners on one host and on two, in pairs, and what crosses.

Hosts are network namespaces of this machine with a cable between them, so nothing but the way of the gradients differs:
both runs of a pair have the same seed and must end in the same weights. Bytes are those that the kernel has counted, of
the loopback of the one host and of the cable of the two; a run's whole traffic is in them. Seconds depend on what else
this machine does, shares and ratios of a pair less so.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

#: A run that has not ended after this long hangs.
LIMIT_S = 3600
#: Where the hosts meet.
ADDRESSES = ("10.77.0.1", "10.77.0.2")
#: Rollouts at the beginning that do not count: processes start.
FIRST = 1


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--orchestrator", type=Path, required=True, help="our program")
    parser.add_argument("--pairs", type=int, default=3, help="pairs of runs (default: %(default)s)")
    parser.add_argument("--preset", default="demo", help="of both (default: %(default)s)")
    parser.add_argument("--actors", type=int, default=4, help="actors of both hosts together (default: %(default)s)")
    parser.add_argument("--frames", type=int, default=8_000, help="frames of each run (default: %(default)s)")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="a setting of both; repeat it for more")
    parser.add_argument("--json", type=Path, help="write every run here")
    options = parser.parse_args()
    if options.pairs < 1 or options.actors < 2:
        parser.error("--pairs is 1 at least, and --actors 2: each host has one")
    return options


@dataclass
class Host:
    """A namespace, there as long as the process in it."""

    holder: subprocess.Popen

    @classmethod
    def make(cls, within: Host | None) -> Host:
        """A new one; the first makes a space of users, too, so that nobody needs to be root."""
        words = ["unshare", "--user", "--map-root-user", "--net"] if within is None else [*within.enter(), "unshare", "--net"]
        holder = subprocess.Popen([*words, "sleep", str(2 * LIMIT_S)], stdin=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        comm = Path(f"/proc/{holder.pid}/comm")
        while holder.poll() is None and comm.read_text().strip() != "sleep":
            time.sleep(0.01)
        if holder.poll() is not None:
            sys.exit(f"hosts.py: no network of namespaces here: {holder.stderr.read().strip()}")
        host = cls(holder)
        host.run("ip", "link", "set", "lo", "up")
        return host

    def enter(self) -> list[str]:
        """What a command begins with that runs there."""
        return ["nsenter", "--target", str(self.holder.pid), "--user", "--net", "--preserve-credentials", "--"]

    def run(self, *words: str) -> str:
        """Runs a command there; what it prints."""
        done = subprocess.run([*self.enter(), *words], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            sys.exit(f"hosts.py: {' '.join(words)}: {done.stderr.strip()}")
        return done.stdout

    def sent(self, device: str) -> int:
        """Bytes that it has sent over a device."""
        for line in self.run("cat", "/proc/self/net/dev").splitlines():
            name, _, numbers = line.partition(":")
            if name.strip() == device:
                return int(numbers.split()[8])
        sys.exit(f"hosts.py: there is no device {device}")

    def end(self) -> None:
        """Removes it."""
        self.holder.kill()
        self.holder.wait()


def network() -> list[Host]:
    """Two hosts with a cable between them."""
    first = Host.make(None)
    second = Host.make(first)
    first.run("ip", "link", "add", "eth0", "type", "veth", "peer", "name", "eth0", "netns", str(second.holder.pid))
    for host, address in zip((first, second), ADDRESSES):
        host.run("ip", "addr", "add", f"{address}/24", "dev", "eth0")
        host.run("ip", "link", "set", "eth0", "up")
    return [first, second]


def train(options: argparse.Namespace, hosts: list[Host], place: Path, count: int) -> dict:
    """One run on so many hosts."""
    device = "eth0" if count > 1 else "lo"
    before = [host.sent(device) for host in hosts[:count]]
    (place / "token").write_text(os.urandom(16).hex())
    (place / "token").chmod(0o600)
    children = []
    for rank, host in enumerate(hosts[:count]):
        words = [options.orchestrator.resolve(), "up", "--preset", options.preset, "--seed", "1", "--learners", "2"]
        words += ["--actors", str(options.actors), "--frames", str(options.frames), "--run", place / f"run-{rank}"]
        words += ["--set", "validation.every_frames=0"]
        for setting in options.set:
            words += ["--set", setting]
        if count > 1:
            words += ["--hosts", str(count), "--host-rank", str(rank), "--rendezvous", f"{ADDRESSES[0]}:29400"]
            words += ["--token-file", place / "token"]
        pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        children.append(subprocess.Popen([*host.enter(), *words], text=True, **pipes))
    try:
        printed = [child.communicate(timeout=LIMIT_S) for child in children]
    finally:
        for child in children:
            child.kill()
    for child, (_, problem) in zip(children, printed):
        if child.returncode != 0:
            sys.exit(f"hosts.py: a run failed:\n{problem}")
    weights = next(line for line in printed[0][0].splitlines() if line.startswith("weights: "))
    lines = [json.loads(line) for line in (place / "run-0" / "metrics.jsonl").read_text().splitlines()]
    if len(lines) <= FIRST:
        sys.exit(f"hosts.py: {len(lines)} rollouts are too few: --frames {2 * options.frames}")
    timings = [line["timing"] for line in lines[FIRST:]]
    total = sum(timing[part] for timing in timings for part in ("simulate_s", "infer_s", "update_s", "other_s"))
    sent = [host.sent(device) - earlier for host, earlier in zip(hosts, before)]
    return {
        "hosts": count,
        "weights": weights.removeprefix("weights: "),
        "rollouts": len(lines),
        "frames_per_s": (lines[-1]["frames"] - lines[FIRST - 1]["frames"]) / total,
        "rollout_s": total / len(timings),
        "update_share": sum(timing["update_s"] for timing in timings) / total,
        "exchange_share": sum(timing["exchange_s"] for timing in timings) / total,
        "gradient_bytes_a_rollout": lines[-1]["metrics"]["rollout/exchanged_bytes"],
        # Over the loopback both learners send; over the cable each host sends its own.
        "sent_bytes_a_rollout": sum(sent) / 2 / len(lines),
    }


def main() -> None:
    """Trains the pairs one after the other and prints what they came to."""
    options = arguments()
    print(f"{platform.processor() or platform.machine()}, {len(os.sched_getaffinity(0))} cores, load {os.getloadavg()[0]:.1f}")
    words = " ".join(["--preset", options.preset, *(f"--set {setting}" for setting in options.set)])
    print(f"{words}, {options.actors} actors, 2 learners, {options.frames} frames a run")
    hosts = network()
    runs = []
    try:
        for pair in range(options.pairs):
            for count in (1, 2) if pair % 2 == 0 else (2, 1):
                with tempfile.TemporaryDirectory() as place:
                    runs.append(train(options, hosts, Path(place), count))
            one, two = sorted(runs[-2:], key=lambda run: run["hosts"])
            if one["weights"] != two["weights"]:
                sys.exit(f"hosts.py: the weights differ: {one['weights']} on one host, {two['weights']} on two")
            shares = f"{100 * one['exchange_share']:.1f}% and {100 * two['exchange_share']:.1f}%"
            print(f"pair {pair + 1}: in the exchange {shares} of the time, frames/s {two['frames_per_s'] / one['frames_per_s']:.3f}", flush=True)
    finally:
        for host in reversed(hosts):
            host.end()
    print(f"\n{'':<44}{'one host':>12}{'two hosts':>12}{'ratio':>8}")
    for name, key, scale in (
        ("frames/s", "frames_per_s", 1),
        ("a rollout, ms", "rollout_s", 1e3),
        ("in the update, % of the time", "update_share", 100),
        ("in the exchange of gradients, % of the time", "exchange_share", 100),
        ("gradients given to sums a rollout, MB", "gradient_bytes_a_rollout", 1e-6),
        ("sent by each learner or host a rollout, MB", "sent_bytes_a_rollout", 1e-6),
    ):
        one, two = (statistics.median(run[key] for run in runs if run["hosts"] == count) for count in (1, 2))
        print(f"{name:<44}{scale * one:>12.3f}{scale * two:>12.3f}{two / one:>8.3f}")
    print("medians; the same weights in all runs of a kind and in both kinds:", len({run["weights"] for run in runs}) == 1)
    if options.json:
        options.json.write_text(json.dumps(runs, indent=2))


if __name__ == "__main__":
    main()
