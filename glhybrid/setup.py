"""What the passes of a frame are made from."""

from dataclasses import dataclass

from glhybrid.context import Context
from glhybrid.gpu_scene import GpuScene
from glhybrid.needs import Features
from glhybrid.plan import Plan
from glhybrid.settings import Settings
from glhybrid.shaders import Shaders


@dataclass(frozen=True, eq=False)
class Setup:
    """Handed on whole to passes that need more of it than programs, scene and features.

    features: those of the plan, with what only the uploaded scene and the AOVs asked for tell.
    """

    context: Context
    shaders: Shaders
    scene: GpuScene
    features: Features
    settings: Settings
    plan: Plan
