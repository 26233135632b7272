"""The command line: `glhybrid render | view | plan | bench | study | scenes | doctor`.

Exit codes: 0 done; 1 a bench whose hits differ; 2 bad input or usage; 3 no usable OpenGL; 130 interrupted. A user's
mistake is one line on stderr, never a traceback. Results go to stdout, everything else to stderr. Nothing heavy is
imported before a verb runs.
"""

import json
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import App, CycloptsError, Parameter

from glhybrid import __version__, cli_frames, cli_view, console
from glhybrid.cli_frames import Frames
from glhybrid.cli_view import View
from glhybrid.errors import DeviceError, GlhybridError, SettingError, unknown

if TYPE_CHECKING:
    from glhybrid.scene import Scene
    from glhybrid.settings import Settings

MAX_SIDE = 32768
USAGE_ERROR, INTERRUPTED = 2, 130
_arguments: list[str] = []  # of this run

app = App(
    name="glhybrid",
    help="A hybrid renderer: OpenGL rasterises, compute shaders trace shadows and reflections, on any OpenGL 4.3.",
    version=__version__,
    default_parameter=Parameter(negative=(), show_default=False),
    result_action="return_value",
    print_error=False,
    exit_on_error=False,
    suppress_keyboard_interrupt=False,
    help_format="plaintext",
)

SceneName = Annotated[
    str, Parameter(help="glTF, GLB, OBJ, PLY, STL or OFF file, a scene TOML, or a built-in scene's name (see scenes).")
]


@Parameter(name="*")
@dataclass(frozen=True)
class Common:
    """Flags of every verb that takes a scene."""

    device: Annotated[
        str,
        Parameter(help="auto, gpu, software, egl:N, cuda:N or osmesa. auto, the default, takes a GPU if there is one."),
    ] = "auto"
    size: Annotated[str, Parameter(help="Pixels, WxH; 1280x720.")] = "1280x720"
    camera: Annotated[
        str | None,
        Parameter(
            help="Name or index of a camera of the scene, its first one by default; or eye=X,Y,Z;target=X,Y,Z;fov=45."
        ),
    ] = None
    shadows: Annotated[
        str | None, Parameter(help="none, map, pcf, pcss, csm, baked, ray (the default) or ray-soft.")
    ] = None
    reflections: Annotated[
        str | None,
        Parameter(help="none, env, probe, ssr, ssr-ray, ray-lerp (the default), ray-glossy or reference (all of it)."),
    ] = None
    ao: Annotated[str | None, Parameter(help="Ambient occlusion of the sky: none (the default), ssao or ray.")] = None
    samples: Annotated[int | None, Parameter(help="Paths per pixel of reference; 64.")] = None
    bounces: Annotated[int | None, Parameter(help="Bounces after the first hit in reference; 8.")] = None
    time: Annotated[
        float | None, Parameter(help="Seconds into the clip, held at its ends; without it nothing is animated.")
    ] = None
    clip: Annotated[
        str | None,
        Parameter(
            help="Name or number of the animation, or all at once; the first by default. Alone, it is shown at 0 s."
        ),
    ] = None
    aa: Annotated[int | None, Parameter(help="Jittered frames averaged; 4 for PNG, 1 for EXR and NPZ.")] = None
    light: Annotated[
        tuple[str, ...],
        Parameter(
            help="INDEX:AZIMUTH,ELEVATION, degrees, of where a light comes from instead; may be repeated.",
            consume_multiple=False,
        ),
    ] = ()
    environment_rotation: Annotated[
        float | None, Parameter(help="Degrees about +Y instead of the scene's own.", allow_leading_hyphen=True)
    ] = None
    set: Annotated[
        tuple[str, ...],
        Parameter(name="--set", help="key=value of any setting; may be repeated.", consume_multiple=False),
    ] = ()
    config: Annotated[str | None, Parameter(help="TOML file of settings; flags and --set win over it.")] = None
    strict: Annotated[bool, Parameter(help="Anything of the file that cannot be drawn is an error.")] = False
    allow_outside: Annotated[bool, Parameter(help="Let a scene use files outside its folder.")] = False
    json: Annotated[bool, Parameter(help="Print the result as one JSON object.")] = False
    quiet: Annotated[bool, Parameter(help="No messages but errors.")] = False

    def settings(self) -> "Settings":
        """Defaults, then --config, then flags, then --set."""
        from glhybrid.settings import Settings

        settings = Settings().with_toml(self.config) if self.config is not None else Settings()
        flags = {
            name: getattr(self, name)
            for name in ("shadows", "reflections", "ao", "samples", "bounces", "aa", "time", "clip")
        }
        settings = settings.replace(**{name: value for name, value in flags.items() if value is not None})
        return settings.with_overrides(self.set)

    def pixels(self) -> tuple[int, int]:
        """(width, height) of --size. Raises SettingError."""
        match = re.fullmatch(r"(\d{1,6})[xX](\d{1,6})", self.size.strip())
        if match is None:
            raise SettingError(f'--size "{self.size}": expected WIDTHxHEIGHT in pixels, such as 1280x720')
        width, height = int(match[1]), int(match[2])
        if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
            raise SettingError(f"--size {self.size}: each side must be from 1 to {MAX_SIDE} pixels")
        return width, height

    def camera_key(self) -> int | str | None:
        """--camera as Renderer.render takes it."""
        text = self.camera
        return int(text) if text is not None and text.isdecimal() else text

    def load(self, scene: str) -> "Scene":
        """The scene, under the lights asked for. Raises LoadError or SettingError."""
        import glhybrid

        loaded = glhybrid.load(scene, strict=self.strict, allow_outside=self.allow_outside)
        if self.light or self.environment_rotation is not None:
            from glhybrid import relight

            loaded = relight.apply(loaded, self.light, self.environment_rotation)
        return loaded


