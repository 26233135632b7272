"""The loops of light maps: which point of a chart a texel stands for, and how values spread to texels without one."""

import numpy as np
from numba import boolean, float32, float64, int32, int64

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


@kernel((float32[:, :, :, ::1], boolean[:, :, ::1], int32[:, :, ::1], int64))
def spread(values, valid, chart, rounds):  # type: ignore[no-untyped-def]
    """Gives texels without a valid value the mean of their valid neighbours on the same chart, in place, for `rounds`.

    values (P, H, W, C), valid (P, H, W), chart (P, H, W), 0 = no chart.
    """
    pages, height, width, channels = values.shape
    total = np.zeros(channels, np.float32)
    for _ in range(rounds):
        before = valid.copy()
        changed = 0
        for p in range(pages):
            for y in range(height):
                for x in range(width):
                    if before[p, y, x] or chart[p, y, x] == 0:
                        continue
                    total[:] = 0
                    count = 0
                    for j in range(max(y - 1, 0), min(y + 2, height)):
                        for i in range(max(x - 1, 0), min(x + 2, width)):
                            if before[p, j, i] and chart[p, j, i] == chart[p, y, x]:
                                count += 1
                                for c in range(channels):
                                    total[c] += values[p, j, i, c]
                    if count > 0:
                        for c in range(channels):
                            values[p, y, x, c] = total[c] / count
                        valid[p, y, x] = True
                        changed += 1
        if changed == 0:
            break
