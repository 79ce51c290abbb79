"""Ours beside the peers': one table of ratios, the checks, and the targets."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from statistics import median

from .measure import Answer, Figure

#: Depth may differ from Embree's by this much off silhouettes, millimetres: rounding alone takes half of one.
DEPTH_BOUND_MM = 1.0
#: Masses may differ by this share: single against double precision.
MASS_BOUND = 1e-4
#: Environments in one process, as in a rollout.
ENVIRONMENTS = 32

#: What is compared: key of the results, its name, and the figures to reach: rates of ours, ratio to the best peer.
ROWS: list[tuple[Figure, str, dict[str, int], int | None]] = [
    ("depth_s", "depth frames/s", {"random": 12_000, "oracle": 12_000}, 20),
    ("rays_s", "  for comparison", {}, None),
    ("physics_s", "physics steps/s", {}, None),
    ("whole_step_s", "whole steps/s", {"random": 5_000, "oracle": 3_500}, 25),
]
#: What of ours stands beside a figure that ours has none of.
OWN: dict[Figure, Figure] = {"rays_s": "depth_s"}


@dataclass(frozen=True)
class Ours:
    """What `actor bench --json` prints."""

    measurements: list[dict]

    def seconds(self, key: Figure, policy: str) -> dict[str, float]:
        """Processor time of one frame or step, for each kitchen."""
        return {
            str(row["kitchen"]): row[key]
            for row in self.measurements
            if row["policy"] == policy and row["environments"] == ENVIRONMENTS
        }


@dataclass(frozen=True)
class Line:
    """One peer beside ours in one respect."""

    what: str
    policy: str
    peer: str
    ours: list[float]
    theirs: list[float]

    @property
    def ratio(self) -> float:
        """How much faster ours is, in the median kitchen."""
        return median(theirs / ours for ours, theirs in zip(self.ours, self.theirs, strict=True))

    @property
    def least_ratio(self) -> float:
        """How much faster ours is, in the kitchen where that is least."""
        return min(theirs / ours for ours, theirs in zip(self.ours, self.theirs, strict=True))


def lines(ours: Ours, answers: list[Answer], policy: str, key: Figure, what: str) -> list[Line]:
    """A line for each peer that was measured in this respect, best peer first."""
    found = []
    for answer in answers:
        results = {number: result for number, result in answer["results"][policy].items() if key in result}
        if results:
            seconds = ours.seconds(OWN.get(key, key), policy)
            numbers = sorted(results, key=int)
            theirs = [float(results[number][key]) for number in numbers]
            found.append(Line(what, policy, answer["peer"], [seconds[number] for number in numbers], theirs))
    return sorted(found, key=lambda line: median(line.theirs))


def rate(seconds: list[float]) -> str:
    """Median and slowest, a second."""
    return f"{1 / median(seconds):>8,.0f} {1 / max(seconds):>8,.0f}"


def checks(answer: Answer) -> Iterator[dict[str, float]]:
    """What a peer's program checked in each kitchen."""
    for results in answer["results"].values():
        for result in results.values():
            yield result.get("checks", {})


def worst(answer: Answer, key: str) -> float | None:
    """The largest of a checked figure, if it was checked."""
    values = [figures[key] for figures in checks(answer) if key in figures]
    return max(values) if values else None


def mean_of(answer: Answer, key: str) -> float:
    """The mean of a checked figure."""
    values = [figures[key] for figures in checks(answer) if key in figures]
    return sum(values) / len(values)


