"""Skins and animations of a glTF asset. Node indices are those of the file, which Scene.nodes keeps."""

import numpy as np

from glhybrid.load.gltf_accessors import AccessorReader
from glhybrid.load.gltf_document import Document, Item
from glhybrid.scene import Animation, Channel, Node, Skin

INTERPOLATIONS = {name: name for name in ("STEP", "LINEAR", "CUBICSPLINE")}
WIDTHS = {"translation": 3, "rotation": 4, "scale": 3, "weights": 0}  # numbers a key; 0 = as many as morph targets


def read_skins(doc: Document, accessors: AccessorReader) -> tuple[Skin, ...]:
    """Scene.skins of a file, in its order. Raises LoadError."""
    return tuple(_skin(item, accessors) for item in doc.items("skins"))


def _skin(item: Item, accessors: AccessorReader) -> Skin:
    joints = item.indices("joints", "nodes")
    if not joints:
        raise item.fail("has no joints")
    matrices = accessors.attribute(item, "inverseBindMatrices", "MAT4")
    if matrices is None:
        return Skin(joints, np.tile(np.eye(4), (len(joints), 1, 1)), item.name)
    if len(matrices) < len(joints):
        raise item.fail(f"has {len(matrices)} inverse bind matrices for {len(joints)} joints")
    inverse_bind = matrices[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1).astype(np.float64)
    if not np.isfinite(inverse_bind).all():
        raise item.fail("an inverse bind matrix is not finite")
    if not np.allclose(inverse_bind[:, 3], (0, 0, 0, 1), rtol=0, atol=1e-4):
        item.warn("an inverse bind matrix has a last row other than 0 0 0 1 (affine), which is ignored")
    inverse_bind[:, 3] = (0, 0, 0, 1)
    return Skin(joints, np.ascontiguousarray(inverse_bind), item.name)


def read_animations(
    doc: Document, accessors: AccessorReader, nodes: tuple[Node, ...], target_counts: dict[int, int]
) -> tuple[Animation, ...]:
    """target_counts: for each node with a mesh, the number of its morph targets."""
    animations = []
    for item in doc.items("animations"):
        samplers = item.children("samplers", "sampler")
        channels = []
        for channel in item.children("channels", "channel"):
            number = channel.integer("sampler")
            if number >= len(samplers):
                raise channel.fail(f"sampler {number} does not exist: the animation has {len(samplers)}")
            read = _channel(channel, samplers[number], accessors, nodes, target_counts)
            channels += [read] if read else []
        animations.append(Animation(item.name, tuple(channels)))
    return tuple(animations)


def _channel(
    item: Item, sampler: Item, accessors: AccessorReader, nodes: tuple[Node, ...], target_counts: dict[int, int]
) -> Channel | None:
    target = item.child("target")
    if target is None:
        raise item.fail('"target" is missing')
    path, node = target.string("path"), target.index("node", "nodes")
    if node is None or path not in WIDTHS:
        item.warn(f"not played: it moves {path if path not in WIDTHS else 'no node'}")
        return None
    if path != "weights" and nodes[node].matrix is not None:
        item.warn("not played: its node has a matrix")
        return None
    if path == "weights" and not target_counts.get(node):
        item.warn("not played: its node has no morph targets")
        return None
    interpolation = sampler.choice("interpolation", "LINEAR", INTERPOLATIONS)
    times = accessors.attribute(sampler, "input", "SCALAR")
    kinds = {3: "VEC3", 4: "VEC4", 0: "SCALAR"}
    values = accessors.attribute(sampler, "output", kinds[WIDTHS[path]])
    if times is None or values is None:
        raise sampler.fail('"input" or "output" is missing')
    times = times[:, 0]
    if not len(times) or not np.isfinite(times).all() or np.any(np.diff(times) < 0.0):
        raise sampler.fail("its times must be finite and must not go back")
    if not np.isfinite(values).all():
        raise sampler.fail("its values must be finite")
    width = WIDTHS[path] or target_counts[node]
    per_key = 3 if interpolation == "CUBICSPLINE" else 1
    if values.size != len(times) * per_key * width:
        raise sampler.fail(
            f"has {values.size} numbers for {len(times)} {interpolation} keys of {path}, "
            f"must have {len(times) * per_key * width}"
        )
    shape = (len(times), 3, width) if per_key == 3 else (len(times), width)
    return Channel(node, path, interpolation, np.ascontiguousarray(times), values.reshape(shape))
