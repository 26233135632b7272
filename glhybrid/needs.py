"""What a scene needs: the features that its shaders are specialised by, decided from the scene and the settings.

Each field of Features is a define, always set, 0 or 1 (or a number): USE_<NAME> for the preprocessor and a constant
<NAME> for code. A program is compiled with those that its text names, so equal programs are shared.
"""

from dataclasses import dataclass, fields, replace

from glhybrid import emitters, techniques
from glhybrid.environment_cdf import has_lamps
from glhybrid.layout import CONSTANTS
from glhybrid.scene import TEXTURE_SLOTS, Material, Scene, Sphere, Triangles
from glhybrid.settings import Settings

MIRROR_ROUGHNESS = 0.02  # as in lib/brdf.glsl
REUSED_RAYS = 4  # a pixel, at most: more are as good by themselves, and would be an image each


@dataclass(frozen=True)
class Features:
    """What shaders are specialised by. Hashable; two that are equal share every program."""

    two_level: bool = False  # instances are traced through a top-level tree
    spheres: bool = False  # analytic spheres
    alpha_test: bool = False  # a material cuts holes
    blended: bool = False  # a material blends or transmits
    single_sided: bool = False  # a material has no back
    textures: bool = False
    normal_map: bool = False
    tangents: bool = False
    extra_attributes: bool = False  # a second UV set or vertex colours
    clearcoat: bool = False
    specular: bool = False  # KHR_materials_ior or KHR_materials_specular
    environment: bool = False
    environment_map: bool = False  # not constant
    sky_samples: bool = False  # rays are sent to where it is bright
    blurred_sky: bool = False  # and its convolutions are read
    specular_sky: bool = False  # the environment is seen in the specular lobe
    shadow_rays: bool = False  # hits and layers send their own
    shadow_bits: bool = False  # and their answers are yes or no, for at most 32 lights
    one_light: bool = False  # and no more: shadow rays need no loop
    light_discs: bool = False  # a light has a size, and rays go to all of its disc
    visibility: bool = False  # a shadow pass runs
    shadow_maps: bool = False  # and looks up depth maps, as do hits and layers
    map_filter: int = 0  # how (layout FILTER_*)
    lightmap: bool = False  # or baked light maps
    occlusion: bool = False  # a pass for the open share of the sky runs
    reflections: bool = False  # a pass for what the mirror direction shows runs
    mirror_rays: bool = False  # and traces, as do blended layers
    probes: bool = False  # captured surroundings stand before the sky
    probes_blurred: bool = False  # and not only exact mirrors show them
    mirror_shadows: bool = False  # and what it meets sends its shadow rays in the same program
    mirror_hits: bool = False  # and the composite shades it
    march: bool = False  # and looks into the G-buffer first
    reflect_grid: int = 0  # which pixels send mirror rays before what is between them (layout GRID_*)
    pixel_list: bool = False  # or those on a list
    glossy: bool = False  # or gathers rays over specular lobes
    glossy_coat: bool = False  # of the clearcoat, in passes/glossy.comp
    denoise: bool = False  # and their noise is filtered
    reuse: bool = False  # by rays that neighbours share
    denoise_shadows: bool = False  # as that of penumbras is
    denoise_occlusion: bool = False  # and that of rays to the sky
    denoise_signal: int = 0  # which, in passes/denoise_*.comp
    denoise_last: bool = False  # the last step of a filter
    encodes: bool = False  # the composite encodes for the screen, under a given exposure
    emitters: bool = False  # something shines, and rays are sent to it
    terminator: bool = False
    reason: bool = False  # why reflections give up, for the AOV
    reason_shadows: bool = False
    reason_ao: bool = False
    exact_distance: bool = False  # lengths of reflection rays in double precision, for the AOV
    sphere_proxy: bool = False
    clip_control: bool = True
    moving: bool = False  # the motion AOV is asked for and things move
    deforming: bool = False  # and some of them change shape
    step_counter: bool = False
    buffer_array: bool = False  # Mesa's software renderer: see lib/buffers.glsl
    branchless: bool = False  # lanes of a CPU: see lib/bvh.glsl
    moeller_trumbore: bool = False  # tests only: the control that must leak
    bvh_stack: int = 0  # entries, from the depth of the trees
    bvh_inner_steps: int = 4  # inner nodes in a row, before a leaf
    texture_slots: int = 0  # bit k: some material has a texture in slot k (layout SLOT_*)
    aov: int = 0  # of which kind, in passes/aov.comp (layout AOVS_*)

    def defines(self) -> dict[str, int]:
        """Names as GLSL knows them, with values."""
        values = {f.name.upper(): int(getattr(self, f.name)) for f in fields(self)}
        return {
            name if name.startswith(("BVH_", "TEXTURE_SLOTS", "MAP_")) else f"USE_{name}": value
            for name, value in values.items()
        }

    replace = replace

    @property
    def reuse_coat(self) -> bool:
        """Whether rays of the clearcoat are shared: its normals must be those that filters know, the base's."""
        return self.reuse and self.clearcoat and not self.normal_map

    @property
    def filtered(self) -> bool:
        """Whether some image is noisy, and its noise is filtered."""
        return self.denoise or self.denoise_shadows or self.denoise_occlusion


