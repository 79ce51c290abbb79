"""Measures what a viewer with an open page costs a run: the same run in pairs, without and with `up --view`.

The two of a pair follow each other at once, and every second pair has them the other way round, so that neither a slow
drift of the machine nor the order counts. A pair's figure is the ratio of its training times; all pairs together give
their geometric mean with a 95% interval. Nothing else may run meanwhile.
"""

from __future__ import annotations

import argparse
import http.client
import json
import math
import os
import platform
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request
from dataclasses import dataclass, field
from pathlib import Path

#: A run that has not ended after this long hangs.
LIMIT_S = 1800
#: The viewer has to be there within this.
START_S = 60
#: Browsers that are looked for.
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
#: Ticks of processor time a second.
TICKS = os.sysconf("SC_CLK_TCK")
#: Student's t, two-sided 95%, by degrees of freedom from 1.
STUDENT = (12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26, 2.23, 2.20, 2.18, 2.16, 2.14, 2.13, 2.12, 2.11, 2.10, 2.09)


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--orchestrator", type=Path, required=True, help="our program")
    parser.add_argument("--pairs", type=int, default=8, help="pairs of runs, two at least (default: %(default)s)")
    parser.add_argument("--frames", type=int, default=40_000, help="frames of each run (default: %(default)s)")
    parser.add_argument("--actors", type=int, default=2, help="actors of each run (default: %(default)s)")
    parser.add_argument(
        "--page",
        choices=("requests", "browser"),
        default="requests",
        help="who looks: requests as a page makes them, with one environment's depth (default); or a headless browser on "
        "the same machine, whose own work then counts, too",
    )
    parser.add_argument("--json", type=Path, help="write every run here")
    arguments = parser.parse_args()
    if arguments.pairs < 2:
        parser.error("--pairs: an interval needs two pairs at least")
    return arguments


@dataclass
class Page:
    """Somebody who looks at a run as long as it lasts."""

    address: str
    token: str
    run: str
    asked: int = 0
    problem: str = ""
    over: threading.Event = field(default_factory=threading.Event)

    def open(self, path: str) -> http.client.HTTPResponse:
        """The answer at a path."""
        headers = {"Authorization": f"Bearer {self.token}"}
        return urllib.request.urlopen(urllib.request.Request(f"{self.address}{path}", headers=headers), timeout=60)

    def get(self, path: str) -> object:
        """JSON at a path."""
        self.asked += 1
        with self.open(path) as answer:
            return json.loads(answer.read())

    def look(self) -> None:
        """What the script of a page asks for: the stream of events, new curves with each, a depth picture in between."""
        known, due = 0, 0.0
        try:
            for line in self.open(f"/api/runs/{self.run}/live"):
                if self.over.is_set():
                    return
                if not line.startswith(b"data:"):
                    continue
                live = json.loads(line[5:])
                if live.get("rollouts", 0) > known:
                    new = self.get(f"/api/runs/{self.run}/curves?edition=1&known={known}")
                    known = new["from"] + len(new["frames"])
                if live.get("kitchens") and time.monotonic() > due:
                    began = time.monotonic()
                    self.depth(live["kitchens"][0])
                    # As the page does it: a tenth of one core's time at most.
                    due = time.monotonic() + max(4.0, 9 * (time.monotonic() - began))
        except urllib.error.HTTPError as error:
            self.problem = f"{error.url}: {error}"
        except OSError:
            # The viewer ends with its run.
            return

    def depth(self, kitchen: dict) -> None:
        """What the newest step of a kitchen's first environment sees."""
        run = f"/api/runs/{self.run}"
        key = self.get(f"{run}/newest/{kitchen['kitchen']}/{kitchen['environments'][0]}")
        if key is None:
            return
        step = len(self.get(f"{run}/episodes/{key}")["moments"]) - 1
        self.asked += 1
        self.open(f"{run}/episodes/{key}/picture?view=depth&step={step}&width=224&of={step}").read()


def browse(address: str, profile: str) -> subprocess.Popen:
    """A headless browser with the page."""
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    if program is None:
        sys.exit("viewer.py: no Chromium is on the PATH: --page requests needs none")
    flags = ["--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", "--remote-debugging-port=0"]
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen([program, *flags, f"--user-data-dir={profile}", address], **silent)


def opener(folder: Path) -> Path:
    """Copies the page that a desktop would be asked to open, and that leads to the viewer's."""
    program = folder / "xdg-open"
    program.write_text('#!/bin/sh\ncp "$1" "$0.new" && mv "$0.new" "$0.html"\n')
    program.chmod(0o755)
    return folder / "xdg-open.html"


@dataclass
class Processor:
    """Processor time of the viewer that a run has started, with what it started itself, as long as it lives."""

    run_pid: int
    used_s: float = 0.0
    over: threading.Event = field(default_factory=threading.Event)

    def watch(self) -> None:
        """Reads it a few times a second: what has ended cannot be asked any more."""
        while not self.over.wait(0.25):
            for entry in Path("/proc").glob("[0-9]*"):
                try:
                    words = (entry / "stat").read_text().rpartition(")")[2].split()
                    if int(words[1]) != self.run_pid or b"\0view\0" not in (entry / "cmdline").read_bytes():
                        continue
                except (OSError, IndexError):
                    continue
                # Its own, and its children's that have ended; those that go on are read with it.
                self.used_s = max(self.used_s, (sum(map(int, words[11:15])) + living(entry.name)) / TICKS)


