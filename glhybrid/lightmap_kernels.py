"""The loops of light maps: which point of a chart a texel stands for, and how values spread to texels without one."""

import numpy as np
from numba import boolean, float32, float64, int32, int64, uint8

from glhybrid.jit import kernel

INSET = 0.05  # texels that points on a chart's border are moved into their triangle


@kernel((float64[:, :, ::1], int64, float64, float64, float64[::1]), inline="always")
def _closest(uv, t, x, y, out):  # type: ignore[no-untyped-def]
    """Weights of corners 1 and 2 of the point of a triangle closest to (x, y) -> out; returns the squared distance.

    Ericson, "Real-Time Collision Detection" (2005), 5.1.5.
    """
    ax, ay = uv[t, 0, 0], uv[t, 0, 1]
    abx, aby, acx, acy = uv[t, 1, 0] - ax, uv[t, 1, 1] - ay, uv[t, 2, 0] - ax, uv[t, 2, 1] - ay
    apx, apy = x - ax, y - ay
    det = abx * acy - aby * acx
    if det != 0.0:
        v, w = (apx * acy - apy * acx) / det, (abx * apy - aby * apx) / det
        if v >= 0.0 and w >= 0.0 and v + w <= 1.0:
            out[0], out[1] = v, w
            return 0.0
    best = np.inf
    for edge in range(3):  # AB, AC, BC
        ox, oy, dx, dy = 0.0, 0.0, abx, aby
        if edge == 1:
            dx, dy = acx, acy
        elif edge == 2:
            ox, oy, dx, dy = abx, aby, acx - abx, acy - aby
        length = dx * dx + dy * dy
        s = 0.0
        if length > 0.0:
            s = min(max(((apx - ox) * dx + (apy - oy) * dy) / length, 0.0), 1.0)
        ex, ey = apx - ox - s * dx, apy - oy - s * dy
        distance = ex * ex + ey * ey
        if distance < best:
            best = distance
            if edge == 0:
                out[0], out[1] = s, 0.0
            elif edge == 1:
                out[0], out[1] = 0.0, s
            else:
                out[0], out[1] = 1.0 - s, s
    return best


@kernel((float64[:, :, ::1], int64[:, ::1], int64, int64, float64))
def rasterise(uv, boxes, height, width, reach):  # type: ignore[no-untyped-def]
    """The triangle nearest to each texel's centre and the weights of its second and third corner.

    uv (T, 3, 2) texels; boxes (T, 4) x0, y0, x1, y1 of each triangle's chart, which it does not leave. Returns
    (height, width) int32, -1 where no triangle is within reach (texels), and (height, width, 2) float32.
    """
    nearest = np.full((height, width), -1, np.int32)
    bary = np.zeros((height, width, 2), np.float32)
    distance = np.full((height, width), reach * reach)
    weights = np.zeros(2)
    for t in range(uv.shape[0]):
        u0, u1 = min(uv[t, 0, 0], uv[t, 1, 0], uv[t, 2, 0]), max(uv[t, 0, 0], uv[t, 1, 0], uv[t, 2, 0])
        v0, v1 = min(uv[t, 0, 1], uv[t, 1, 1], uv[t, 2, 1]), max(uv[t, 0, 1], uv[t, 1, 1], uv[t, 2, 1])
        x0, x1 = max(int(np.floor(u0 - 2.0)), boxes[t, 0]), min(int(np.ceil(u1 + 2.0)), boxes[t, 2])
        y0, y1 = max(int(np.floor(v0 - 2.0)), boxes[t, 1]), min(int(np.ceil(v1 + 2.0)), boxes[t, 3])
        for y in range(y0, y1):
            for x in range(x0, x1):
                if distance[y, x] <= 0.0:
                    continue
                d = _closest(uv, t, x + 0.5, y + 0.5, weights)
                if d < distance[y, x]:
                    distance[y, x] = d
                    nearest[y, x] = t
                    bary[y, x, 0], bary[y, x, 1] = weights[0], weights[1]
    for y in range(height):
        for x in range(width):
            if nearest[y, x] >= 0 and distance[y, x] > 0.0:
                # Off the border: points of a wall's lower edge lie in the plane of the floor, half of them below it.
                t, v, w = nearest[y, x], bary[y, x, 0], bary[y, x, 1]
                a, b = v - 1.0 / 3.0, w - 1.0 / 3.0
                dx = a * (uv[t, 1, 0] - uv[t, 0, 0]) + b * (uv[t, 2, 0] - uv[t, 0, 0])
                dy = a * (uv[t, 1, 1] - uv[t, 0, 1]) + b * (uv[t, 2, 1] - uv[t, 0, 1])
                share = min(INSET / max(np.sqrt(dx * dx + dy * dy), 1e-9), 0.5)
                bary[y, x, 0], bary[y, x, 1] = v - share * a, w - share * b
    return nearest, bary


