"""The BRDF as glTF 2.0 writes it, in float64 NumPy: the specification that the GLSL is held against.

Appendix B of the core specification with KHR_materials_ior, specular, transmission (thin) and clearcoat, written from
their texts: GGX with alpha = roughness^2 (B.3.1), separable Smith masking-shadowing (B.3.2), Schlick Fresnel (B.3.4),
dielectric and metal mixed by metallic (B.2). All directions are unit, (..., 3), pointing away from the surface.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

F64 = NDArray[np.float64]
ALPHA_MIN = 4e-4  # of the renderer's contract: smoother than roughness 0.02 is an exact mirror


@dataclass(frozen=True)
class Brdf:
    """Material parameters by their glTF names, textures already applied."""

    base_color: Any = (1.0, 1.0, 1.0)
    metallic: float = 0.0
    roughness: float = 1.0
    ior: float = 1.5
    specular: float = 1.0
    specular_color: Any = (1.0, 1.0, 1.0)
    transmission: float = 0.0
    clearcoat: float = 0.0
    clearcoat_roughness: float = 0.0

    replace = replace

    @property
    def alpha(self) -> float:
        return max(self.roughness**2, ALPHA_MIN)

    @property
    def f0(self) -> F64:
        """Of the dielectric at normal incidence (KHR_materials_specular)."""
        from_ior = ((self.ior - 1) / (self.ior + 1)) ** 2
        return np.minimum(from_ior * np.asarray(self.specular_color, np.float64), 1) * self.specular

    def fresnel(self, cos: ArrayLike) -> tuple[F64, F64]:
        """Schlick's reflectance of the dielectric and of the metal, (..., 3), for the angle to the half vector."""
        w = np.clip(1 - np.abs(np.asarray(cos, np.float64)), 0, 1)[..., None] ** 5
        base = np.asarray(self.base_color, np.float64)
        return self.f0 + (self.specular - self.f0) * w, base + (1 - base) * w

    def coat_fresnel(self, cos: ArrayLike) -> F64:
        """Share of the light that the clearcoat takes, by the angle of the viewer to its normal."""
        return self.clearcoat * (0.04 + 0.96 * (1 - np.abs(np.asarray(cos, np.float64))) ** 5)

    def times_cosine(self, n: ArrayLike, v: ArrayLike, l: ArrayLike, n_coat: ArrayLike | None = None) -> F64:  # noqa: E741
        """BRDF times N.L, (..., 3): what irradiance on a surface facing the light is multiplied by."""
        n, v, l = (np.asarray(x, np.float64) for x in (n, v, l))  # noqa: E741
        n_coat = n if n_coat is None else np.asarray(n_coat, np.float64)
        h = unit(v + l)
        dielectric_f, metal_f = self.fresnel(dot(v, h))
        specular = ggx(n, v, l, h, self.alpha)[..., None]
        below = (1 - dielectric_f.max(-1, keepdims=True)) * (1 - self.transmission)
        diffuse = np.asarray(self.base_color, np.float64) / np.pi
        dielectric = below * diffuse + dielectric_f * specular
        both = (dot(n, l) > 0) & (dot(n, v) > 0)
        core = (dielectric + (metal_f * specular - dielectric) * self.metallic) * (np.clip(dot(n, l), 0, None) * both)[
            ..., None
        ]
        if self.clearcoat == 0:
            return core
        coat = self.coat_fresnel(dot(n_coat, v))[..., None]
        coat_alpha = max(self.clearcoat_roughness**2, ALPHA_MIN)
        lobe = (ggx(n_coat, v, l, h, coat_alpha) * np.clip(dot(n_coat, l), 0, None))[..., None]
        return core + (lobe - core) * coat


def ggx(n: F64, v: F64, l: F64, h: F64, alpha: float) -> F64:  # noqa: E741
    """D G / (4 N.L N.V), 0 where light or viewer are behind the normal."""
    a2 = alpha**2
    nl, nv, nh = dot(n, l), dot(n, v), dot(n, h)
    d = a2 * (nh > 0) / (np.pi * (nh**2 * (a2 - 1) + 1) ** 2)

    def visible(x: F64) -> F64:  # G1 / (2 N.X)
        return 1 / (np.abs(x) + np.sqrt(a2 + (1 - a2) * x**2))

    return np.where((nl > 0) & (nv > 0), d * visible(nl) * visible(nv), 0)


