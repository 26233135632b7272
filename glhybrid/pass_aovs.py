"""AOVs that passes make as they go: read from their images, or a constant where no pass runs that makes them."""

from typing import TYPE_CHECKING, Any

import numpy as np

from glhybrid import outputs
from glhybrid.image import AOVS
from glhybrid.readback import Reading

if TYPE_CHECKING:
    from glhybrid.staged import Staged

# The image, its first channel and how many, and the value where no pass runs.
NAMES = {
    "visibility": ("", 0, 0, 1), "occlusion": ("occlusion", 0, 1, 1), "reflection": ("reflection", 0, 3, 0),
    "reflection_hit": ("reflection", 3, 1, 0), "reason": ("reason", 0, 1, 0),
    "reason_shadows": ("reason_shadows", 0, 1, 0), "reason_ao": ("reason_ao", 0, 1, 0),
}  # fmt: skip


def reading(name: str, staged: "Staged", ids: Any) -> Reading[np.ndarray]:
    """One of NAMES, (H, W, ...), row 0 at the top, once the passes have run. ids: the pixels' surfaces."""
    image, first, count, nothing = NAMES[name]
    targets, passes, probe, features = staged.targets, staged.passes, staged.probe, staged.features
    shadow, occlusion = passes.shadow, passes.occlusion
    makers: dict[str, Any] = {
        "occlusion": occlusion, "reason_ao": occlusion if features.reason_ao else None,
        "visibility": shadow, "reason_shadows": shadow if features.reason_shadows else None,
    }  # fmt: skip
    if makers.get(name, probe or passes.reflect) is None:
        width, height = targets.size
        shape = AOVS[name].shape(height, width, len(staged.upload.lights))
        return outputs.constant(np.full(shape, nothing, AOVS[name].dtype))
    if name == "visibility" and shadow is not None:
        return outputs.layers(targets.get(shadow.channel))
    if probe is not None and name not in makers:
        probe.run(targets, ids)
    if name == "occlusion" and occlusion is not None:
        image = occlusion.channel
    return outputs.texels(targets.get(image), first, count)