def living(parent: str) -> int:
    """Ticks of processor time of a process's children that have not ended."""
    ticks = 0
    for tasks in Path(f"/proc/{parent}/task").glob("*/children"):
        try:
            for child in tasks.read_text().split():
                words = Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()
                ticks += sum(map(int, words[11:15]))
        except OSError:
            continue
    return ticks


def training_s(run: Path) -> float:
    """Seconds of all rollouts but the first, in which the page is opened."""
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    return sum(sum(line["timing"].values()) for line in lines[1:])


def train(options: argparse.Namespace, place: Path, with_viewer: bool) -> dict:
    """One run: its training time, and how much was asked meanwhile."""
    run, asked = place / "run", opener(place)
    command = [options.orchestrator.resolve(), "up", "--preset", "demo", "--seed", "1", "--run", run]
    command += ["--actors", str(options.actors), "--frames", str(options.frames)]
    settings = dict(os.environ, PATH=f"{place}:{os.environ.get('PATH', '')}")
    silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    child = subprocess.Popen([*command, "--view"] if with_viewer else command, env=settings, text=True, **silent)
    page, browser, looking = None, None, None
    processor = Processor(child.pid)
    if with_viewer:
        deadline = time.monotonic() + START_S
        while not asked.exists() and child.poll() is None and time.monotonic() < deadline:
            time.sleep(0.02)
        if not asked.exists():
            child.kill()
            sys.exit(f"viewer.py: no viewer was started:\n{child.communicate()[1]}")
        page = Page(*re.search(r"(http://[^/]+)/#token=([\w-]+)", asked.read_text()).groups(), run.name)
        if options.page == "browser":
            browser = browse(asked.as_uri(), str(place / "profile"))
        else:
            looking = threading.Thread(target=page.look, daemon=True)
            looking.start()
        threading.Thread(target=processor.watch, daemon=True).start()
    try:
        problem = child.communicate(timeout=LIMIT_S)[1]
    finally:
        child.kill()
        if browser:
            browser.terminate()
            browser.wait()
        if page:
            page.over.set()
        processor.over.set()
    if child.returncode != 0:
        sys.exit(f"viewer.py: a run failed:\n{problem}")
    if looking:
        looking.join(START_S)
        if page.problem or not page.asked:
            sys.exit(f"viewer.py: nobody looked at the run to its end: {page.problem}")
    if with_viewer and processor.used_s == 0.0:
        sys.exit("viewer.py: the viewer's processor time was not seen")
    asked = page.asked if page else 0
    return {"viewer": with_viewer, "training_s": training_s(run), "asked": asked, "processor_s": processor.used_s}


def interval(ratios: list[float]) -> tuple[float, float, float]:
    """Geometric mean of the ratios, and its 95% interval."""
    logs = [math.log(ratio) for ratio in ratios]
    mean, spread = statistics.fmean(logs), statistics.stdev(logs) / math.sqrt(len(logs))
    reach = spread * (STUDENT[len(logs) - 2] if len(logs) - 2 < len(STUDENT) else 1.96)
    return math.exp(mean), math.exp(mean - reach), math.exp(mean + reach)


def main() -> None:
    """Trains the pairs one after the other and prints what they came to."""
    options = arguments()
    print(f"{platform.processor() or platform.machine()}, {len(os.sched_getaffinity(0))} cores, load {os.getloadavg()[0]:.1f}")
    pairs, runs = [], []
    for pair in range(options.pairs):
        times = {}
        for with_viewer in (False, True) if pair % 2 == 0 else (True, False):
            with tempfile.TemporaryDirectory() as place:
                run = train(options, Path(place), with_viewer)
            runs.append(run)
            times[with_viewer] = run["training_s"]
        pairs.append(times[True] / times[False])
        print(f"pair {pair + 1}: {times[False]:.1f} s without, {times[True]:.1f} s with, {100 * (pairs[-1] - 1):+.2f}%", flush=True)
    mean, low, high = interval(pairs)
    asked = [run["asked"] for run in runs if run["viewer"]]
    print(f"a viewer with an open page ({options.page}, {statistics.median(asked):.0f} requests a run) costs a run")
    print(f"{100 * (mean - 1):+.2f}% of its time, 95% interval {100 * (low - 1):+.2f}% to {100 * (high - 1):+.2f}%, {len(pairs)} pairs")
    looked = [run for run in runs if run["viewer"]]
    used = sum(run["processor_s"] for run in looked)
    share = used / (len(os.sched_getaffinity(0)) * sum(run["training_s"] for run in looked))
    print(f"processor time of the viewer: {used / len(looked):.2f} s a run, {100 * share:.2f}% of all cores' time")
    print("asked: below 2%:", "met" if high < 1.02 else "not shown" if low < 1.02 else "missed")
    if options.json:
        options.json.write_text(json.dumps({"runs": runs, "ratios": pairs, "mean": mean, "low": low, "high": high}, indent=2))


if __name__ == "__main__":
    main()
