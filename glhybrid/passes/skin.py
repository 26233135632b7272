"""Moved vertices, once a frame: morph targets and joints in compute, into the buffers that raster and rays read."""

from itertools import accumulate
from typing import Any

import numpy as np

from glhybrid import layout
from glhybrid.context import Context
from glhybrid.deform import influences, stays_flat
from glhybrid.gpu_scene import GpuScene
from glhybrid.motion import Motion, Shape
from glhybrid.needs import Features
from glhybrid.owned import Owned
from glhybrid.scene import F32, F64, Triangles
from glhybrid.shaders import Shaders

PARTS = ("position", "normal", "tangent")  # bit k of SkinPiece.delta_parts


class Skin:
    """Owns the files' vertices, influences and targets. `meshes`: for each deformer its row of geometry.meshes."""

    name = "skin"

    def __init__(self, context: Context, shaders: Shaders, scene: GpuScene, motion: Motion, features: Features) -> None:
        gl, self._write = context.gl, context.write
        self._program = shaders.compute("skin", features)
        self.meshes = [scene.mesh_of_instance(d.instances[0]) for d in motion.deformers]
        tables = _Tables(scene, motion, features, self.meshes)
        self._pieces, self._deformer = tables.pieces, tables.deformer
        self._joint_first, self._total = tables.joint_first, int(tables.vertices)
        buffers = {
            "RestVertices": gl.buffer(tables.rest), "Influences": gl.buffer(tables.influences),
            "Deltas": gl.buffer(tables.deltas), "SkinPieces": gl.buffer(reserve=tables.pieces.nbytes),
            "Morphs": gl.buffer(reserve=max(tables.targets, 1) * layout.dtype("Morph").itemsize),
            "Joints": gl.buffer(reserve=tables.joint_count * layout.dtype("Joint").itemsize),
        }  # fmt: skip
        self._resources: dict[str, Any] = buffers | {
            "VerticesOut": scene.resources["vertices"].buffer, "vertex_total": self._total,
        }  # fmt: skip
        self._owned = Owned(buffers.values())
        if features.tangents:
            self._resources["TangentsOut"] = scene.resources["tangents"].buffer

    def run(self, shapes: tuple[Shape, ...]) -> None:
        """Writes every deformer's vertices as its shape has them."""
        joints = np.zeros(sum(len(s.joints) for s in shapes), layout.dtype("Joint"))
        joints["anchored_from_bind"] = layout.columns(np.concatenate([s.joints for s in shapes])[:, :3])
        active = [np.flatnonzero(s.weights) for s in shapes]
        starts = [0, *accumulate(len(a) for a in active)]
        morphs = np.zeros(max(starts[-1], 1), layout.dtype("Morph"))
        for shape, rows, start in zip(shapes, active, starts[:-1], strict=True):
            morphs["target"][start : start + len(rows)] = rows
            morphs["weight"][start : start + len(rows)] = shape.weights[rows]
        for piece, deformer in zip(self._pieces, self._deformer, strict=True):
            piece["morph_first"], piece["morph_count"] = starts[deformer], len(active[deformer])
        self._write(self._resources["Joints"], joints)
        self._write(self._resources["Morphs"], morphs)
        self._write(self._resources["SkinPieces"], self._pieces)
        self._program.dispatch(self._resources, (min(self._total, 65536), -(-self._total // 65536)), (64, 1))

    @property
    def bytes(self) -> int:
        """Of its buffers."""
        return self._owned.buffer_bytes

    def release(self) -> None:
        self._owned.release()


class _Tables:
    """The arrays that do not change, concatenated over the pieces of all deformers."""

    def __init__(self, scene: GpuScene, motion: Motion, features: Features, meshes: list[int]) -> None:
        counts = [len(motion.scene.skins[d.skin].joints) + 1 if d.skin >= 0 else 1 for d in motion.deformers]
        self.joint_first = [0, *accumulate(counts)]
        self.joint_count, self.vertices, self.targets = self.joint_first[-1], 0, 0
        self.deformer: list[int] = []
        pieces: list[tuple[int, ...]] = []
        rest: list[np.ndarray] = []
        follow: list[np.ndarray] = []
        deltas: list[F32] = []
        influence_rows = delta_rows = 0
        for number, (deformer, row) in enumerate(zip(motion.deformers, meshes, strict=True)):
            if row < 0:
                continue
            mesh = motion.scene.meshes[deformer.mesh]
            first = scene.geometry.meshes[row].first_vertex
            self.targets += max((len(p.morph_targets) for p in mesh.primitives if isinstance(p, Triangles)), default=0)
            for primitive in mesh.primitives:
                if not isinstance(primitive, Triangles):
                    first += 1
                    continue
                count = len(primitive.position)
                table = np.zeros((0, 0), layout.dtype("Influence"))
                if deformer.skin >= 0 and primitive.joints is not None:
                    joints, weights = influences(primitive, counts[number] - 1)
                    table = np.zeros(joints.shape, layout.dtype("Influence"))
                    table["joint"], table["weight"] = joints, weights
                bits, moves = _deltas(primitive, features.tangents)
                pieces.append((
                    first, self.vertices, count, influence_rows, table.shape[1], self.joint_first[number],
                    delta_rows, bits, 0, 0, stays_flat(primitive), primitive.tangent is not None,
                ))  # fmt: skip
                rest.append(_rest(primitive, len(pieces) - 1))
                follow.append(table.ravel())
                deltas.append(moves)
                self.deformer.append(number)
                influence_rows, delta_rows = influence_rows + table.size, delta_rows + len(moves)
                self.vertices, first = self.vertices + count, first + count
        self.pieces = np.zeros(len(pieces), layout.dtype("SkinPiece"))
        for column, name in enumerate(self.pieces.dtype.names or ()):
            self.pieces[name] = [p[column] for p in pieces]
        self.rest = np.concatenate([r.view(np.uint8) for r in rest])  # as bytes: else NumPy drops the padding
        self.influences = np.concatenate([*follow, np.zeros(1, layout.dtype("Influence"))])
        self.deltas = np.concatenate([*deltas, np.zeros((1, 3), np.float32)])


def _rest(piece: Triangles, number: int) -> np.ndarray:
    rows = np.zeros(len(piece.position), layout.dtype("RestVertex"))
    rows["position"], rows["normal"], rows["piece"] = piece.position, piece.normal, number
    if piece.tangent is not None:
        rows["tangent"] = piece.tangent
    return rows


def _deltas(piece: Triangles, tangents: bool) -> tuple[int, F32]:
    """SkinPiece.delta_parts, and rows (targets * vertices * parts, 3) float32 in that order."""
    names = [n for n in PARTS if any(getattr(t, n) is not None for t in piece.morph_targets)]
    if not tangents or piece.tangent is None:
        names = [n for n in names if n != "tangent"]
    rows = np.zeros((len(piece.morph_targets), len(piece.position), len(names), 3), np.float32)
    for target, into in zip(piece.morph_targets, rows, strict=True):
        for place, name in enumerate(names):
            delta: F64 | F32 | None = getattr(target, name)
            if delta is not None:
                into[:, place] = delta
    return sum(1 << PARTS.index(n) for n in names), rows.reshape(-1, 3)
