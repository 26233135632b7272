"""The tree builder: triangles a second and the cost of its trees, against a textbook binned-SAH build."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from glhybrid.bvh import build_blas
from glhybrid.scene import F32


@dataclass(frozen=True)
class Build:
    """mtris_s: million triangles a CPU second, on one thread. wall_mtris_s: a second of the clock, on all of them.

    ratio_sah_binned: cost of our tree, of its 16-bit boxes, to that of textbook.binned_sah, which keeps float boxes.
    """

    scene: str
    triangles: int
    mtris_s: float
    wall_mtris_s: float
    sah_cost: float
    ratio_sah_binned: float

    def to_dict(self) -> dict[str, Any]:
        """Ready for JSON: one of the report's `builds`."""
        return {key: getattr(self, key) for key in ("triangles", "mtris_s", "sah_cost", "ratio_sah_binned")}


def measure(name: str, corners: F32, repeats: int) -> Build:
    """corners: (T, 3, 3). Medians; the cache of trees is not asked."""
    from glhybrid.bvh import textbook  # Numba: what else is of use here does without

    build_blas(corners[:2000])  # loads the kernels
    cpu, wall = [], []
    for _ in range(repeats):
        start = time.process_time()
        tree = build_blas(corners, threads=1)
        cpu.append(time.process_time() - start)
        start = time.perf_counter()
        build_blas(corners)
        wall.append(time.perf_counter() - start)
    plain, _ = textbook.binned_sah(corners)
    million = len(corners) / 1e6
    return Build(
        name, len(corners), million / float(np.median(cpu)), million / float(np.median(wall)),
        tree.sah_cost, tree.sah_cost / plain,
    )  # fmt: skip