@dataclass(frozen=True)
class Needs:
    """Features of a scene under some settings, and what it does not need, with the reason."""

    features: Features
    skipped: tuple[str, ...]


def used_materials(scene: Scene) -> list[int]:
    """Indices of the materials that something drawn has, ascending."""
    used: set[int] = set()
    for instance in scene.instances:
        mesh = scene.meshes[instance.mesh]
        used.update(instance.materials or tuple(p.material for p in mesh.primitives))
    return sorted(used)


def reflective(material: Material, cutoff: float) -> bool:
    """Whether some point of this material sends a mirror ray: smoother than the cutoff (1 = Kim's), base or coat."""
    coated = material.clearcoat > 0 and (
        material.clearcoat_roughness < cutoff or "clearcoat_roughness" in material.textures
    )
    return not material.unlit and (material.roughness < cutoff or "metallic_roughness" in material.textures or coated)


def exact_mirror(material: Material) -> bool:
    """Whether it is a mirror everywhere, base and coat: textures only make it smoother."""
    return material.roughness < MIRROR_ROUGHNESS and (
        material.clearcoat == 0 or material.clearcoat_roughness < MIRROR_ROUGHNESS
    )


def _map_filter(settings: Settings) -> int:
    name = settings.shadows
    if name == "pcf":
        name = settings.parameter("shadows.pcf.kernel")
    filters = {"map": "TAP", "csm": "BOX", "box": "BOX", "disc": "DISC", "pcss": "PCSS"}
    return CONSTANTS[f"FILTER_{filters[name]}"]


