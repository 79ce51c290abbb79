"""Makes written.tfevents with TensorBoard's own writer, for the test that compares our bytes with it.

    python tests/reference/tensorboard/make.py        (needs the package tensorboard, as python/requirements.txt has it)
"""

import pathlib

from tensorboard.compat.proto import event_pb2, summary_pb2
from tensorboard.summary.writer.record_writer import RecordWriter

# (step, seconds since 1970, figures); the tags of an event are in order.
POINTS = [
    (4864, 1_763_800_060, {"charts/SPS": 1253.0, "charts/episodic_return": -0.0625, "losses/policy_loss": 1e-8}),
    (7296, 1_763_807_296, {"charts/a": float("nan")}),
    (45_000_000, 1_808_800_000, {"charts/a": 0.0}),
]


def events():
    """A file that begins at 1 763 800 000 s and voids what was there of step 2433 and later ones."""
    begin = {"wall_time": 1_763_800_000}
    yield event_pb2.Event(**begin, file_version="brain.Event:2")
    start = event_pb2.SessionLog(status=event_pb2.SessionLog.START)
    yield event_pb2.Event(**begin, step=2433, session_log=start)
    for step, wall_time, figures in POINTS:
        values = [summary_pb2.Summary.Value(tag=tag, simple_value=value) for tag, value in figures.items()]
        yield event_pb2.Event(wall_time=wall_time, step=step, summary=summary_pb2.Summary(value=values))


if __name__ == "__main__":
    path = pathlib.Path(__file__).with_name("written.tfevents")
    with open(path, "wb") as file:
        writer = RecordWriter(file)
        for event in events():
            writer.write(event.SerializeToString(deterministic=True))
        writer.flush()
    print(path, path.stat().st_size, "bytes")
