"""The command line: `glhybrid render | view | plan | bench | study | scenes | settings | cache | doctor`.

Exit codes: 0 done; 1 a bench whose hits differ; 2 bad input or usage; 3 no usable OpenGL; 130 interrupted. A user's
mistake is one line on stderr, never a traceback. Results go to stdout, everything else to stderr. Nothing heavy is
imported before a verb runs.
"""

import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, CycloptsError, Parameter, UnknownCommandError, UnusedCliTokensError

from glhybrid import __version__, cli_bench, cli_common, cli_frames, cli_view, console
from glhybrid.cli_common import Common, SceneName
from glhybrid.cli_frames import Frames
from glhybrid.cli_view import View
from glhybrid.errors import DeviceError, GlhybridError, SettingError, unknown

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
    common: Common = cli_common.NONE,
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
        console.say_warnings(loaded.warnings)
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
    console.say_warnings([w for w in receipt.get("scene", {}).get("warnings", ()) if w not in loaded.warnings])
    if common.json:
        console.print_json(receipt)
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
        console.say_warnings(loaded.warnings)
        receipt = frames.run(
            loaded, settings, common.camera_key(), output, size, aovs, exr_float, common.device, progress
        )
    if common.json:
        console.print_json(receipt)
    elif not common.quiet:
        print(cli_frames.summary(receipt))
    return 0


@app.command
def view(scene: SceneName, /, *, flags: View = cli_view.NONE, common: Common = cli_common.NONE) -> int:
    """Look at a scene in a window, or with --web in a browser; --size is the picture's."""
    from glhybrid.settings import Settings

    settings, size = common.settings(), common.pixels()
    flags.refuse()
    plain = replace(common, light=(), environment_rotation=None)  # the viewer turns lights itself
    with console.progress(not common.quiet) as progress:
        progress(f"loading {scene}", 0, 0)
        loaded = plain.load(scene)
    console.say_warnings(loaded.warnings)
    cli_view.run(
        scene, loaded, settings, settings != Settings(), flags, common.device, size, common.camera_key(),
        common.light, common.environment_rotation, plain.load, common.loading(),
    )  # fmt: skip
    return 0


@app.command
def plan(scene: SceneName, /, *, common: Common = cli_common.NONE) -> int:
    """Show what a scene needs and what will run, with reasons and, where there is OpenGL, measured shares."""
    settings, size = common.settings(), common.pixels()
    with console.progress(not (common.quiet or common.json)) as progress:
        progress(f"loading {scene}", 0, 0)
        loaded = common.load(scene)
        console.say_warnings(loaded.warnings)
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
        console.print_json(result)
    else:
        console.tree(result)
    return 0


app.command(cli_bench.bench)


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
        console.print_json(plain(found.to_dict()))
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
        console.print_json([{"name": s.name, "description": s.description, "path": str(s.path)} for s in found])
    else:
        width = max((len(s.name) for s in found), default=0)
        for s in found:
            print(f"{s.name:<{width}}  {s.description}")
    return 0


@app.command
def settings(
    word: Annotated[str, Parameter(help="Only what has this in it: pcf, or reflections.ray-glossy.")] = "",
    /,
    *,
    json: Annotated[bool, Parameter(help="Print a JSON array.")] = False,
) -> int:
    """List techniques and everything else that --set and --config take, with defaults and meanings."""
    from glhybrid.settings import rows

    found = [row for row in rows() if word in f"{row.key}={row.value}"]
    if not found:
        raise SettingError(f'no setting or technique has "{word}" in it; glhybrid settings lists all')
    if json:
        console.print_json([row._asdict() for row in found])
    else:
        width = max(len(f"{row.key}={row.value}") for row in found)
        for row in found:
            print(f"{f'{row.key}={row.value}':<{width}}  {row.meaning}")
    return 0


@app.command
def cache(
    kind: Annotated[str, Parameter(help="Only of this kind: reference, bvh, ...")] = "",
    /,
    *,
    clear: Annotated[bool, Parameter(help="Delete it; what is needed is made again.")] = False,
    json: Annotated[bool, Parameter(help="Print one JSON object.")] = False,
) -> int:
    """Show what is kept on disk between runs, how much it may be, and delete it."""
    from glhybrid import caches
    from glhybrid.jit import cache_dir

    found = caches.look(kind)
    freed = caches.clear(kind) if clear else 0
    if json:
        kinds = [asdict(one) for one in (caches.look(kind) if clear else found)]
        console.print_json({"folder": str(cache_dir()), "freed": freed, "kinds": kinds})
    elif clear:
        print(f"{cache_dir()}: {freed / 2**20:.1f} MiB deleted")
    else:
        print(cache_dir())
        caches.show(found)
    return 0


@app.command
def doctor(*, json: Annotated[bool, Parameter(help="Print the report as one JSON object.")] = False) -> int:
    """Look at devices, drivers and libraries, and say what mends what is missing."""
    from glhybrid import doctor as checkup

    report = checkup.examine()
    if json:
        console.print_json(report.to_dict())
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
    except UnknownCommandError:
        verbs = [name for name in app if not name.startswith("-")]
        console.error(f"{unknown('command', arguments[0], verbs)}; see glhybrid --help")
        return USAGE_ERROR
    except UnusedCliTokensError as error:
        console.error(f'nothing is known to do with "{" ".join(error.unused_tokens or ())}"; see glhybrid --help')
        return USAGE_ERROR
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
        console.error(f"{error.filename}: {error.strerror}" if error.filename else error.strerror or error)
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


def _summary(receipt: dict[str, Any], size: tuple[int, int]) -> str:
    device, scene = receipt.get("device", {}), receipt.get("scene", {})
    name = str(device.get("renderer", "")) + (" (software)" if device.get("software") else "")
    triangles, frame_ms = scene.get("triangles", 0), receipt.get("frame_ms", 0.0)
    return f"{receipt['output']}: {size[0]}x{size[1]}, {triangles:,} triangles, {frame_ms:.1f} ms a frame on {name}"


if __name__ == "__main__":
    raise SystemExit(main())
