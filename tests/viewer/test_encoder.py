"""Frames become files in processes of their own; a process that has gone is done without."""

import io

import numpy as np
import pytest

from glhybrid.viewer.encoder import Coded, Encoders


def test_files_hold_the_frame_and_processes_end() -> None:
    from PIL import Image

    rng = np.random.default_rng(3)
    frames = [rng.integers(0, 256, (h, w, 4), np.uint8) for h, w in ((7, 13), (40, 30))]
    frames[1][...] = np.linspace(0, 255, 30, dtype=np.uint8)[:, None]
    encoders = Encoders(4 * 64 * 64)
    try:
        for gone in (False, True):
            for slot, pixels in ((0, frames[0]), (5, frames[1])):
                size = pixels.shape[1], pixels.shape[0]
                with encoders.slot(slot) as room:
                    room[: pixels.nbytes] = pixels.tobytes()
                png, jpeg = (encoders.encode(Coded(slot, size, exact)) for exact in (True, False))
                want = pixels[::-1, :, :3]  # row 0 at the bottom, and at the top of files
                assert np.array_equal(np.asarray(Image.open(io.BytesIO(png))), want) and png[1:4] == b"PNG"
                read = np.asarray(Image.open(io.BytesIO(jpeg))).astype(int)
                assert read.shape == want.shape and (slot == 0 or np.abs(read - want).max() < 12)
            for process in encoders._processes.values():
                assert (process.poll() is not None) == gone  # they were used at first, and could not be in the end
                process.kill()
                process.wait()
    finally:
        encoders.close()
        encoders.close()
    assert all(process.poll() is not None for process in encoders._processes.values())


def test_a_process_ends_with_its_parents_pipe() -> None:
    encoders = Encoders(4096)
    processes = list(encoders._processes.values())
    encoders.close()
    assert [process.wait(5) for process in processes] == [0, 0]
    with pytest.raises(OSError):
        __import__("os").fstat(encoders._file)
