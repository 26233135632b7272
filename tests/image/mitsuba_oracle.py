"""Mitsuba 3 as an oracle, in a process of its own: `python mitsuba_oracle.py`, one request a line on standard input.

A request names two .npz files, in and out. The first holds `request` (JSON, see `render` and `bsdf`) and the arrays it
names; the second gets the answer. Nothing here imports glhybrid: only numbers pass. Its own process because a libLLVM
under 17 aborts, and because Mitsuba and Mesa would bring two libLLVMs into one.

The glTF 2.0 BSDF is written here from appendix B of the specification: Mitsuba's `principled` and `roughplastic` are
other functions.
"""

# mypy: ignore-errors
# (types are those of a variant chosen at run time)

import json
import os
import sys
import traceback
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np

VARIANT = os.environ.get("GLHYBRID_MITSUBA_VARIANT", "llvm_ad_rgb")
mi.set_variant(VARIANT)

MIRROR_ROUGHNESS = 0.02  # under it an exact mirror, as the renderer's contract says
ALPHA_MIN = 4e-4


class GltfBsdf(mi.BSDF):
    """glTF 2.0 appendix B: metallic mixes GGX under Schlick with Lambert below a dielectric. z is the normal."""

    def __init__(self, props):
        mi.BSDF.__init__(self, props)
        self.base = mi.Color3f(props.get("base_color"))
        self.metallic = mi.Float(props.get("metallic", 0.0))
        roughness = props.get("roughness", 1.0)
        self.mirror = roughness < MIRROR_ROUGHNESS
        self.alpha = max(roughness * roughness, ALPHA_MIN)
        self.f0 = mi.Color3f(props.get("f0", mi.Color3f(0.04)))
        self.f90 = mi.Float(props.get("f90", 1.0))
        # Shares of the samples: any numbers are right, these keep the noise low.
        self.specular_share = 1.0 if props.get("metallic", 0.0) >= 1 else 0.5
        glossy = mi.BSDFFlags.DeltaReflection if self.mirror else mi.BSDFFlags.GlossyReflection
        self.m_components = [glossy | mi.BSDFFlags.FrontSide, mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide]
        self.m_flags = self.m_components[0] | self.m_components[1]

    def fresnel(self, cos):
        w = dr.power(dr.maximum(1 - cos, 0), 5)
        dielectric = self.f0 + (self.f90 - self.f0) * w
        return dielectric, self.base + (1 - self.base) * w

    def distribution(self):
        return mi.MicrofacetDistribution(mi.MicrofacetType.GGX, self.alpha, True)

    def eval_pdf(self, ctx, si, wo, active=True):
        cos_i, cos_o = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(wo)
        active = active & (cos_i > 0) & (cos_o > 0)
        h = dr.normalize(si.wi + wo)
        d = self.distribution()
        dielectric, conductor = self.fresnel(dr.dot(si.wi, h))
        value = (1 - self.metallic) * (1 - dr.max(dielectric)) * self.base * dr.inv_pi * cos_o
        pdf = (1 - self.specular_share) * cos_o * dr.inv_pi
        if not self.mirror:
            lobe = d.eval(h) * d.G(si.wi, wo, h) / (4 * cos_i)
            value += dr.lerp(dielectric, conductor, self.metallic) * lobe
            pdf += self.specular_share * d.pdf(si.wi, h) / (4 * dr.dot(wo, h))
        return value & active, pdf & active

    def eval(self, ctx, si, wo, active=True):
        return self.eval_pdf(ctx, si, wo, active)[0]

    def pdf(self, ctx, si, wo, active=True):
        return self.eval_pdf(ctx, si, wo, active)[1]

    def sample(self, ctx, si, sample1, sample2, active=True):
        cos_i = mi.Frame3f.cos_theta(si.wi)
        active = active & (cos_i > 0)
        bs = dr.zeros(mi.BSDFSample3f)
        specular = sample1 < self.specular_share
        mirrored = (
            mi.reflect(si.wi) if self.mirror else mi.reflect(si.wi, self.distribution().sample(si.wi, sample2)[0])
        )
        bs.wo = dr.select(specular, mirrored, mi.warp.square_to_cosine_hemisphere(sample2))
        bs.eta = 1.0
        bs.sampled_component = dr.select(specular, mi.UInt32(0), mi.UInt32(1))
        bs.sampled_type = dr.select(specular, mi.UInt32(self.m_components[0]), mi.UInt32(self.m_components[1]))
        value, bs.pdf = self.eval_pdf(ctx, si, bs.wo, active)
        weight = dr.select(bs.pdf > 0, value / bs.pdf, 0)
        if self.mirror:
            dielectric, conductor = self.fresnel(cos_i)
            mirror = dr.lerp(dielectric, conductor, self.metallic) / self.specular_share
            bs.pdf = dr.select(specular, self.specular_share, bs.pdf)
            weight = dr.select(specular, mirror, weight)
        return bs, weight & (active & (bs.pdf > 0))

    def traverse(self, callback):
        pass

    def to_string(self):
        return "GltfBsdf[]"


