"""How far two depth images of the same scene differ where no silhouette is near."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt


class Agreement:
    """Differences, collected over frames.

    A pixel counts if it and its eight neighbours show the same convex part: such a part hides nothing of itself, so
    its depth is continuous there, and a shift of a silhouette by less than a pixel does not matter. Pixels that see a
    surface from behind do not count either: there the camera stands inside of a solid.
    """

    def __init__(self) -> None:
        self.differences_mm: list[npt.NDArray[np.float32]] = []
        self.pixels = 0
        self.behind = 0

    def add(
        self,
        depth_mm: npt.NDArray[np.uint16],
        reference_m: npt.NDArray[np.float32],
        part: npt.NDArray[np.int64],
        from_behind: npt.NDArray[np.bool_],
    ) -> None:
        """Adds a frame: ours, the reference, the convex part at each pixel of the reference (-1 for none)."""
        counts = inside(part) & (part >= 0) & ~from_behind
        reference_mm = reference_m * 1000.0
        self.differences_mm.append(np.abs(depth_mm - reference_mm)[counts].astype(np.float32))
        self.pixels += part.size
        self.behind += int(from_behind.sum())

    def figures(self) -> dict[str, float]:
        """Median, 99.9th percentile and largest difference, millimetres; the share of pixels they stand for."""
        all_mm = np.concatenate(self.differences_mm)
        return {
            "median_mm": float(np.median(all_mm)),
            "p999_mm": float(np.percentile(all_mm, 99.9)),
            "max_mm": float(all_mm.max()),
            "share_counted": len(all_mm) / self.pixels,
            "share_from_behind": self.behind / self.pixels,
        }


def inside(part: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """Pixels whose eight neighbours show the same part; none on the image's rim."""
    same = np.zeros(part.shape, bool)
    same[1:-1, 1:-1] = True
    rows, columns = part.shape
    centre = part[1:-1, 1:-1]
    for down in range(3):
        for right in range(3):
            same[1:-1, 1:-1] &= part[down : rows - 2 + down, right : columns - 2 + right] == centre
    return same