def toward_viewer(n: ArrayLike, v: ArrayLike, n_geo: ArrayLike) -> F64:
    """Shading normals as the renderer takes them, (..., 3): those that face away from v are turned until N.V is 0.001 (to first
    order), or nine tenths of the facet's own N.V where that is less; all others are kept. All unit, n_geo facing v."""
    n, v = np.asarray(n, np.float64), np.asarray(v, np.float64)
    below = np.clip(0.9 * dot(np.asarray(n_geo, np.float64), v), 1e-6, 1e-3) - dot(n, v)
    return np.where(below[..., None] > 0, unit(n + below[..., None] * v), n)


@lru_cache
def gauss_legendre(order: int) -> tuple[F64, F64]:
    """Nodes and weights over -1 to 1: the eigenvalues behind them take longer than all that is done with them."""
    return np.polynomial.legendre.leggauss(order)


@lru_cache
def specular_albedo(mu: float, alpha: float, order: int = 200) -> tuple[float, float]:
    """Directional albedo of the GGX lobe under Schlick Fresnel, as F0 * scale + F90 * bias, by quadrature.

    Over half vectors: tan^2 = alpha^2 u / (1 - u) makes D cos sin dtheta dphi = du dphi / 2 pi, so the integrand is
    F G V.H / (N.V N.H), smooth; Gauss-Legendre in u, the trapezoid in phi.
    """
    x, w = gauss_legendre(order)
    u, w = (x + 1) / 2, w / 2
    # More nodes where the lobe grazes: u -> 1.
    u, w = 1 - (1 - u) ** 2, w * 2 * (1 - u)
    phi = (np.arange(order) + 0.5) / order * 2 * np.pi
    tan2 = alpha**2 * u / (1 - u)
    cos = 1 / np.sqrt(1 + tan2)
    sin = np.sqrt(1 - cos**2)
    h = np.stack(np.broadcast_arrays(sin[:, None] * np.cos(phi), sin[:, None] * np.sin(phi), cos[:, None]), -1)
    v = np.array([np.sqrt(1 - mu**2), 0, mu])
    vh = h @ v
    nl = 2 * vh * h[..., 2] - mu

    def g1(c: F64) -> F64:
        c = np.abs(c)
        return 2 * c / (c + np.sqrt(alpha**2 + (1 - alpha**2) * c**2))

    ok = (nl > 0) & (vh > 0)
    kernel = np.where(ok, g1(nl) * g1(np.asarray(mu)) * vh / (mu * h[..., 2]), 0).mean(1)
    f = np.where(ok, g1(nl) * g1(np.asarray(mu)) * vh / (mu * h[..., 2]) * (1 - np.clip(vh, 0, 1)) ** 5, 0).mean(1)
    return float((kernel - f) @ w), float(f @ w)


def albedo(brdf: Brdf, mu: float, order: int = 120) -> F64:
    """Directional albedo of the whole BRDF, (3,): radiance under a uniform sky of 1. No lobe smoother than alpha 1e-2."""
    scale, bias = specular_albedo(mu, brdf.alpha)
    base = np.asarray(brdf.base_color, np.float64)
    metal = base * scale + bias
    # The diffuse part depends on V.H: over all l, cosine-weighted.
    x, w = gauss_legendre(order)
    u, w = (x + 1) / 2, w / 2
    phi = (np.arange(order) + 0.5) / order * 2 * np.pi
    sin, cos = np.sqrt(u), np.sqrt(1 - u)
    l = np.stack(  # noqa: E741
        np.broadcast_arrays(sin[:, None] * np.cos(phi), sin[:, None] * np.sin(phi), cos[:, None]), -1
    )
    v = np.array([np.sqrt(1 - mu**2), 0, mu])
    f, _ = brdf.fresnel(unit(v + l) @ v)
    diffuse = ((1 - f.max(-1)).mean(1) @ w) * base * (1 - brdf.transmission)
    dielectric = diffuse + brdf.f0 * scale + brdf.specular * bias
    core = dielectric + (metal - dielectric) * brdf.metallic
    if brdf.clearcoat == 0:
        return core
    coat_scale, coat_bias = specular_albedo(mu, max(brdf.clearcoat_roughness**2, ALPHA_MIN))
    return core + (coat_scale + coat_bias - core) * brdf.coat_fresnel(mu)


def dot(a: ArrayLike, b: ArrayLike) -> F64:
    return np.asarray((np.asarray(a) * np.asarray(b)).sum(-1), np.float64)


def unit(a: ArrayLike) -> F64:
    a = np.asarray(a, np.float64)
    return a / np.maximum(np.linalg.norm(a, axis=-1, keepdims=True), 1e-300)
