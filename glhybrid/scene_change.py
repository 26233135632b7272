"""How two scenes differ: in numbers that a frame reads, or in what is staged for them."""

import dataclasses

from glhybrid.scene import Scene


def only_numbers_differ(a: Scene, b: Scene) -> bool:
    """Whether two scenes are the same but for numbers of lights, and the turn and intensity of the environment."""
    for field in dataclasses.fields(Scene):
        if field.name not in ("lights", "environment") and getattr(a, field.name) is not getattr(b, field.name):
            return False
    if len(a.lights) != len(b.lights) or (a.environment is None) != (b.environment is None):
        return False
    if a.environment is not None and b.environment is not None:
        if a.environment.radiance is not b.environment.radiance:
            return False
        if (a.environment.intensity > 0) != (b.environment.intensity > 0):
            return False
    return all(
        p is q
        or (p.kind, p.node, p.radius > 0, p.angular_diameter > 0)
        == (q.kind, q.node, q.radius > 0, q.angular_diameter > 0)
        for p, q in zip(a.lights, b.lights, strict=True)
    )
