"""What a cascade's depth map can show of a scene: its draws without the instances that lie beside it. No OpenGL.

Along the light nothing is left out: what stands between the light and the slice of the view hides light from it.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from glhybrid.geometry import Geometry
from glhybrid.scene import F64

SLACK = 1.0  # texels: rounding of float32 rows


def boxes(geometry: Geometry) -> F64:
    """(I, 2, 3) world, about the triangles of every instance that is drawn; NaN where it has none."""
    found = np.full((len(geometry.instance_mesh), 2, 3), np.nan)
    for number, mesh in enumerate(geometry.meshes):
        runs = [np.arange(first, first + count) for first, count in mesh.geometries]
        rows = np.concatenate([np.zeros(0, np.int64), *runs])
        on = geometry.instance_mesh == number
        if not len(rows) or not on.any():
            continue
        corners = geometry.vertices[geometry.triangles[rows, :3].reshape(-1), :3].astype(np.float64)
        low, high = corners.min(0), corners.max(0)
        pose = geometry.world_from_object[on]
        centre = pose[:, :3, :3] @ ((low + high) / 2) + pose[:, :3, 3]
        half = np.abs(pose[:, :3, :3]) @ ((high - low) / 2)
        found[on] = np.stack([centre - half, centre + half], 1)
    return found


def beside(row: Any, boxes: F64) -> Any:
    """(I,) bool: instances that no ray of a map meets. row: of layout ShadowMap, parallel rays. boxes: relative to the
    same origin."""
    centre, half = boxes.mean(1), (boxes[:, 1] - boxes[:, 0]) / 2
    out = np.isnan(centre[:, 0])
    for k, name in enumerate(("right", "up")):
        axis, texel = row[name].astype(np.float64), float(row["texel"][k])
        at, reach = centre @ axis / texel - row["first_texel"][k], half @ np.abs(axis) / texel + SLACK
        out |= (at + reach < 0) | (at - reach > row["size"])
    return out


class Commands:
    """Indirect commands of one state, (C, 5) uint32, and the instances that they draw.

    pairs: (P, 2) as draws.batches has them, by instance number of a command.
    """

    def __init__(self, rows: Sequence[Sequence[int]], pairs: Sequence[tuple[int, int]]) -> None:
        self.rows = np.array(rows, np.uint32)
        counts = self.rows[:, 1].astype(np.int64)
        self._command = np.repeat(np.arange(len(counts)), counts)
        first = np.cumsum(counts) - counts
        self._pair = self.rows[self._command, 4] + np.arange(len(self._command)) - first[self._command]
        self._instance = np.array(pairs, np.int64).reshape(-1, 2)[self._pair, 0]

    @property
    def most(self) -> int:
        """Commands that `without` may give."""
        return len(self._pair)

    def without(self, left_out: Any) -> Any:
        """(R, 5) uint32: the same draws but for some instances, (I,) bool; neighbours that stay share a command."""
        kept = np.flatnonzero(~left_out[self._instance])
        if not len(kept):
            return self.rows[:0]
        of = self._command[kept]
        begins = np.flatnonzero(np.concatenate([[True], (np.diff(kept) != 1) | (np.diff(of) != 0)]))
        out = self.rows[of[begins]]
        out[:, 1] = np.diff(np.concatenate([begins, [len(kept)]]))
        out[:, 4] = self._pair[kept[begins]]
        return out
