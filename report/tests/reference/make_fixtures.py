"""Reference values for report/tests/reference.rs: point estimates and intervals by rliable itself.

    pip install rliable==1.2.0 arch==7.2.0 scipy==1.17.1 numpy==2.4.6 pandas==2.3.3
    python3 make_fixtures.py            # writes rliable.json beside this file

rliable draws from numpy's global generator. Each resample that it draws is noted here, so that another implementation
can be given the same ones: a resample is a string with one character for each entry of the score matrix, row by row,
the number of the run that the entry is taken from (base 36).
"""

import json
import pathlib

import numpy as np
from rliable import library, metrics

HERE = pathlib.Path(__file__).parent
DIGITS = "0123456789abcdefghijklmnopqrstuvwxyz"
RESAMPLES = 250


def estimates(scores: np.ndarray) -> np.ndarray:
    return np.array([metrics.aggregate_mean(scores), metrics.aggregate_iqm(scores)])


def case(name: str, scores: np.ndarray) -> dict:
    drawn = []

    class Noting(library.StratifiedBootstrap):
        def update_indices(self):
            indices = super().update_indices()
            drawn.append("".join(DIGITS[run] for run in indices[0].reshape(-1)))
            return indices

    library_class, library.StratifiedBootstrap = library.StratifiedBootstrap, Noting
    try:
        points, intervals = library.get_interval_estimates({name: scores}, estimates, reps=RESAMPLES)
    finally:
        library.StratifiedBootstrap = library_class
    assert len(drawn) == RESAMPLES
    (mean, iqm), ((mean_low, iqm_low), (mean_high, iqm_high)) = points[name], intervals[name]
    return {
        "name": name,
        "scores": scores.tolist(),
        "resamples": drawn,
        "mean": {"point": mean, "low": mean_low, "high": mean_high},
        "iqm": {"point": iqm, "low": iqm_low, "high": iqm_high},
    }


def main() -> None:
    np.random.seed(20260)
    rates = np.random.binomial(360, np.linspace(0.2, 0.9, 5), size=(5, 5)) / 360
    cases = [
        case("five seeds, five kitchens", rates),
        case("two seeds, five kitchens", rates[:2]),
        case("five seeds, one task", rates[:, :1]),
        case("three seeds, seven tasks, any numbers", np.random.standard_normal((3, 7))),
        case("arange", np.arange(80.0).reshape(5, 16)),
    ]
    trimmed = [np.round(np.random.standard_normal(count), 6).tolist() for count in range(1, 14)]
    iqm = [{"values": values, "iqm": metrics.aggregate_iqm(np.array(values))} for values in trimmed]
    with open(HERE / "rliable.json", "w", encoding="utf-8") as file:
        json.dump({"cases": cases, "iqm": iqm}, file, separators=(",", ":"))
        file.write("\n")


if __name__ == "__main__":
    main()