def report(ours: Ours, answers: list[Answer], policies: list[str], skipped: list[str]) -> tuple[str, bool]:
    """The whole text, the summary last, and whether every check holds."""
    out, verdicts, sound = [], [], True
    kitchens = len(ours.seconds("depth_s", policies[0]))
    out.append(
        f"{kitchens} kitchens, one core, processor time: median and slowest kitchen, and the ratio in the median"
    )
    out.append("and in the least favourable kitchen")
    out.append("")
    out.append(f"{'':<7} {'':<16} {'peer':<36} {'ours':>17}  {'peer':>17}  {'ratio':>13}")
    for policy in policies:
        for key, what, rates, ratio_target in ROWS:
            found = lines(ours, answers, policy, key, what)
            for line in found:
                ratios = f"{line.ratio:>6.1f} {line.least_ratio:>6.1f}"
                out.append(f"{policy:<7} {what:<16} {line.peer:<36} {rate(line.ours)}  {rate(line.theirs)}  {ratios}")
            if policy in rates:
                own = 1 / median(ours.seconds(key, policy).values())
                verdicts.append(verdict(f"{policy}: {what}", own, rates[policy], "{:,.0f}"))
            if ratio_target and policy == "random" and found:
                verdicts.append(
                    verdict(f"{policy}: {what}, ratio to the best peer", found[0].ratio, ratio_target, "{:.1f}")
                )
    out.append("")
    triangles = [row["view_set_triangles"] for row in ours.measurements if row["environments"] == ENVIRONMENTS]
    out.append(f"triangles in the view set: median {median(triangles):,.0f}, fewest {min(triangles):,.0f}")
    for answer in answers:
        for text, holds in agreements(answer):
            out.append(text if holds else f"FAILED: {text}")
            sound &= holds
    out += [note for answer in answers for note in answer["notes"]]
    out += skipped
    out.append("")
    out += verdicts
    missed = sum("MISSED" in text for text in verdicts)
    out.append(
        f"summary: {len(verdicts) - missed} of {len(verdicts)} targets met; "
        f"{'all checks hold' if sound else 'A CHECK FAILED'}; {summary(ours, answers, policies[0])}"
    )
    return "\n".join(out), sound


def verdict(what: str, value: float, target: float, form: str) -> str:
    """A line that says whether a target is met."""
    met = "met" if value >= target else "MISSED"
    return f"{what}: {form.format(value)} (target at least {form.format(target)}): {met}"


def agreements(answer: Answer) -> Iterator[tuple[str, bool]]:
    """Whether a peer saw and simulated the same kitchens."""
    peer = answer["peer"]
    largest = worst(answer, "max_mm")
    if largest is not None:
        text = (
            f"depth against {peer}, off silhouettes ({mean_of(answer, 'share_counted'):.0%} of pixels): "
            f"median {mean_of(answer, 'median_mm'):.2f} mm, 99.9th percentile {worst(answer, 'p999_mm'):.2f} mm, "
            f"largest {largest:.2f} mm (bound {DEPTH_BOUND_MM:g} mm)"
        )
        yield text, largest <= DEPTH_BOUND_MM
    depth = worst(answer, "depth_median_mm")
    if depth is not None:
        yield f"depth against {peer}: median difference {depth:.2f} mm in the worst kitchen", True
    mass = worst(answer, "mass_error")
    if mass is not None:
        yield f"masses in {peer}: equal to {mass:.1e}", mass <= MASS_BOUND
        yield (
            f"at rest in {peer}: {worst(answer, 'awake_at_rest'):.0f} things awake after four seconds in the worst "
            f"kitchen, moved by at most {worst(answer, 'rest_drift_mm'):.1f} mm",
            True,
        )
        yield (
            f"disturbed things an episode: {mean_of(answer, 'disturbed_in_ours'):.2f} in ours, "
            f"{mean_of(answer, 'disturbed'):.2f} in {peer}",
            True,
        )


def summary(ours: Ours, answers: list[Answer], policy: str) -> str:
    """The ratios to the best peer, in a few words."""
    parts = []
    for key, what, _, _ in ROWS:
        found = lines(ours, answers, policy, key, what)
        if found and key not in OWN:
            parts.append(f"{what.split()[0]} {found[0].ratio:.1f} × {found[0].peer.split(',')[0]}")
    return ", ".join(parts) or "no peer was measured"