def bsdf_of(spec):
    """A BSDF from {"type": "gltf" or a Mitsuba plugin, ...}; lists of three numbers are colours. Two-sided."""
    gltf = spec["type"] == "gltf"
    inner = {}
    for key, value in spec.items():
        if isinstance(value, list):
            value = mi.ScalarColor3f(value) if gltf else {"type": "rgb", "value": value}
        inner[key] = value
    return mi.load_dict({"type": "twosided", "nested": inner})


def mesh_of(name, position, normal, bsdf, emitter):
    """position, normal: (T, 3, 3); normal None = flat."""
    props = mi.Properties()
    props["mesh_bsdf"] = bsdf
    if emitter is not None:
        props["mesh_emitter"] = mi.load_dict({"type": "area", "radiance": {"type": "rgb", "value": emitter}})
    count = len(position)
    mesh = mi.Mesh(name, 3 * count, count, props=props, has_vertex_normals=normal is not None)
    params = mi.traverse(mesh)
    params["vertex_positions"] = np.ascontiguousarray(position, np.float32).ravel()
    params["faces"] = np.arange(3 * count, dtype=np.uint32)
    if normal is not None:
        params["vertex_normals"] = np.ascontiguousarray(normal, np.float32).ravel()
    params.update()
    return mesh


def scene_of(spec, arrays):
    objects = {"type": "scene", "embree_use_robust_intersections": True}
    for i, shape in enumerate(spec["shapes"]):
        bsdf = bsdf_of(shape["bsdf"])
        if "sphere" in shape:
            x, y, z, radius = shape["sphere"]
            entry = {"type": "sphere", "center": [x, y, z], "radius": radius, "bsdf": bsdf}
            if shape.get("emitter"):
                entry["emitter"] = {"type": "area", "radiance": {"type": "rgb", "value": shape["emitter"]}}
            objects[f"shape{i}"] = entry
        else:
            objects[f"shape{i}"] = mesh_of(
                f"shape{i}", arrays[shape["position"]], arrays[shape["normal"]] if shape.get("normal") else None,
                bsdf, shape.get("emitter"),
            )  # fmt: skip
    for i, light in enumerate(spec.get("lights", [])):
        entry = {"type": light["type"]}
        for key, value in light.items():
            if key in ("irradiance", "intensity"):
                entry[key] = {"type": "rgb", "value": value}
            elif key != "type":
                entry[key] = value
        objects[f"light{i}"] = entry
    sky = spec.get("sky")
    if isinstance(sky, list):
        objects["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": sky}}
    elif sky:
        objects["sky"] = {"type": "envmap", "bitmap": mi.Bitmap(np.ascontiguousarray(arrays[sky], np.float32))}
    return mi.load_dict(objects)