@app.command
def render(
    scene: SceneName,
    /,
    *,
    output: Annotated[
        str | None,
        Parameter(
            name=["--output", "-o"],
            help=".png, .exr or .npz file, - for PNG to stdout; NAME.png by default.",
            allow_leading_hyphen=True,
        ),
    ] = None,
    aov: Annotated[str, Parameter(help="Layers of an EXR or arrays of an NPZ: depth,normal,...")] = "",
    exr_float: Annotated[bool, Parameter(help="32-bit colour in EXR instead of half.")] = False,
    frames: Frames = cli_frames.NONE,
    common: Common = Common(),
) -> int:
    """Render a picture, or one for each frame of an animation."""
    from glhybrid.image import check_aovs, check_output

    # Everything that can be refused is refused before any work is done.
    aovs = check_aovs(name.strip() for name in aov.split(",") if name.strip())
    if frames.asked():
        return _render_frames(
            scene,
            output if output is not None else f"{_stem(scene)}_{{frame:04d}}.png",
            aovs,
            exr_float,
            frames,
            common,
        )
    settings, size, path = common.settings(), common.pixels(), f"{_stem(scene)}.png" if output is None else output
    suffix = check_output(path, aovs)
    if path == "-" and common.json:
        raise SettingError("-o - and --json both want standard output: give the picture a file name")
    data = suffix != ".png"
    with console.progress(not (common.quiet or common.json)) as progress:
        progress(f"loading {scene}", 0, 0)
        loaded = common.load(scene)
        _say_warnings(loaded.warnings)
        from glhybrid.renderer import Renderer

        with Renderer(device=common.device) as renderer:
            frame = renderer.render(
                loaded,
                camera=common.camera_key(),
                size=size,
                settings=settings.replace(aa=settings.aa_frames(data)),
                aovs=("radiance", *(a for a in aovs if a != "radiance")) if data else (),
                progress=progress,
            )
        progress(f"writing {path}", 0, 0)
        frame.save(path, aov=aovs, exr_float=exr_float)
    receipt: dict[str, Any] = {"output": str(path)} | frame.receipt
    _say_warnings([w for w in receipt.get("scene", {}).get("warnings", ()) if w not in loaded.warnings])
    if common.json:
        _print_json(receipt)
    elif not common.quiet:
        print(_summary(receipt, size), file=sys.stderr if path == "-" else sys.stdout)
    return 0


def _render_frames(
    scene: str, output: str, aovs: tuple[str, ...], exr_float: bool, frames: Frames, common: Common
) -> int:
    from glhybrid import sequence

    settings, size = common.settings(), common.pixels()
    frames.point()
    sequence.check(output, size, frames.fps, aovs)
    with console.progress(not (common.quiet or common.json)) as progress:
        progress(f"loading {scene}", 0, 0)
        loaded = common.load(scene)
        _say_warnings(loaded.warnings)
        receipt = frames.run(
            loaded, settings, common.camera_key(), output, size, aovs, exr_float, common.device, progress
        )
    if common.json:
        _print_json(receipt)
    elif not common.quiet:
        print(cli_frames.summary(receipt))
    return 0


