"""What a raster pass draws: indirect commands by state, and the spheres. One list for the camera and for lights."""

from itertools import groupby

import numpy as np

from glhybrid.geometry import Geometry, draw_state
from glhybrid.layout import CONSTANTS

SPHERE_VERTICES = 36  # of the cube that stands for a sphere


def batches(
    geometry: Geometry, mirrored: np.ndarray
) -> tuple[list[tuple[tuple[bool, bool, bool], list[tuple[int, ...]]]], list[tuple[int, int]]]:
    """Indirect commands by raster state, and the (instance, first triangle) pairs that they index.

    mirrored: (I,) bool, instances turned inside out. A state is (cut out, culled, mirrored and culled).
    Blended surfaces are not drawn: the composite pass meets them along the pixel's ray, in order.
    """
    states = [draw_state(m) for m in geometry.materials]
    group_state = [states[material] for _, material, _, _ in geometry.hit_groups.tolist()]
    pairs: list[tuple[int, int]] = []
    commands: dict[tuple[bool, bool, bool], list[tuple[int, ...]]] = {}
    # Instances that share mesh, records and handedness are drawn by one command a run of equal states.
    keys = list(zip(geometry.instance_mesh.tolist(), geometry.first_record.tolist(), mirrored.tolist(), strict=True))
    for key, members in groupby(sorted(range(len(keys)), key=keys.__getitem__), key=keys.__getitem__):
        mesh_row, first_record, flipped = key
        instances = list(members)
        mesh = geometry.meshes[mesh_row]
        runs: list[list[int]] = []  # state index, first triangle, count
        run_states: list[tuple[int, int]] = []
        for number, (first, count) in enumerate(mesh.geometries):
            state = group_state[geometry.records[first_record + number, 0]]
            if count == 0 or state[0] == CONSTANTS["ANY_HIT_TINT"]:
                continue
            if runs and run_states[-1] == state and runs[-1][0] + runs[-1][1] == first:
                runs[-1][1] += count
            else:
                runs.append([first, count])
                run_states.append(state)
        for (first, count), state in zip(runs, run_states, strict=True):
            base = len(pairs)
            pairs += [(i, first) for i in instances]
            masked, single = state[0] == CONSTANTS["ANY_HIT_MASK"], bool(state[1])
            # count, instances, first index, base vertex, base instance
            commands.setdefault((masked, single, flipped and single), []).append(
                (3 * count, len(instances), 3 * first, 0, base)
            )
    return sorted(commands.items()), pairs


def sphere_rows(geometry: Geometry) -> list[tuple[np.ndarray, tuple[int, int]]]:
    """(centre and radius, (instance, triangle row)) of every drawn sphere."""
    groups = geometry.hit_groups
    rows = []
    for i, mesh_row in enumerate(geometry.instance_mesh.tolist()):
        for triangle, number, sphere in geometry.meshes[mesh_row].spheres:
            group = groups[geometry.records[geometry.first_record[i] + number, 0]]
            if group[2] != CONSTANTS["ANY_HIT_TINT"]:
                rows.append((sphere, (i, triangle)))
    return rows