def render(spec, arrays):
    """Radiance along rays: mean and variance of the mean over `spp` independent paths, each (N, 3).

    spec: shapes, lights, sky, max_depth, spp, seed; arrays: origin, direction (N, 3) and what spec names.
    """
    scene = scene_of(spec, arrays)
    integrator = mi.load_dict(
        {"type": "path", "max_depth": spec["max_depth"], "rr_depth": 1000, "hide_emitters": False}
    )
    origin, direction = (np.asarray(arrays[k], np.float32) for k in ("origin", "direction"))
    count, spp = len(origin), spec["spp"]
    total, square, done = np.zeros((count, 3)), np.zeros((count, 3)), 0
    at_once = max(1, min(spp, (1 << 21) // count))
    while done < spp:
        now = min(at_once, spp - done)
        sampler = mi.load_dict({"type": "independent", "sample_count": now})
        sampler.seed(spec["seed"] * 100003 + done, count * now)
        index = dr.arange(mi.UInt32, count * now) // now
        o = dr.gather(mi.Point3f, mi.Point3f(origin.T), index)
        d = dr.gather(mi.Vector3f, mi.Vector3f(direction.T), index)
        color = integrator.sample(scene, sampler, mi.RayDifferential3f(o, d))[0]
        values = np.array(color, np.float64).T.reshape(count, now, 3)
        total += values.sum(1)
        square += (values**2).sum(1)
        done += now
    mean = total / spp
    variance = np.maximum(square / spp - mean**2, 0) / max(spp - 1, 1)
    return {"mean": mean, "variance": variance}


def evaluate(spec, arrays):
    """BSDF times cosine and density for pairs of directions (N, 3) in the shading frame, z = normal."""
    bsdf = bsdf_of(spec["bsdf"])
    si = dr.zeros(mi.SurfaceInteraction3f, len(arrays["wi"]))
    si.wi = mi.Vector3f(np.asarray(arrays["wi"], np.float32).T)
    si.sh_frame = mi.Frame3f(mi.Normal3f(0, 0, 1))
    value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, mi.Vector3f(np.asarray(arrays["wo"], np.float32).T))
    return {"value": np.array(value).T, "pdf": np.array(pdf)}


def chi2(spec, arrays):
    """Mitsuba's own chi-square test of the BSDF's sample() against its pdf(): p-value and whether it passes."""
    from mitsuba.chi2 import ChiSquareTest, SphericalDomain

    bsdf = bsdf_of(spec["bsdf"])
    wi = mi.ScalarVector3f(spec["wi"])

    def interaction(n):
        si = dr.zeros(mi.SurfaceInteraction3f, n)
        si.wi = mi.Vector3f(wi)
        si.sh_frame = mi.Frame3f(mi.Normal3f(0, 0, 1))
        return si

    def sample(s):
        n = dr.width(s)
        bs, weight = bsdf.sample(mi.BSDFContext(), interaction(n), s.z, mi.Point2f(s.x, s.y))
        return bs.wo, dr.select(dr.any(weight != 0), 1.0, 0.0)

    def pdf(wo):
        return bsdf.pdf(mi.BSDFContext(), interaction(dr.width(wo)), wo)

    test = ChiSquareTest(SphericalDomain(), sample, pdf, sample_dim=3, sample_count=300000, res=51, ires=8)
    ok = test.run(0.01)
    return {"ok": np.array(ok), "p_value": np.array(test.p_value)}


def main() -> None:
    mi.register_bsdf("gltf", GltfBsdf)
    assert dr.sum(dr.arange(mi.Float, 4))[0] == 6 if VARIANT.startswith("llvm") else True
    print(json.dumps({"ready": VARIANT, "version": mi.__version__}), flush=True)
    for line in sys.stdin:
        into, out = json.loads(line)
        try:
            with np.load(into) as file:
                arrays = dict(file)
            spec = json.loads(str(arrays.pop("request")))
            answer = {"render": render, "evaluate": evaluate, "chi2": chi2}[spec["job"]](spec, arrays)
            np.savez(out, **answer)
            print(json.dumps({"done": out}), flush=True)
        except Exception:
            print(json.dumps({"error": traceback.format_exc()}), flush=True)
        Path(into).unlink(missing_ok=True)


if __name__ == "__main__":
    main()
