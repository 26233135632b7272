"""Scene: what a file holds, as plain data. No OpenGL, nothing derived, nothing decided.

Conventions (glTF's): right-handed, +Y up, metres, counter-clockwise front faces, radians, linear Rec. 709 colours,
column-vector matrices stored row-major and named destination_from_source. Arrays are C-contiguous and never written
to after load; objects compare by identity.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from glhybrid.errors import SettingError

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
U16 = NDArray[np.uint16]
U32 = NDArray[np.uint32]

Wrap = Literal["repeat", "clamp", "mirror"]
AlphaMode = Literal["OPAQUE", "MASK", "BLEND"]
LightKind = Literal["directional", "point", "spot"]


@dataclass(frozen=True, eq=False)
class Image:
    """Texels as the file has them: (H, W, 4) uint8, row 0 at the top. Their slot says whether they are sRGB."""

    texels: U8
    name: str = ""


@dataclass(frozen=True, eq=False)
class Texture:
    """An image with its sampler, the UV set it reads and KHR_texture_transform.

    uv_transform: (2, 3) float64, uv' = M @ (u, v, 1); uv origin is the top left texel corner, v down (glTF).
    """

    image: Image
    uv_set: int = 0
    uv_transform: F64 | None = None
    wrap_u: Wrap = "repeat"
    wrap_v: Wrap = "repeat"
    nearest: bool = False  # magnification without interpolation
    mipmap: bool = True


@dataclass(frozen=True, eq=False)
class Material:
    """glTF 2.0 metallic-roughness, appendix B, and the KHR extensions we draw. Factors multiply textures.

    Colours are linear Rec. 709, base_color's fourth number is opacity. metallic, roughness (perceptual, its square is
    GGX's alpha), specular, occlusion_strength, clearcoat, clearcoat_roughness and transmission (thin: nothing bends) go
    from 0 to 1; ior is at least 1, or 0 for a dielectric that reflects all. A roughness under 0.02 is an exact mirror.
    alpha_mode MASK cuts out where opacity is under alpha_cutoff. unlit: base_color is what is seen. Renderer.render
    refuses what is out of range.

    Textures by slot: base_color, emissive, specular_color (sRGB); metallic_roughness, normal, occlusion, specular,
    clearcoat, clearcoat_roughness, clearcoat_normal, transmission (linear).
    """

    name: str = ""
    base_color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    metallic: float = 0.0
    roughness: float = 1.0
    emissive: tuple[float, float, float] = (0.0, 0.0, 0.0)  # radiance: factor x KHR_materials_emissive_strength
    alpha_mode: AlphaMode = "OPAQUE"
    alpha_cutoff: float = 0.5
    double_sided: bool = False
    unlit: bool = False
    normal_scale: float = 1.0
    occlusion_strength: float = 1.0
    ior: float = 1.5
    specular: float = 1.0
    specular_color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    clearcoat: float = 0.0
    clearcoat_roughness: float = 0.0
    clearcoat_normal_scale: float = 1.0
    transmission: float = 0.0
    textures: dict[str, Texture] = field(default_factory=dict)


TEXTURE_SLOTS = (
    "base_color", "metallic_roughness", "normal", "occlusion", "emissive", "specular", "specular_color",
    "clearcoat", "clearcoat_roughness", "clearcoat_normal", "transmission",
)  # fmt: skip
SRGB_SLOTS = frozenset({"base_color", "emissive", "specular_color"})


@dataclass(frozen=True, eq=False)
class MorphTarget:
    """Displacements of one target; absent attributes do not move."""

    position: F32 | None = None  # (V, 3)
    normal: F32 | None = None  # (V, 3)
    tangent: F32 | None = None  # (V, 3)


@dataclass(frozen=True, eq=False)
class Triangles:
    """One drawable piece of a mesh: indexed triangles with one material. Object space, metres.

    position (V, 3), index (T, 3), normal (V, 3) unit, tangent (V, 4) with handedness in w, uv0/uv1 (V, 2) with v
    down, color (V, 4) linear: float32, but for the index, uint32. normal is never None after load: missing ones are
    made there, as is tangent if a normal map needs it. material: index into Scene.materials. joints (uint16, into
    Skin.joints) and weights (float32) are (V, 4) or (V, 8) for skinned meshes.
    """

    position: F32
    index: U32
    normal: F32
    material: int = 0
    tangent: F32 | None = None
    uv0: F32 | None = None
    uv1: F32 | None = None
    color: F32 | None = None
    joints: U16 | None = None
    weights: F32 | None = None
    morph_targets: tuple[MorphTarget, ...] = ()


@dataclass(frozen=True, eq=False)
class Sphere:
    """An analytic sphere of the given radius about the object-space origin."""

    radius: float
    material: int = 0


@dataclass(frozen=True, eq=False)
class Mesh:
    """Pieces that move together, in object space. One mesh under many nodes stays one mesh.

    morph_weights: of the primitives' targets, at rest.
    """

    name: str
    primitives: tuple[Triangles | Sphere, ...]
    morph_weights: tuple[float, ...] = ()

    @cached_property
    def bounds(self) -> F64:
        """(2, 3) float64, object space: over vertices that some triangle uses and that are finite; NaN if none is."""
        corners = []
        for p in self.primitives:
            if isinstance(p, Sphere):
                corners.append(np.array([[-p.radius] * 3, [p.radius] * 3]))
            else:
                used = np.zeros(len(p.position), bool)
                used[p.index.ravel()] = True
                used &= np.isfinite(p.position).all(1)
                if used.any():
                    points = p.position[used].astype(np.float64)
                    corners.append(np.stack([points.min(0), points.max(0)]))
        if not corners:
            return np.full((2, 3), np.nan)
        boxes = np.stack(corners)
        return np.stack([boxes[:, 0].min(0), boxes[:, 1].max(0)])


@dataclass(frozen=True, eq=False)
class Instance:
    """A mesh placed in the world.

    mesh: index into Scene.meshes. world_from_object: (4, 4) float64, affine, its last row 0 0 0 1, metres; a mirrored
    one turns the winding over. materials: one material index per primitive, instead of the mesh's own.
    node and skin: indices into Scene.nodes / Scene.skins, -1 if not animated by one.
    """

    mesh: int
    world_from_object: F64
    name: str = ""
    materials: tuple[int, ...] | None = None
    node: int = -1
    skin: int = -1


@dataclass(frozen=True, eq=False)
class Light:
    """KHR_lights_punctual, with an optional size for soft shadows.

    intensity: lux for directional, candela for point and spot; color multiplies it. direction: unit, the way the light
    travels (directional, spot). range 0 = unlimited. Cones are half angles in radians. angular_diameter (radians,
    directional) and radius (metres) 0 = hard shadow.
    """

    kind: LightKind
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    intensity: float = 1.0
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)  # world, metres
    direction: tuple[float, float, float] = (0.0, -1.0, 0.0)  # world, unit
    range: float = 0.0
    inner_cone: float = 0.0
    outer_cone: float = np.pi / 4
    angular_diameter: float = 0.0
    radius: float = 0.0
    name: str = ""
    node: int = -1

    @property
    def has_size(self) -> bool:
        """Whether its shadows have penumbras."""
        return (self.angular_diameter if self.kind == "directional" else self.radius) > 0


@dataclass(frozen=True, eq=False)
class Environment:
    """Light from far away. radiance: (H, W, 3) float32 equirect in linear Rec. 709, or (1, 1, 3) if constant.

    Equirect: the centre column looks along -Z, +X is to its right, row 0 is +Y. Texels times intensity are radiance.
    rotation: radians, right-handed about +Y.
    """

    radiance: F32
    intensity: float = 1.0
    rotation: float = 0.0
    name: str = ""

    @property
    def constant(self) -> bool:
        """Whether it is the same from everywhere, so that no map is needed."""
        return self.radiance.shape[:2] == (1, 1)


@dataclass(frozen=True)
class Probe:
    """Where a reflection probe is captured, and the box (low, high) of the room that stands for what it saw.

    World, metres. reach: the box (low, high) of the surfaces that show it; None: the room's. fade: m around that over
    which it gives way to the next; None: as the setting `reflections.probe.blend` has it.
    """

    position: tuple[float, float, float]
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    name: str = ""
    reach: tuple[tuple[float, float, float], tuple[float, float, float]] | None = None
    fade: float | None = None


@dataclass(frozen=True, eq=False)
class Camera:
    """A view. world_from_view: (4, 4) float64, rigid, looking down -Z. Perspective if fov_y > 0, else orthographic.

    fov_y: vertical, radians, whatever the image's shape; but with fov_short it spans the shorter side, so that what
    fits stays in view in tall images too (cameras made to frame something). xmag, ymag: half extents in metres
    (orthographic); xmag 0 = from the image's shape. near, far: metres, clip only what the camera sees first; far 0 =
    infinite. node: index into Scene.nodes of what moves it, -1 if nothing does.
    """

    name: str
    world_from_view: F64
    fov_y: float = np.pi / 4
    fov_short: bool = False
    near: float = 0.01
    far: float = 0.0
    xmag: float = 0.0
    ymag: float = 0.0
    node: int = -1

    @staticmethod
    def look_at(
        eye: tuple[float, float, float],
        target: tuple[float, float, float],
        up: tuple[float, float, float] = (0.0, 1.0, 0.0),
        fov_y: float = np.pi / 4,
        near: float = 0.01,
        name: str = "main",
    ) -> "Camera":
        """A perspective camera at eye that looks at target: world, metres; fov_y vertical, radians.

        An up along the view is replaced by the least aligned axis. Raises SettingError where they are one point.
        """
        back = np.asarray(eye, np.float64) - np.asarray(target, np.float64)
        length = float(np.linalg.norm(back))
        if not (length > 0 and np.isfinite(length)):
            raise SettingError(f'camera "{name}": eye = {eye}, target = {target}: must be two places, apart and finite')
        back /= length
        right = np.cross(np.asarray(up, np.float64), back)
        if np.linalg.norm(right) < 1e-9:
            right = np.cross(np.eye(3)[np.argmin(np.abs(back))], back)
        right /= np.linalg.norm(right)
        pose = np.eye(4)
        pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, np.cross(back, right), back, eye
        return Camera(name, pose, fov_y=fov_y, near=near)


@dataclass(frozen=True, eq=False)
class Node:
    """The hierarchy, kept for animation: local TRS, or a matrix that animation may not touch."""

    name: str
    parent: int  # -1 = root; a parent's index may be larger than its child's
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)  # x y z w
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    matrix: F64 | None = None
    morph_weights: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Skin:
    """What Triangles.joints index. inverse_bind: joint space from the mesh's, at rest."""

    joints: tuple[int, ...]  # node indices
    inverse_bind: F64  # (J, 4, 4)
    name: str = ""