@app.command
def view(scene: SceneName, /, *, flags: View = cli_view.NONE, common: Common = Common()) -> int:
    """Look at a scene in a window, or with --web in a browser; --size is the picture's."""
    from glhybrid.settings import Settings

    settings, size = common.settings(), common.pixels()
    flags.refuse()
    plain = replace(common, light=(), environment_rotation=None)  # the viewer turns lights itself
    with console.progress(not common.quiet) as progress:
        progress(f"loading {scene}", 0, 0)
        loaded = plain.load(scene)
    _say_warnings(loaded.warnings)
    cli_view.run(
        scene, loaded, settings, settings != Settings(), flags, common.device, size, common.camera_key(),
        common.light, common.environment_rotation, plain.load,
    )  # fmt: skip
    return 0


@app.command
def plan(scene: SceneName, /, *, common: Common = Common()) -> int:
    """Show what a scene needs and what will run, with reasons and, where there is OpenGL, measured shares."""
    settings, size = common.settings(), common.pixels()
    with console.progress(not (common.quiet or common.json)) as progress:
        progress(f"loading {scene}", 0, 0)
        loaded = common.load(scene)
        _say_warnings(loaded.warnings)
        from glhybrid.plan import MEASURE_AOVS, MEASURE_SIZE, describe, measured
        from glhybrid.renderer import Renderer

        try:
            with Renderer(device=common.device) as renderer:
                software = renderer.context.device.software
                result = describe(loaded, settings, size, software=software, tuning=renderer.tuning)
                few = settings.replace(aa=2, samples=min(settings.samples, 4))
                frame = renderer.render(
                    loaded, common.camera_key(), MEASURE_SIZE, few, aovs=MEASURE_AOVS, progress=progress
                )
            result["measured"] = measured(frame)
        except DeviceError as error:
            result = describe(loaded, settings, size)
            result["measured"] = f"not measured: {str(error).splitlines()[0]}"
    if common.json:
        _print_json(result)
    else:
        console.tree(result)
    return 0


@app.command
def bench(
    *scene: Annotated[
        str,
        Parameter(
            help="Scenes as elsewhere, or the bench's own: hall, spheres, city, hall:100k; all by default. "
            "With --scale: curves, of triangles, pixels, lights, instances."
        ),
    ],
    quick: Annotated[bool, Parameter(help="Under a minute on two cores: fewer variants, sizes and rays.")] = False,
    peers: Annotated[bool, Parameter(help="Embree and Mitsuba on the same rays, where installed.")] = False,
    scale: Annotated[
        bool, Parameter(help="Instead: a frame's cost over triangles, pixels, lights and instances, with exponents.")
    ] = False,
    svg: Annotated[str | None, Parameter(help="With --scale: where to write its charts.")] = None,
    motion: Annotated[
        bool, Parameter(help="Instead: age of refitted trees, instances in motion, and reading pictures back.")
    ] = False,
    view: Annotated[
        bool, Parameter(help="Instead: how long the viewer takes to answer, in motion and at rest.")
    ] = False,
    device: Annotated[str, Parameter(help="auto, gpu, software, egl:N, cuda:N or osmesa.")] = "auto",
    size: Annotated[
        str | None, Parameter(help="Pixels, WxH; 1920x1080 on a GPU, else 1280x720, or 480x270 with --quick.")
    ] = None,
    allow_outside: Annotated[bool, Parameter(help="Let a scene use files outside its folder.")] = False,
    json: Annotated[bool, Parameter(help="Print the result as one JSON object.")] = False,
    quiet: Annotated[bool, Parameter(help="No messages but errors.")] = False,
) -> int:
    """Measure ray rates, frames and the tree builder; exit status 1 if any two variants find different hits."""
    common = Common(allow_outside=allow_outside) if size is None else Common(size=size, allow_outside=allow_outside)
    pixels = None if size is None else common.pixels()
    if motion + scale + view > 1:
        raise SettingError("--motion, --scale and --view are benches of their own: give one")
    if view:
        return _bench_view(scene, quick, device, pixels, common, json, quiet)
    if scale:
        return _bench_scale(scene, quick, device, pixels, svg, json, quiet)
    if svg is not None:
        raise SettingError("--svg: the charts are those of --scale")
    if motion:
        return _bench_motion(scene, quick, peers, device, pixels, common, json, quiet)
    from glhybrid import bench as benchmark
    from glhybrid.bench.report import show

    with console.progress(not (quiet or json)) as progress:
        report = benchmark.run(
            scene, quick=quick, with_peers=peers, device=device, size=pixels, load=common.load, progress=progress
        )
    if json:
        _print_json(report.to_dict())
    else:
        show(report)
    for failure in report.failures:
        console.error(failure)
    return 1 if report.failures else 0


