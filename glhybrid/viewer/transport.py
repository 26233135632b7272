"""Playing a scene's clips: which, when, how fast. No clock of its own."""

from dataclasses import dataclass

from glhybrid import pose
from glhybrid.scene import Scene

FRAME_S = 1 / 24


@dataclass
class Transport:
    """clip: index into Scene.animations, -1 = the scene at rest. time: seconds into the clip."""

    clip: int = -1
    time: float = 0.0
    playing: bool = False
    speed: float = 1.0
    loop: bool = True
    end: float = 0.0

    @staticmethod
    def of(scene: Scene) -> "Transport":
        """At the start of a scene's first clip; without one it stands still."""
        transport = Transport()
        if scene.animations:
            transport.choose(scene, 0)
        return transport

    def choose(self, scene: Scene, clip: int) -> None:
        """Another clip, from its start."""
        self.clip, self.time = clip, 0.0
        self.end = float(pose.clip_span(scene.animations[clip])[1]) if clip >= 0 else 0.0
        self.playing = self.playing and self.end > 0

    def toggle(self) -> None:
        """Plays or pauses; from the end it begins anew."""
        if self.end > 0:
            self.playing = not self.playing
            if self.playing and not self.loop and self.time >= self.end:
                self.time = 0.0

    def seek(self, time: float) -> None:
        """To a time in seconds, held within the clip."""
        self.time = min(max(time, 0.0), self.end)

    def step(self, frames: int) -> None:
        """Pauses, and goes some frames on or back."""
        self.playing = False
        self.seek((round(self.time / FRAME_S) + frames) * FRAME_S)

    def advance(self, seconds: float) -> bool:
        """Whether the time has changed."""
        if not self.playing or self.end <= 0:
            return False
        time = self.time + seconds * self.speed
        if self.loop:
            time %= self.end
        elif not 0 <= time < self.end:
            self.playing = False
        self.seek(time)
        return True