@kernel((boolean[:, :, ::1], int32[:, :, ::1], int64))
def neighbours(valid, chart, rounds):  # type: ignore[no-untyped-def]
    """Which texels without a value of their own take the mean of which others on their chart, for `rounds`, in order.

    valid (P, H, W), of those with one; chart (P, H, W), 0 = no chart. Returns texels (M,) int64, the 8 or fewer that
    each takes, (M, 8) int64, -1 beyond, and the ends (rounds,) int64 of each round's.
    """
    pages, height, width = valid.shape
    done = valid.copy()
    room = 0
    for c, v in zip(chart.ravel(), valid.ravel()):  # noqa: B905
        room += c != 0 and not v
    texels = np.empty(room, np.int64)
    others = np.full((room, 8), -1, np.int64)
    ends = np.zeros(rounds, np.int64)
    count = 0
    for r in range(rounds):
        first = count
        for p in range(pages):
            for y in range(height):
                for x in range(width):
                    if done[p, y, x] or chart[p, y, x] == 0:
                        continue
                    k = 0
                    for j in range(max(y - 1, 0), min(y + 2, height)):
                        for i in range(max(x - 1, 0), min(x + 2, width)):
                            if done[p, j, i] and chart[p, j, i] == chart[p, y, x]:
                                others[count, k] = (p * height + j) * width + i
                                k += 1
                    if k > 0:
                        texels[count] = (p * height + y) * width + x
                        count += 1
        for t in range(first, count):
            done.reshape(-1)[texels[t]] = True
        ends[r] = count
        if count == first:
            ends[r:] = count
            break
    return texels[:count], others[:count], ends


@kernel((float32[:, ::1], int64[::1], int64[:, ::1], int64[::1]))
def fill(values, texels, others, ends):  # type: ignore[no-untyped-def]
    """What neighbours() says, done to values (N, C), in place."""
    for t in range(ends[-1]):
        for c in range(values.shape[1]):
            total = np.float32(0)
            k = 0
            while k < 8 and others[t, k] >= 0:
                total += values[others[t, k], c]
                k += 1
            values[texels[t], c] = total / np.float32(k)


@kernel(
    (float32[:, :, :, ::1], uint8[:, :, ::1], int32[:, :, ::1], int64, int64, int64, int64, float32[::1]),
    inline="always",
)
def _mean(values, dark, chart, p, y, x, last, total):  # type: ignore[no-untyped-def]
    """Whether a texel has neighbours on its chart that are bright, or as dark as `last`; it becomes their mean."""
    total[:] = 0
    count = 0
    for j in range(max(y - 1, 0), min(y + 2, values.shape[1])):
        for i in range(max(x - 1, 0), min(x + 2, values.shape[2])):
            if (dark[p, j, i] == 0 or dark[p, j, i] == last) and chart[p, j, i] == chart[p, y, x]:
                count += 1
                for c in range(values.shape[3]):
                    total[c] += values[p, j, i, c]
    if count == 0:
        return False
    for c in range(values.shape[3]):
        values[p, y, x, c] = total[c] / np.float32(count)
    return True


@kernel((float32[:, :, :, ::1], uint8[:, :, ::1], int32[:, :, ::1]))
def soften(values, dark, chart):  # type: ignore[no-untyped-def]
    """Gives dark texels next to others, and those next to them, the mean of their neighbours on the chart, in place.

    values (P, H, W, C), dark (P, H, W) 0 or 1, overwritten; chart (P, H, W).
    """
    pages, height, width, channels = values.shape
    border = [(0, 0, 0) for _ in range(0)]
    total = np.zeros(channels, np.float32)
    for p in range(pages):
        for y in range(height):
            for x in range(width):
                if dark[p, y, x] == 1 and _mean(values, dark, chart, p, y, x, 0, total):
                    border.append((p, y, x))
    for p, y, x in border:
        dark[p, y, x] = 2
    for p, y, x in border:
        for j in range(max(y - 1, 0), min(y + 2, height)):
            for i in range(max(x - 1, 0), min(x + 2, width)):
                if dark[p, j, i] == 1 and chart[p, j, i] == chart[p, y, x]:
                    _mean(values, dark, chart, p, j, i, 2, total)
                    dark[p, j, i] = 3
