"""Acceleration structures: one `Blas` per distinct mesh, a `Tlas` over instances. No OpenGL; Numba only to build."""

import time

from glhybrid.bvh.blas import Blas, build_blas, pack
from glhybrid.bvh.cache import load_or_build
from glhybrid.bvh.tlas import Tlas, build_tlas
from glhybrid.kernels import TREES

__all__ = ["Blas", "Tlas", "build_blas", "build_tlas", "load_or_build", "pack", "warm_up"]


def warm_up() -> float:
    """Compile the builder, or load it from the cache: then it makes all large trees. Returns seconds."""
    started = time.perf_counter()
    TREES.load()
    from glhybrid.bvh import reinsert

    reinsert.warm_up()
    return time.perf_counter() - started