def _bench_scale(
    over: Sequence[str], quick: bool, device: str, size: tuple[int, int] | None, svg: str | None, as_json: bool,
    quiet: bool,
) -> int:  # fmt: skip
    from glhybrid.bench import scale
    from glhybrid.context import open_context
    from glhybrid.image import check_folder, replacing

    if svg is not None and Path(svg).suffix.lower() != ".svg":
        raise SettingError(f"--svg {svg}: the charts are SVG: give a name that ends in .svg")
    if svg is not None:
        check_folder(Path(svg))
    for name in over:
        if name not in scale.VALUES:
            raise SettingError(f"--scale: {unknown('curve', name, scale.VALUES)}")
    with open_context(device) as context, console.progress(not (quiet or as_json)) as progress:
        result = scale.run(over or tuple(scale.VALUES), quick=quick, context=context, size=size, progress=progress)
    if svg is not None:
        with replacing(Path(svg)) as temporary:
            temporary.write_text(scale.chart(result), encoding="utf-8")
    if as_json:
        _print_json(result.to_dict())
    else:
        scale.show(result)
    return 0


def _bench_motion(
    names: Sequence[str], quick: bool, peers: bool, device: str, size: tuple[int, int] | None, common: Common,
    as_json: bool, quiet: bool,
) -> int:  # fmt: skip
    from glhybrid.bench import motion

    if peers:
        raise SettingError("--motion and --peers: nobody else refits our trees; give one")
    scenes = [(Path(name).stem, common.load(name)) for name in names]
    with console.progress(not (quiet or as_json)) as progress:
        report = motion.run(scenes, quick=quick, device=device, size=size, progress=progress)
    if as_json:
        _print_json(report.to_dict())
    else:
        motion.show(report)
    for failure in report.failures:
        console.error(failure)
    return 1 if report.failures else 0


def _bench_view(
    names: Sequence[str], quick: bool, device: str, size: tuple[int, int] | None, common: Common, as_json: bool,
    quiet: bool,
) -> int:  # fmt: skip
    from glhybrid.bench import view

    with console.progress(not (quiet or as_json)) as progress:
        report = view.run(names, load=common.load, quick=quick, device=device, size=size, progress=progress)
    if as_json:
        _print_json(report)
    else:
        view.show(report)
    return 0


@app.command
def study(
    *scene: Annotated[str, Parameter(help="Scenes as elsewhere; by default atrium, plaza and showroom.")],
    output: Annotated[str, Parameter(name=["--output", "-o"], help="Folder of the report; what is there is kept.")],
    quick: Annotated[bool, Parameter(help="Ten minutes on two cores: small pictures, few values, two scenes.")] = False,
    paper: Annotated[
        bool, Parameter(help="Kim's paper again: its method against many rays, at 1920x1080, and its figure 8.")
    ] = False,
    device: Annotated[str, Parameter(help="auto, gpu, software, egl:N, cuda:N or osmesa.")] = "auto",
    size: Annotated[
        str | None, Parameter(help="Pixels, WxH,WxH,...; 1920x1080 on a GPU, else 640x360; --quick: 960x540, 256x144.")
    ] = None,
    camera: Annotated[str | None, Parameter(help="Name or index of a camera that all scenes have.")] = None,
    techniques: Annotated[str, Parameter(help="Only these, by name: map,csm,ray,ssr,...")] = "",
    samples: Annotated[int | None, Parameter(help="The most paths per pixel of the reference.")] = None,
    reference_seconds: Annotated[
        float | None, Parameter(help="The most time for each reference; 60 on a GPU, else no limit; --quick: 10, 30.")
    ] = None,
    bounces: Annotated[int, Parameter(help="Bounces after the first hit in the reference; 8.")] = 8,
    allow_outside: Annotated[bool, Parameter(help="Let a scene use files outside its folder.")] = False,
    json: Annotated[bool, Parameter(help="Print results.json.")] = False,
    quiet: Annotated[bool, Parameter(help="No messages but errors.")] = False,
) -> int:
    """Time every technique and measure how wrong it is: report.html, results.json, results.csv and all pictures."""
    common = Common(allow_outside=allow_outside)
    sizes = [Common(size=one).pixels() for one in size.split(",")] if size is not None else []
    from glhybrid.settings import Settings

    Settings(bounces=bounces, samples=64 if samples is None else samples)  # refuses what is out of range
    from glhybrid.study import run as studies
    from glhybrid.study.report.words import summary
    from glhybrid.study.store import plain

    show = not (quiet or json)
    with console.progress(show) as progress:
        found = studies.run(
            scene, Path(output), quick=quick, paper=paper, device=device, sizes=sizes,
            camera=Common(camera=camera).camera_key(),
            only=techniques.split(","), samples=samples, seconds=reference_seconds, bounces=bounces,
            command=_command(), load=common.load, progress=progress, lines=show and not sys.stderr.isatty(),
        )  # fmt: skip
    if json:
        _print_json(plain(found.to_dict()))
    elif not quiet:
        summary(found)
        print(f"{Path(output) / 'report.html'}")
    return 0