@dataclass(frozen=True, eq=False)
class Channel:
    """times (K,) float32 seconds; values (K, ...) or (K, 3, ...) for CUBICSPLINE (in-tangent, value, out-tangent)."""

    node: int
    path: Literal["translation", "rotation", "scale", "weights"]
    interpolation: Literal["STEP", "LINEAR", "CUBICSPLINE"]
    times: F32
    values: F32


@dataclass(frozen=True, eq=False)
class Animation:
    """One clip of a file: all channels run on one clock, in seconds from 0, held at their ends."""

    name: str
    channels: tuple[Channel, ...]


@dataclass(frozen=True, eq=False)
class Expectation:
    """What one technique is expected to do on a scene of the failure library.

    settings: those that make the technique, `shadows` or `reflections` or `ao` first. control: instead of them, a
    method on the CPU that no technique uses (study/controls.py). low, high: the range of the measure, in its unit.
    """

    fails: bool
    low: float
    high: float
    settings: dict[str, object] = field(default_factory=dict)
    control: str = ""
    because: str = ""


@dataclass(frozen=True, eq=False)
class Study:
    """The [study] table of a scene file: a known failure, its measure, and who is expected to fail it or to hold.

    settings: of every technique here. options: of the measure. size: pixels, 0 = whatever the study draws.
    """

    title: str
    why: str = ""
    measure: str = ""
    size: tuple[int, int] = (0, 0)
    settings: dict[str, object] = field(default_factory=dict)
    options: dict[str, object] = field(default_factory=dict)
    expectations: tuple[Expectation, ...] = ()


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything a file holds; or make one: `Scene("name", meshes, instances, materials, lights=..., cameras=...)`.

    Things refer to each other by index into these tuples. replace(**changes) is a copy; where only lights or the
    environment's rotation differ, a Renderer keeps what it has on the GPU. path, sha256: of the file. warnings: what
    was dropped or changed on load, one sentence each, naming the thing.
    """

    name: str
    meshes: tuple[Mesh, ...] = ()
    instances: tuple[Instance, ...] = ()
    materials: tuple[Material, ...] = (Material(),)
    lights: tuple[Light, ...] = ()
    cameras: tuple[Camera, ...] = ()
    environment: Environment | None = None
    probes: tuple[Probe, ...] = ()  # none: they are placed where surfaces reflect
    nodes: tuple[Node, ...] = ()
    skins: tuple[Skin, ...] = ()
    animations: tuple[Animation, ...] = ()
    path: Path | None = None
    sha256: str = ""
    warnings: tuple[str, ...] = ()
    study: Study | None = None

    replace = replace

    def triangle_count(self) -> int:
        """Triangles drawn, instances counted each time."""
        per_mesh = [sum(len(p.index) for p in m.primitives if isinstance(p, Triangles)) for m in self.meshes]
        return sum(per_mesh[i.mesh] for i in self.instances)

    @cached_property
    def instance_bounds(self) -> F64:
        """(I, 2, 3) float64, world: the box of each instance; NaN for one that draws nothing."""
        if not self.instances:
            return np.zeros((0, 2, 3))
        boxes = np.stack([mesh.bounds for mesh in self.meshes])[[i.mesh for i in self.instances]]
        pose = np.array([i.world_from_object for i in self.instances])
        middle, half = boxes.mean(1), (boxes[:, 1] - boxes[:, 0]) / 2
        middle = np.einsum("iab,ib->ia", pose[:, :3, :3], middle) + pose[:, :3, 3]
        half = np.einsum("iab,ib->ia", np.abs(pose[:, :3, :3]), half)
        return np.stack([middle - half, middle + half], axis=1)

    def bounds(self) -> F64:
        """(2, 3) float64, world: smallest and largest corner over all instances; zeros if nothing is drawn."""
        boxes = self.instance_bounds[np.isfinite(self.instance_bounds).all((1, 2))]
        return np.stack([boxes[:, 0].min(0), boxes[:, 1].max(0)]) if len(boxes) else np.zeros((2, 3))
