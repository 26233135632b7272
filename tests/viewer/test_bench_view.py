"""`bench --view` counts what a user waits for."""

import pytest

import glhybrid
from glhybrid.bench import view
from glhybrid.context import Context
from glhybrid.viewer.panels import WIDTH
from glhybrid.viewer.surface import Memory


def test_answers_are_of_the_oldest_motion_that_was_not_shown() -> None:
    """Moves every 10 ms; frames that show places 0, 2, 2 again and 5; one at rest; then of a rest move 8 at once."""
    client = {
        "moves": [(float(i), 0.0, 0.01 * i) for i in range(10)], "frames": [0.01, 0.05, 0.055, 0.09, 0.1, 0.2],
        "first": 1, "last": 7, "rests": [8],
    }  # fmt: skip
    tags = [((0.0, 0.0), 1.0), ((2.0, 0.0), 0.5), ((2.0, 0.0), 0.5), ((5.0, 0.0), 0.5), (None, 1.0), ((9.0, 0.0), 0.5)]
    found = view.answers(client, tags)
    # Place 1 was sent at 10 ms and shown, with 2, at 50; place 3 was sent at 30 and shown, with 5, at 90.
    assert found["worst_ms"] == pytest.approx(60) and found["median_ms"] == pytest.approx(50)
    assert found["frames_s"] == pytest.approx(1 / 0.04) and found["share"] == 0.5
    assert found["rest_median_ms"] == pytest.approx(120)  # place 8 was sent at 80 ms, 9 came at 200


@pytest.mark.parametrize("kind", ["split", "web"])
def test_rows_are_measured(context: Context, kind: str) -> None:
    pytest.importorskip("aiohttp", reason="the extra `web` is not installed")
    surface = Memory(context, (WIDTH + 300, 160))
    measured = view._in_browser if kind == "web" else view._here
    row = measured(surface, "memory", "cornell", kind, glhybrid.load, 0.5, 1)
    assert row.view == kind and row.size == (300, 160) and row.surface == ("browser" if kind == "web" else "memory")
    assert 0 < row.median_ms <= row.p95_ms <= row.worst_ms < 20_000 and row.frames_s > 0 and row.rest_worst_ms > 0
