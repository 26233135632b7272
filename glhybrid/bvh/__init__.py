"""Acceleration structures: one `Blas` per distinct mesh, a `Tlas` over instances. No OpenGL; Numba only to build."""

import time

from glhybrid.bvh.blas import Blas, build_blas, pack
from glhybrid.bvh.cache import load_or_build
from glhybrid.bvh.tlas import Tlas, build_tlas
from glhybrid.kernels import load_all

__all__ = ["Blas", "Tlas", "build_blas", "build_tlas", "load_or_build", "pack", "warm_up"]


def warm_up() -> float:
    """Compile the kernels of trees and motion, or load them from the cache, so that nothing is done without them later.
    Returns seconds."""
    started = time.perf_counter()
    load_all()
    from glhybrid.bvh import reinsert

    reinsert.warm_up()
    return time.perf_counter() - started