def find(scene: Scene, settings: Settings) -> Needs:
    """Looks at what is drawn and lit. Anything no scene object uses is left out and said in `skipped`."""
    materials = [scene.materials[i] for i in used_materials(scene)]
    meshes = [scene.meshes[i] for i in sorted({i.mesh for i in scene.instances})]
    pieces = [p for m in meshes for p in m.primitives if isinstance(p, Triangles)]
    textures = any(m.textures for m in materials)
    normal_map = any(m.textures.keys() & {"normal", "clearcoat_normal"} for m in materials)
    uv1 = any(t.uv_set == 1 for m in materials for t in m.textures.values())
    environment = (
        scene.environment is not None and scene.environment.intensity > 0 and bool(scene.environment.radiance.any())
    )
    lit = bool(scene.lights) and not all(m.unlit for m in materials)
    reference = settings.reflections == "reference"
    cutoff = techniques.cutoff(settings)
    mirrors = any(reflective(m, cutoff) for m in materials)
    reflecting = techniques.REFLECTIONS[settings.reflections]
    reflections = reflecting.mirror_pass not in ("", "probe") and mirrors
    glossy = reflections and reflecting.mirror_pass == "glossy"
    rough = any(reflective(m, cutoff) and not exact_mirror(m) for m in materials)
    sky_rays = glossy and rough and settings.parameter("reflections.ray-glossy.sky_rays")
    lamp_rays = glossy and rough and settings.parameter("reflections.ray-glossy.lamp_rays")
    shining = any(max(m.emissive) > 0 for m in materials)
    technique = techniques.SHADOWS[settings.shadows]
    visibility = lit and settings.shadows != "none" and not reference
    shadow_maps = visibility and technique.depth_maps
    lightmap = visibility and technique.light_maps
    denoise = glossy and rough and settings.parameter("reflections.ray-glossy.denoise")
    light_discs = (
        lit and (reference or settings.shadows == "ray-soft") and any(light.has_size for light in scene.lights)
    )
    occlusion = settings.ao != "none" and environment and not (reference or all(m.unlit for m in materials))
    blended = any(m.alpha_mode == "BLEND" or m.transmission > 0 for m in materials)
    features = Features(
        spheres=any(isinstance(p, Sphere) for m in meshes for p in m.primitives),
        alpha_test=any(m.alpha_mode == "MASK" for m in materials),
        blended=blended,
        single_sided=any(not m.double_sided for m in materials),
        textures=textures,
        texture_slots=sum(1 << k for k, slot in enumerate(TEXTURE_SLOTS) if any(slot in m.textures for m in materials)),
        normal_map=normal_map,
        tangents=normal_map,
        extra_attributes=uv1 or any(p.color is not None for p in pieces),
        clearcoat=any(m.clearcoat > 0 for m in materials),
        specular=any(m.ior != 1.5 or m.specular != 1 or m.specular_color != (1.0, 1.0, 1.0) for m in materials),
        environment=environment,
        environment_map=environment and scene.environment is not None and not scene.environment.constant,
        sky_samples=environment and scene.environment is not None and not scene.environment.constant
        and (reference or (sky_rays and has_lamps(scene.environment))),
        blurred_sky=environment and not reference,
        specular_sky=environment and settings.reflections not in ("none", "reference"),
        shadow_rays=lit and settings.shadows != "none",
        shadow_bits=lit and settings.shadows != "none" and not (shadow_maps or lightmap or light_discs or blended)
        and len(scene.lights) <= 32,
        one_light=lit and len(scene.lights) == 1,
        light_discs=light_discs,
        visibility=visibility,
        shadow_maps=shadow_maps,
        map_filter=_map_filter(settings) if shadow_maps else 0,
        occlusion=occlusion,
        reflections=reflections,
        mirror_rays=reflections and reflecting.traced,
        march=reflections and reflecting.mirror_pass == "ssr",
        reflect_grid=techniques.reflect_grid(settings) if reflections else 0,
        glossy=glossy,
        probes=mirrors and reflecting.mirror_pass == "probe",
        probes_blurred=reflecting.mirror_pass == "probe"
        and any(reflective(m, cutoff) and not exact_mirror(m) for m in materials),
        denoise=denoise,
        reuse=denoise and settings.parameter("reflections.ray-glossy.samples") <= REUSED_RAYS,
        denoise_shadows=visibility and light_discs and settings.parameter("shadows.ray-soft.denoise"),
        denoise_occlusion=occlusion and settings.ao == "ray" and settings.parameter("ao.ray.denoise"),
        emitters=(reference and shining) or (lamp_rays and emitters.has_lamps(scene, materials)),
        lightmap=lightmap,
        terminator=visibility and settings.terminator and not (shadow_maps or lightmap),
    )  # fmt: skip
    skipped = []
    if not reference:
        if not visibility:
            reason = "the scene has no light" if not lit else f"shadows = {settings.shadows}"
            skipped.append(f"shadow pass and its images: {reason}")
        if not reflections:
            reason = (
                f"no material is smoother than roughness {cutoff:g}"
                if not mirrors
                else f"reflections = {settings.reflections}"
            )
            skipped.append(f"reflect pass and its image: {reason}")
    for name, present, reason in (
        ("alpha tests in raster and rays", features.alpha_test, "no material cuts out"),
        ("blended layers", features.blended, "no material blends or transmits"),
        ("textures", features.textures, "no material has one"),
        ("tangents", features.tangents, "no material has a normal map"),
        ("second UV set and vertex colours", features.extra_attributes, "no primitive has them"),
        ("spheres", features.spheres, "every shape is made of triangles"),
        ("clearcoat lobe", features.clearcoat, "no material is coated"),
        ("environment", features.environment, "the scene has none"),
        *[
            (
                "ambient occlusion",
                occlusion,
                f"ao = {settings.ao}" if settings.ao == "none" else "no sky lights the scene",
            )
        ]
        * (not reference),
        *[("rays to lamps of the sky", features.sky_samples, "it has none")] * bool(sky_rays),
        *[
            (
                "rays to meshes that shine",
                features.emitters,
                "none is much brighter than the sky, or things move or blend" if shining else "none does",
            )
        ]
        * bool(lamp_rays),
        *[("penumbras", light_discs, "no light has a size")] * (settings.shadows == "ray-soft" and visibility),
    ):
        if not present:
            skipped.append(f"{name}: {reason}")
    return Needs(features, tuple(skipped))
