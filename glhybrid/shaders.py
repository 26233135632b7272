"""Compiles shaders for the features that they depend on, keeps the programs, and binds resources by name.

A program is keyed by its path and by the features that what counts of its text names (shader_live.py); others are not
part of the key, so equal programs are shared. Binding numbers are counted here and nowhere else.
"""

import os
import struct
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import moderngl

from glhybrid.compile_aside import CompileAside
from glhybrid.context import TEXTURES, Context
from glhybrid.errors import GeometryError, ShaderError
from glhybrid.gl import GL_COMPUTE_SHADER, GL_FRAGMENT_SHADER, GL_VERTEX_SHADER, BufferTexture
from glhybrid.load.builtin import data_folder
from glhybrid.needs import Features
from glhybrid.pace import Bands, Pace, spread_rows
from glhybrid.shader_source import Source
from glhybrid.timing import Progress

Resource = moderngl.Texture | moderngl.TextureArray | moderngl.Buffer | BufferTexture | int | float | tuple[float, ...]

BUFFERS = (  # as in lib/buffers.glsl
    "attributes", "tangents", "textures", "texture_levels", "lights", "materials", "instances", "nodes", "slots",
    "triangles", "vertices",
)  # fmt: skip
# Their texture units, the same in all programs, so that they need not be bound anew for each of them.
BUFFER_UNITS = {name: TEXTURES + k for k, name in enumerate(BUFFERS)}
_OPTIONAL = {  # those that not every scene has
    "attributes": "USE_EXTRA_ATTRIBUTES", "tangents": "USE_TANGENTS", "textures": "USE_TEXTURES",
    "texture_levels": "USE_TEXTURES",
}  # fmt: skip
_IMAGE_TYPES = range(0x904C, 0x906D)  # GL_IMAGE_1D .. GL_UNSIGNED_INT_IMAGE_2D_MULTISAMPLE_ARRAY
_SAMPLER_TYPES = {0x8B5E, 0x8DC1, 0x8DD2, 0x8DD7, 0x8DD0, 0x8DD8, 0x8DC2, 0x8B60, 0x8DCA}


