"""Our learner's times beside PyTorch's, with ratios."""

from __future__ import annotations

from collections.abc import Callable, Mapping

#: Seconds by variant; `ours` is one of them. None where it failed.
Row = Mapping[str, "float | None"]


def names(rows: list[Row]) -> list[str]:
    """All variants, ours first."""
    found = dict.fromkeys(name for row in rows for name in row)
    return ["ours", *(name for name in found if name != "ours")]


def section(title: str, head: str, rows: dict[str, Row], show: Callable[[str, float], str]) -> list[str]:
    """A table: a line for each size, a column for each variant, with how many times as long as ours it takes."""
    columns = names(list(rows.values()))
    lines = [title, f"{head:>12}" + "".join(f"  {name:>22}" for name in columns)]
    for size, row in rows.items():
        line = f"{size:>12}"
        for name in columns:
            if name not in row:
                cell = "-"
            elif (seconds := row[name]) is None:
                cell = "failed"
            elif name == "ours":
                cell = show(size, seconds)
            else:
                cell = f"{show(size, seconds)} ({seconds / row['ours']:.2f})"
            line += f"  {cell:>22}"
        lines.append(line)
    return lines


def table(inference: Mapping[int, Row], epoch: Mapping[tuple[int, int], Row], machine: str) -> str:
    """The whole text. A ratio above 1: ours is faster."""
    lines = [machine, "in brackets: how many times as long as ours; above 1 ours is faster"]
    if inference:
        rows = {str(batch): row for batch, row in inference.items()}
        title = "inference, milliseconds: frames on the host to actions on the host"
        lines += section(title, "batch", rows, lambda _, seconds: f"{1e3 * seconds:.2f}")
    if epoch:
        frames = {f"{steps} × {environments}": steps * environments for steps, environments in epoch}
        rows = dict(zip(frames, epoch.values(), strict=True))
        title = "one epoch of an update, frames/s: forward, backward, clip, Adam"
        lines += section(title, "T × envs", rows, lambda size, seconds: f"{frames[size] / seconds:,.0f}")
    return "\n".join(lines)
