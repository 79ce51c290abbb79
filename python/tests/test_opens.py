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