@app.command
def scenes(
    *,
    failures: Annotated[bool, Parameter(help="The failure library instead: scenes that break one technique.")] = False,
    json: Annotated[bool, Parameter(help="Print a JSON array.")] = False,
) -> int:
    """List the built-in scenes."""
    from glhybrid.load import builtin

    found = builtin.failures() if failures else builtin.scenes()
    if json:
        _print_json([{"name": s.name, "description": s.description, "path": str(s.path)} for s in found])
    else:
        width = max((len(s.name) for s in found), default=0)
        for s in found:
            print(f"{s.name:<{width}}  {s.description}")
    return 0


@app.command
def doctor(*, json: Annotated[bool, Parameter(help="Print the report as one JSON object.")] = False) -> int:
    """Look at devices, drivers and libraries, and say what mends what is missing."""
    from glhybrid import doctor as checkup

    report = checkup.examine()
    if json:
        _print_json(report.to_dict())
    else:
        checkup.show(report)
    return 0 if report.usable else 3


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; returns the exit code."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    _arguments[:] = arguments
    console.start_log(quiet="--quiet" in arguments)
    try:
        return int(app(arguments) or 0)
    except CycloptsError as error:
        console.error(f"{str(error).rstrip('.')}; see glhybrid --help")
        return USAGE_ERROR
    except GlhybridError as error:
        console.error(error)
        return error.exit_code
    except KeyboardInterrupt:
        console.error("interrupted")
        return INTERRUPTED
    except BrokenPipeError:  # the reader of stdout left, as `| head` does
        sys.stderr.close()
        return 0
    except OSError as error:  # a full disk, a name too long
        console.error(f"{error.filename}: {error.strerror}" if error.filename else error)
        return USAGE_ERROR
    except MemoryError:
        console.error("not enough memory: take a smaller --size or scene")
        return USAGE_ERROR


def _command() -> str:
    """The line that was typed, ready to be typed again."""
    import shlex

    return shlex.join(["glhybrid", *_arguments])


def _stem(scene: str) -> str:
    return Path(scene).stem or "out"


def _say_warnings(warnings: Sequence[str], most: int = 5) -> None:
    import logging

    log = logging.getLogger("glhybrid")
    for warning in warnings[:most]:
        log.warning("%s", warning)
    if len(warnings) > most:
        log.warning("and %d more; --json lists them all", len(warnings) - most)


def _summary(receipt: dict[str, Any], size: tuple[int, int]) -> str:
    device, scene = receipt.get("device", {}), receipt.get("scene", {})
    name = str(device.get("renderer", "")) + (" (software)" if device.get("software") else "")
    triangles, frame_ms = scene.get("triangles", 0), receipt.get("frame_ms", 0.0)
    return f"{receipt['output']}: {size[0]}x{size[1]}, {triangles:,} triangles, {frame_ms:.1f} ms a frame on {name}"


def _print_json(value: Any) -> None:
    print(json.dumps(value, indent=2, default=_plain))


def _plain(value: Any) -> Any:
    """NumPy scalars and arrays, paths and sets as JSON has them."""
    if hasattr(value, "tolist"):
        return value.tolist()
    return sorted(value) if isinstance(value, (set, frozenset)) else str(value)


if __name__ == "__main__":
    raise SystemExit(main())