class Program:
    """A linked program whose resources are given by their GLSL names. unread: of BUFFERS, what its text leaves out.

    pace: whether, and with what in between, it is drawn in bands.
    """

    def __init__(
        self, context: Context, name: str, program: Any, unread: Collection[str] = (), pace: Pace | None = None
    ) -> None:
        self.name = name
        self.program = program
        self._context = context
        self._pace, self._bands = pace or Pace(), Bands()
        self._rows: Any = None  # of tiles; stays 0, 0 unless drawn in bands
        self._bindings = context.bindings
        self._buffers: list[tuple[str, int]] = []  # and their units
        self._blocks: list[tuple[str, int]] = []
        self._samplers: list[tuple[str, int]] = []
        self._images: list[tuple[str, int]] = []
        self._uniforms: list[tuple[str, Any]] = []
        self._given: dict[str, Any] = {}  # values of uniforms
        bindings = context.bindings
        blocks: set[int] = set()  # binding points taken
        units: set[int] = set()
        images: set[int] = set()
        for member in program:
            handle = program[member]
            if isinstance(handle, moderngl.StorageBlock):
                handle.binding = bindings.blocks.place(member, blocks)
                self._blocks.append((member, handle.binding))
            elif isinstance(handle, moderngl.Uniform):
                kind = handle.gl_type  # type: ignore[attr-defined]  # missing in moderngl's stub
                if member == "buffers":
                    for k, buffer in enumerate(BUFFERS[: handle.array_length]):
                        unit = BUFFER_UNITS[buffer]
                        context.raw.glProgramUniform1i(program.glo, handle.location + k, unit)
                        if buffer not in unread:
                            self._buffers.append((buffer, unit))
                elif member in BUFFER_UNITS:
                    context.raw.set_sampler(program, member, BUFFER_UNITS[member])
                    self._buffers.append((member, BUFFER_UNITS[member]))
                elif kind in _SAMPLER_TYPES:
                    self._samplers.append((member, bindings.textures.place(member, units)))
                    context.raw.set_sampler(program, *self._samplers[-1])
                elif kind in _IMAGE_TYPES:
                    self._images.append((member, bindings.images.place(member, images)))
                    context.raw.set_sampler(program, *self._images[-1])
                elif member == "tile_rows":
                    self._rows = handle
                else:
                    self._uniforms.append((member, handle))

    @property
    def resources(self) -> frozenset[str]:
        """Names of everything the linked program reads or writes."""
        kinds: tuple[list[tuple[str, Any]], ...] = (
            self._buffers, self._blocks, self._samplers, self._images, self._uniforms,
        )  # fmt: skip
        return frozenset(name for kind in kinds for name, _ in kind)

    def bind(self, resources: Mapping[str, Any]) -> None:
        """Binds what the program reads; whatever it does not read is left alone. Nothing may be missing.

        `.mglo` is what moderngl's own methods call, after a Python call each: thirty of those in a frame are felt.
        """
        bindings = self._bindings
        if not bindings.kept:
            bindings.forget()
        buffers, given = self._context.raw.buffer_textures, self._given
        blocks, textures, images = bindings.blocks.bound, bindings.textures.bound, bindings.images.bound
        try:
            for name, unit in self._buffers:
                texture = resources[name]
                if buffers.get(unit) != texture.glo:
                    texture.bind(unit)
            for name, unit in self._blocks:
                buffer = resources[name]
                if blocks[unit] is not buffer:
                    self._check_block(name, buffer)
                    buffer.mglo.bind_to_storage_buffer(unit, 0, -1)
                    blocks[unit] = buffer
            for name, unit in self._samplers:
                texture = resources[name]
                if textures[unit] is not texture:
                    texture.bind(unit) if isinstance(texture, BufferTexture) else texture.mglo.use(unit)
                    textures[unit] = texture
            for name, unit in self._images:
                image = resources[name]
                if images[unit] is not image:
                    image.mglo.bind(unit, True, True, 0, 0)  # read and written, level 0, its own format
                    images[unit] = image
            for name, uniform in self._uniforms:
                value = resources[name]
                if given.get(name) is not value:
                    uniform.value = given[name] = value
        except KeyError:
            if missing := self.resources - resources.keys():
                raise ShaderError(f"{self.name}: nothing given for {sorted(missing)}") from None
            raise

    def _check_block(self, name: str, buffer: Any) -> None:
        """What is behind the limit would read as zeros, and nothing would say so."""
        limit = self._context.limits.storage_block_bytes
        if buffer.size > limit:
            raise GeometryError(
                f"{self.name}: {name} holds {buffer.size} bytes, this device's storage blocks {limit}: "
                "use a device with a larger limit (glhybrid doctor lists them) or a smaller scene or picture"
            )

    def dispatch(
        self, resources: Mapping[str, Any], size: tuple[int, int], group: tuple[int, int] = (8, 8), wait: bool = True
    ) -> None:
        """Runs once for every element of (width, height), then makes what it wrote visible to all that follows.

        wait: unless the next dispatch neither reads nor writes anything that this one writes, and does wait.
        """
        across, down = -(-size[0] // group[0]), -(-size[1] // group[1])
        if self._rows is None or not self._pace.on:
            self.bind(resources)
            self.program.mglo.run(across, down, 1)
            if wait:
                self._context.gl.memory_barrier()
        else:
            for band in self._in_bands(resources, across, down):
                band()
                self._pace.give_turn()

    def _in_bands(self, resources: Mapping[str, Any], across: int, down: int) -> Iterator[Callable[[], None]]:
        """Each binds anew: in a turn, others draw."""
        for first, every, rows in spread_rows(down, lambda: self._bands.rows(across)):
            yield partial(self._band, resources, first, every, across, rows)

    def _band(self, resources: Mapping[str, Any], first: int, every: int, across: int, rows: int) -> None:
        start = time.perf_counter()
        self._bindings.forget()
        self.bind(resources)
        self._rows.value = first, every - 1
        try:
            self.program.mglo.run(across, rows, 1)
        finally:
            self._rows.value = 0, 0
        self._context.gl.memory_barrier()
        self._context.raw.glFinish()  # unlike moderngl's, it lets other threads go on
        self._bands.note(rows * across, (time.perf_counter() - start) * 1e3, self._pace.band_ms)

    def dispatch_indirect(
        self, resources: Mapping[str, Any], groups: moderngl.Buffer, offset: int = 0, wait: bool = True
    ) -> None:
        """The same, over as many work groups as three uints in a buffer say, so many bytes from its start."""
        if self._rows is not None and self._pace.on:
            across, down, _ = struct.unpack("3I", groups.read(12, offset=offset))
            for band in self._in_bands(resources, across, down):
                band()
                self._pace.give_turn()
            return
        self.bind(resources)
        self.program.run_indirect(groups, offset)
        if wait:
            self._context.gl.memory_barrier()


class Shaders:
    """All programs of one context. extra: folders searched after glsl/, for shaders outside the package."""

    def __init__(self, context: Context, extra: tuple[Path, ...] = ()) -> None:
        self._context = context
        self.pace = Pace()
        self.progress: Progress | None = None  # told of what is compiled
        self._aside: CompileAside | None = None  # only where somebody is told
        self._folders = (data_folder("glsl"), *extra)
        self._sources: dict[str, Source] = {}
        self._programs: dict[tuple[str, ...], Program] = {}
        self._made: dict[tuple[str, ...], tuple[tuple[str, ...], Features]] = {}  # from which files
        self._retired: list[Program] = []
        self._stamps: dict[Path, tuple[int, int]] = {}
        self._unread: set[Path] = set()  # changed, and not in use yet because something did not compile

    def _source(self, path: str, features: Features) -> tuple[Source, str, dict[str, int]]:
        if path not in self._sources:
            self._sources[path] = Source(self._folders, path)
            for name in self._sources[path].files:
                self._stamps.setdefault(self._file(name), _stamp(self._file(name)))
        source = self._sources[path]
        text, named = source.specialise(features)
        if folder := os.environ.get("GLHYBRID_DUMP_SHADERS"):
            name = f"{path} {_label(named)}".replace("/", "_").strip()[:200]
            Path(folder, name).write_text(text, encoding="utf-8")
        return source, text, named

    def compute(self, stem: str, features: Features, folder: str = "passes") -> Program:
        """glsl/passes/STEM.comp for these features, compiled at first use."""
        source, text, named = self._source(f"{folder}/{stem}.comp", features)
        key = (stem, folder, _label(named))
        self._made[key] = (source.path,), features
        if key not in self._programs:
            name = f"{stem} {_label(named)}".strip()
            stages = {GL_COMPUTE_SHADER: text}
            make = lambda: self._context.gl.compute_shader(text)  # noqa: E731
            self._programs[key] = self._link(name, (source,), stages, make, named)
        return self._programs[key]

    def text(self, stem: str) -> bytes:
        """Source of glsl/passes/STEM.comp with its includes: what a result kept on disk depends on."""
        return self._source(f"passes/{stem}.comp", Features())[0].text.encode()

    def raster(self, stem: str, features: Features) -> Program:
        """glsl/passes/STEM.vert and STEM.frag, one varying integer output, for these features."""
        vertex, vertex_text, vertex_named = self._source(f"passes/{stem}.vert", features)
        fragment, fragment_text, fragment_named = self._source(f"passes/{stem}.frag", features)
        named = vertex_named | fragment_named
        key = (stem, "raster", _label(named))
        self._made[key] = (vertex.path, fragment.path), features
        if key not in self._programs:
            name = f"{stem} {_label(named)}".strip()
            make = lambda: self._context.gl.program(vertex_shader=vertex_text, fragment_shader=fragment_text)  # noqa: E731
            stages = {GL_VERTEX_SHADER: vertex_text, GL_FRAGMENT_SHADER: fragment_text}
            self._programs[key] = self._link(name, (vertex, fragment), stages, make, named)
        return self._programs[key]

    def _link(
        self, name: str, sources: tuple[Source, ...], stages: Mapping[int, str], make: Callable[[], Any],
        named: Mapping[str, int],
    ) -> Program:  # fmt: skip
        with self._context.programs.making(stages) if self._context.programs else nullcontext(False) as kept:
            aside_s = 0.0
            if self.progress is not None and not kept:
                tell = partial(self.progress, f"compiling {name.partition(' ')[0]}", 0, 0)
                tell()
                self._aside = self._aside or CompileAside(self._context.raw)
                aside_s = self._aside.run(stages, tell) if self._aside.worth else 0.0
                self._context.bindings.forget()  # who is told may draw
            start = time.perf_counter()
            unread = [buffer for buffer, feature in _OPTIONAL.items() if not named.get(feature)]
            try:
                made = make()
                if aside_s and self._aside is not None:
                    self._aside.learn(aside_s, time.perf_counter() - start)
                return Program(self._context, name, made, unread, self.pace)
            except moderngl.Error as error:
                log = str(error)
                for source in sources[-1:] if "fragment" in log else sources[:1]:
                    log = source.readable(log)
                raise ShaderError(f"{name}: does not compile on {self._context.device}:\n{log}") from None

    def _file(self, name: str) -> Path:
        return next((f / name for f in self._folders if (f / name).is_file()), self._folders[0] / name)

    def changed(self) -> list[Path]:
        """Files of programs in use that were written since they were read."""
        return [path for path, stamp in self._stamps.items() if _stamp(path) != stamp]

    def recompile(self) -> dict[tuple[str, ...], Program]:
        """Programs anew, by key, of files that have changed; none of them is in use yet.

        Raises ShaderError, with nothing changed but that the same files count as read, if one does not compile.
        """
        if not (changed := set(self.changed())):
            return {}
        written = self._unread = self._unread | changed
        self._stamps = {path: _stamp(path) for path in self._stamps}
        stale = {p for p, s in self._sources.items() if written & {self._file(name) for name in s.files}}
        old, self._sources = self._sources, {p: s for p, s in self._sources.items() if p not in stale}
        in_use, self._programs = self._programs, {}
        try:
            for key in [k for k in in_use if stale & set(self._made[k][0])]:
                features = self._made[key][1]
                self.raster(key[0], features) if key[1] == "raster" else self.compute(key[0], features, key[1])
            self._unread = set()
            return self._programs
        except ShaderError:
            for program in self._programs.values():
                program.program.release()
            self._sources = old | {p: s for p, s in self._sources.items() if p not in stale}
            raise
        finally:
            self._programs = in_use

    def replace(self, programs: Mapping[tuple[str, ...], Program]) -> None:
        """Takes programs that recompile() made. Those that they replace live on until release(): passes hold them."""
        self._retired += [self._programs[key] for key in programs if key in self._programs]
        self._programs |= programs

    @property
    def names(self) -> list[str]:
        """Programs compiled so far, each with its features."""
        return sorted(p.name for p in self._programs.values())

    def release(self) -> None:
        """Frees all programs. Twice is harmless."""
        if self._programs or self._retired:
            self._context.raw.glUseProgram(0)  # one in use outlives its release
        for program in (*self._programs.values(), *self._retired):
            program.program.release()
        self._programs.clear()
        self._retired.clear()


def _stamp(path: Path) -> tuple[int, int]:
    """What changes when a file is written; (0, 0) where there is none."""
    try:
        found = path.stat()
    except OSError:
        return 0, 0
    return found.st_mtime_ns, found.st_size


def _label(named: Mapping[str, int]) -> str:
    return " ".join(f"{name.removeprefix('USE_')}={value}" for name, value in sorted(named.items()) if value)
