"""`glhybrid bench`: rays, frames and the builder; or with a flag one of the benches of their own."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from glhybrid import console
from glhybrid.cli_common import Common
from glhybrid.errors import SettingError, unknown


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
        console.print_json(report.to_dict())
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
        console.print_json(result.to_dict())
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
        console.print_json(report.to_dict())
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
        console.print_json(report)
    else:
        view.show(report)
    return 0
