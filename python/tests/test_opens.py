"""What other programs read of a run: fixed files that the Rust tests hold equal to what is written."""

from __future__ import annotations

import math
import shutil
import warnings
from pathlib import Path

import pytest
from conftest import REPOSITORY

REFERENCE = REPOSITORY / "tests" / "reference"

with warnings.catch_warnings():
    # Of TensorBoard's own imports.
    warnings.simplefilter("ignore")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator


@pytest.mark.filterwarnings("ignore")
def test_tensorboard_reads_event_files(tmp_path: Path) -> None:
    """Steps, times and figures, and what a later start makes void. The Rust test
    `a_file_is_that_of_tensorboards_own_writer_byte_for_byte` writes these bytes."""
    written = (REFERENCE / "tensorboard" / "written.tfevents").read_bytes()
    first = tmp_path / "events.out.tfevents.1763800000.lab7.001"
    # A run that was killed in the middle of a record, and goes on in a file of its own.
    first.write_bytes(written[:-3])
    shutil.copy(REFERENCE / "tensorboard" / "written.tfevents", tmp_path / "events.out.tfevents.1763800001.lab7.002")
    board = EventAccumulator(str(tmp_path), size_guidance={"scalars": 0}).Reload()
    assert board.Tags()["scalars"] == ["charts/SPS", "charts/episodic_return", "losses/policy_loss", "charts/a"]
    returns = board.Scalars("charts/episodic_return")
    # The second start, from step 2433 on, voids the first one's: each step is there once.
    assert [(event.step, event.wall_time, event.value) for event in returns] == [(4864, 1_763_800_060.0, -0.0625)]
    assert board.Scalars("charts/SPS")[0].value == 1253.0
    lone, last = board.Scalars("charts/a")
    assert (lone.step, math.isnan(lone.value), last.step, last.value) == (7296, True, 45_000_000, 0.0)


def test_prometheus_reads_metrics() -> None:
    """The Rust test `what_is_exported_is_text_that_prometheus_reads` exports this text."""
    from prometheus_client.parser import text_string_to_metric_families

    text = (REFERENCE / "metrics.prom").read_text(encoding="utf-8")
    families = {family.name: family for family in text_string_to_metric_families(text)}
    assert len(families) > 25
    for family in families.values():
        assert family.documentation.endswith("."), family.name
        assert family.type == "gauge", family.name
        assert family.samples, family.name
    (frames,) = families["stillroom_run_frames"].samples
    assert (frames.labels, frames.value) == ({"run": "a"}, 4864.0)
    info = families["stillroom_run_info"].samples[0]
    assert (info.labels["preset"], info.labels["seed"]) == ('de"mo\\\n', "3")
    assert families["stillroom_run_left_seconds"].samples[0].value == math.inf
