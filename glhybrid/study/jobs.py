"""What processes beside a study make (beside.py): programs that its cells will want, curves, failure cases."""

import pickle
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from glhybrid.bench.frames import steady_frame
from glhybrid.renderer import Renderer
from glhybrid.scene import Camera, Scene
from glhybrid.settings import Settings
from glhybrid.study import curves, direct, measure, reflected, stability
from glhybrid.study import paper as papers
from glhybrid.study.beside import Home
from glhybrid.study.progress import Meter
from glhybrid.timing import Timing

SMALL = (64, 36)  # pixels: programs do not depend on how many
FEW = 16  # points of a light, and a pair of frames, are enough for all programs


@dataclass(frozen=True)
class Programs:
    """All that a cell of a study draws, and so compiles and bakes. scene: pickled, in a file. size: the study's.

    settings: None for what is made once a scene. moving: at its defaults, so that it is panned and filmed; mirrors:
    whether it is asked what they show.
    """

    scene: Path
    camera: Camera
    size: tuple[int, int]
    settings: Settings | None
    moving: bool = False
    mirrors: bool = False

    def make(self, renderer: Renderer, home: Home) -> None:
        """Draws it all, small; as a picture of the true size would be."""
        known, half = _scene(self.scene), (self.size[0] // 2, self.size[1] // 2)
        renderer.planned_size = self.size
        args = renderer, known, self.camera, SMALL
        if self.settings is None:
            if known.lights and known.instances:
                direct.find(*args, FEW)
            measure.specular_share(*args)
            return
        measure.draw(*args, self.settings)
        frame, off = (
            steady_frame(renderer, known, SMALL, self.settings, self.camera),
            Timing(renderer.context.gl.finish),
        )
        off.enabled = False
        for _ in range(2):
            frame(off)
        if self.moving:
            renderer.planned_size = half
            depth = stability.typical_depth(renderer, known, self.camera)
            stability.pan(renderer, known, stability.orthographic(self.camera, depth), SMALL, self.settings, 1)
        if self.mirrors:
            renderer.planned_size = self.size
            mirrors = reflected.find(*args)
            if mirrors is not None:
                mirrors.ask(renderer, self.settings)


@dataclass(frozen=True)
class Curve:
    """A stability curve, by name, kept where the study looks for it."""

    name: str

    def make(self, renderer: Renderer, home: Home) -> None:
        """Nothing where it is there."""
        renderer.planned_size = None
        meter = Meter(None, lines=False)
        curves.make(renderer, self.name, home.output / "stability", home.quick, meter, lambda _: None)


@dataclass(frozen=True)
class Failure:
    """A case of the failure library, likewise."""

    name: str

    def make(self, renderer: Renderer, home: Home) -> None:
        """Nothing where it is there."""
        from glhybrid.study import run

        renderer.planned_size = None
        run.failures(renderer, home.output / "failures", Meter(None, lines=False), lambda _: None, [self.name])


@dataclass(frozen=True)
class Ladder:
    """The truth of one roughness of the paper's figure 8, and the programs of its ways."""

    roughness: float

    def make(self, renderer: Renderer, home: Home) -> None:
        """Only the truth takes long."""
        renderer.planned_size = None
        size = papers.ladder_size(home.quick)
        scene, camera, _, _ = papers.ladder_truth(renderer, self.roughness, home.quick)
        for way in papers.ways():
            settings = way.settings(Settings())
            renderer.render(scene, camera, size, settings)
            steady_frame(renderer, scene, size, settings, camera)(Timing(renderer.context.gl.finish, enabled=False))


@lru_cache(maxsize=1)
def _scene(path: Path) -> Scene:
    with path.open("rb") as file:
        scene: Scene = pickle.load(file)
    return scene
