"""Brings an uploaded scene to a time: vertices skinned, trees refitted, instances, lights and the top-level tree moved.

Chosen: what moves rigidly touches matrices and the top-level tree alone, and every frame is made from the time alone,
so that playing and seeking give the same picture. Rejected: one level of trees for scenes in motion, which would have
to be built anew over everything.
"""

from glhybrid.context import Context
from glhybrid.gpu_scene import GpuScene, MovedTree
from glhybrid.motion import Motion
from glhybrid.needs import Features
from glhybrid.passes.refit import Refit
from glhybrid.passes.skin import Skin
from glhybrid.scene import F64, Scene
from glhybrid.shaders import Shaders
from glhybrid.timing import Timing


class Mover:
    """Owns what only motion needs. `ms`: milliseconds of the last move, by part."""

    def __init__(
        self, context: Context, shaders: Shaders, upload: GpuScene, motion: Motion, features: Features, rebuild: float
    ) -> None:
        self._context, self._shaders, self._features, self._rebuild = context, shaders, features, rebuild
        self._finish = context.gl.finish
        self._upload = upload
        self.motion = motion
        self.ms: dict[str, float] = {}
        self._world: F64 | None = None  # of the moment shown
        self._scene = motion.start
        self._before: float | None = None  # time of what is kept as the frame before
        self._now: float | None = None  # time of what is shown
        self.skin: Skin | None = None
        self.refit: Refit | None = None
        self._shown = [i for i, d in enumerate(motion.deformers) if upload.mesh_of_instance(d.instances[0]) >= 0]
        if self._shown:
            self.skin = Skin(context, shaders, upload, motion, features)
        self.follow_trees()

    def follow_trees(self) -> None:
        """To be called when the scene got trees: from then on they move too."""
        if self.skin is not None and self.refit is None and self._upload.trees is not None:
            meshes = [self.skin.meshes[i] for i in self._shown]
            self.refit = Refit(self._context, self._shaders, self._upload, meshes, self._features, self._rebuild)
            self._now = None  # the trees are not there yet

    def follow(self, before: float | None, time: float, timed: bool = True) -> Scene:
        """As show(), for one of several that show this: its own frame before is of that time, None if it has none.

        Without one nothing has moved yet: this moment is the frame before, too.
        """
        if (self._before, self._now) == (time if before is None else before, time):
            return self._scene
        if before is not None and self._now != before:
            self.show(before, False)
        scene = self.show(time, timed)
        if before is None:
            self._keep()
        return scene

    def show(self, time: float, timed: bool = True) -> Scene:
        """Everything where the clip has it at a time in seconds; what was there becomes the frame before.

        timed: wait for each part, and note in `ms` how long it took.
        Returns the scene with the lights and cameras of that time.
        """
        timing = Timing(self._finish, enabled=timed)
        timing.frame()
        self._keep()
        moment = timing.run("pose", lambda: self.motion.at(time, self._world))
        self._world = moment.world_from_object
        trees: dict[int, MovedTree] = {}
        skin, refit = self.skin, self.refit
        if skin is not None:
            timing.run("skin", lambda: skin.run(moment.shapes))
        if refit is not None:
            trees = timing.run("refit", lambda: refit.run([moment.shapes[i] for i in self._shown]))
        timing.run("tlas", lambda: self._upload.move(moment, trees))
        if timed:
            self.ms = timing.take()
        if moment.lights is not self._scene.lights or moment.cameras is not self._scene.cameras:
            self._scene = self._scene.replace(lights=moment.lights, cameras=moment.cameras)
        self._now = time
        return self._scene

    def _keep(self) -> None:
        """What is shown becomes the frame before."""
        self._upload.keep_places()
        if self.skin is not None:
            self._upload.copy_vertices()
        self._before = self._now

    @property
    def bytes(self) -> int:
        """On the GPU, beside the scene's own."""
        return sum(part.bytes for part in (self.skin, self.refit) if part is not None)

    def release(self) -> None:
        for part in (self.skin, self.refit):
            if part is not None:
                part.release()
