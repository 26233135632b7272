"""`glhybrid study`: for each scene a converged reference, then every cell of the sweep against it.

load -> reference.converge -> direct.find -> sweep.axis -> measure (kept in store) -> pareto -> sweep.pairs -> measure
     -> failures, stability -> results.json, results.csv, report.html
"""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from glhybrid import kernels, techniques
from glhybrid.bvh.blas import threads_available
from glhybrid.image import Frame
from glhybrid.renderer import Renderer
from glhybrid.scene import Scene
from glhybrid.study import beside, curves, jobs, results, scene_study, store, sweep
from glhybrid.study import failures as library
from glhybrid.study import paper as papers
from glhybrid.study.peers import panel
from glhybrid.study.progress import Meter, Progress
from glhybrid.study.results import Study
from glhybrid.study.sweep import Cell
from glhybrid.view import choose_camera

log = logging.getLogger("glhybrid")
SCENES = ("atrium", "plaza", "showroom")
QUICK_SCENES = ("showroom", "atrium")
PARTS = ("peers", "stability", "failures")  # what is done beside the scenes
PAPER_PARTS = ("ladder",)
UNTIMED = ("ladder", "stability", "failures")  # of these, what processes beside a study make
FAILURE_CELLS = 26  # what the failure library counts for in the progress
PEER_CELLS = 2.5  # and one other renderer on one scene


def run(
    names: Sequence[str],
    output: Path,
    *,
    quick: bool = False,
    paper: bool = False,
    device: str = "auto",
    sizes: Sequence[tuple[int, int]] = (),
    camera: int | str | None = None,
    only: Sequence[str] = (),
    samples: int | None = None,
    seconds: float | None = None,
    bounces: int = 8,
    command: str = "",
    parts: Sequence[str] | None = None,
    load: Callable[[str], Scene] | None = None,
    progress: Progress | None = None,
    lines: bool = False,
) -> Study:
    """Studies the scenes named, or the default ones, and writes everything to a folder; what is there and still holds
    is kept.

    paper: the paper's scenes, and its method against the many-ray one. sizes: in pixels; each scene is studied at each.
    only: names of techniques; default all. samples, seconds: the most paths a pixel, and the most time, of a
    reference. command: what is printed as the line that makes this study again. parts: of PARTS or PAPER_PARTS; default
    those. lines: log lines instead of a bar. Raises what loading, settings, devices and writing raise, all of it before
    any work is done where that can be known.
    """
    only = sweep.check_names(only)
    for size in sizes or (None,):
        scene_study.effort(quick, True, size, samples, seconds)  # refuses a size
    if parts is None:
        parts = PAPER_PARTS if paper else PARTS
    if paper and not sizes:
        sizes = (papers.QUICK_SIZE if quick else papers.SIZE,)
    scenes = _load(names or (papers.SCENES if paper else QUICK_SCENES if quick else SCENES), load)
    for scene in scenes.values():
        choose_camera(scene, camera)
    store.prepare(output)
    kernels.load_all()
    with Renderer(device=device, keep_programs=True) as renderer:
        software = renderer.context.device.software
        efforts = [
            scene_study.effort(quick, software, size, samples, seconds) for size in dict.fromkeys(sizes or (None,))
        ]
        spent = efforts[0]
        study, meter = Study(_machine(renderer, [e.size for e in efforts], command)), Meter(progress, lines)
        work = []
        for name, scene in scenes.items():
            axes = _paper_axes(study) if paper else _axes(name, scene, quick, only, study)
            seen = choose_camera(scene, camera)
            for at in efforts:
                full = name if len(efforts) == 1 else f"{name} {at.size[0]}x{at.size[1]}"
                work.append(
                    scene_study.SceneStudy(renderer, full, scene, seen, axes, at, bounces, output, study, meter, name)
                )
                meter.expect(work[-1].size_of_work())
        costs = {
            "peers": PEER_CELLS * len(panel.NAMES) * len(work),
            "ladder": papers.LADDER_CELLS,
            "stability": curves.CELLS * len(curves.names()),
            "failures": FAILURE_CELLS,
        }
        meter.expect(sum(costs[part] for part in parts))
        try:
            with _beside(renderer, device, output, quick) as crew:
                for one in work:
                    one.prepare(crew)
                if crew is not None:
                    for job in _untimed(parts, renderer.keeps_programs):
                        crew.put(job)
                for one in work:
                    one.run()
                    results.write(study, output)
                if crew is not None:
                    meter.begin(" and ".join(part for part in parts if part in UNTIMED))
                    with study.timed(f"waiting for {crew.processes} processes beside"):
                        crew.wait(lambda: meter.part(0.0))
            for part in parts:
                with study.timed(part):
                    if part == "ladder":
                        study.paper["ladder"] = papers.ladder(renderer, output / part, quick, spent.clock, meter)
                        study.paper["printed"] = list(papers.PRINTED)
                    elif part == "peers":
                        study.peers = _peers(renderer, [one.site() for one in work], quick, meter, study.note)
                    elif part == "stability":
                        study.curves = curves.run(renderer, output / part, quick, meter, study.note)
                    elif part == "failures":
                        study.failures = failures(renderer, output / part, meter, study.note)
                results.write(study, output)
        except KeyboardInterrupt:
            results.write(study, output)
            log.info("%s: stopped; the same command goes on from here", output / "report.html")
            raise
    return study


def _load(names: Sequence[str], load: Callable[[str], Scene] | None) -> dict[str, Scene]:
    """By the names of their folders: files of one name get numbers."""
    import glhybrid

    found: dict[str, Scene] = {}
    for given in names:
        stem = name = Path(given).stem
        number = 1
        while name in found:
            number += 1
            name = f"{stem}-{number}"
        found[name] = (load or glhybrid.load)(given)
    return found


def _axes(name: str, scene: Scene, quick: bool, only: Sequence[str], study: Study) -> Mapping[str, Sequence[Cell]]:
    skipped = sweep.skipped_axes(scene)
    for kind, reason in skipped.items():
        study.note(f"{name}: {kind} {'is' if kind == 'ao' else 'are'} not swept: {reason}")
    axes = {kind: sweep.axis(kind, quick=quick, only=only) for kind in techniques.TECHNIQUES if kind not in skipped}
    axes = {kind: cells for kind, cells in axes.items() if cells}
    return axes or {"shadows": [Cell(sweep.defaults())]}


def _paper_axes(study: Study) -> Mapping[str, Sequence[Cell]]:
    return {papers.AXIS: papers.cells()}


def _machine(renderer: Renderer, sizes: Sequence[tuple[int, int]], command: str) -> dict[str, Any]:
    from glhybrid.bench.report import machine

    return machine(
        renderer.context.device.to_dict(),
        size=list(sizes[0]),
        sizes=[list(size) for size in sizes],
        cores=threads_available(),
        command=command,
    )


@contextmanager
def _beside(renderer: Renderer, device: str, output: Path, quick: bool) -> Iterator[beside.Crew | None]:
    """Processes on the cores that a study on a GPU leaves; none in software, whose times they would disturb."""
    processes = 0 if renderer.context.device.software else min(threads_available() - 2, beside.MOST)
    if processes < 2:
        yield None
        return
    assert renderer.tuning  # measured before others use the device
    crew = beside.Crew(beside.Home(device, output, quick), processes)
    try:
        yield crew
    finally:
        crew.close()


def _untimed(parts: Sequence[str], programs: bool) -> list[beside.Job]:
    """What of a study's parts is not timed. programs: whether what is kept in the cache is of use."""
    return [
        *(jobs.Ladder(roughness) for roughness in papers.ROUGHNESS if programs and "ladder" in parts),
        *(jobs.Curve(name) for name in curves.names() if "stability" in parts),
        *(jobs.Failure(name) for name in library.cases() if "failures" in parts),
    ]


def _peers(
    renderer: Renderer, sites: Sequence[panel.Site], quick: bool, meter: Meter, note: Callable[[str], None]
) -> list[dict[str, Any]]:
    rows = []
    for site in sites:
        for name in panel.NAMES:
            meter.begin(f"{site.name}: {name}")
            samples = panel.QUICK_SAMPLES if quick else panel.SAMPLES
            rows.append(panel.ask(renderer, name, site, samples, note))
            meter.end(PEER_CELLS, free=rows[-1] is None)
    return [row for row in rows if row is not None]


def failures(
    renderer: Renderer, folder: Path, meter: Meter, note: Callable[[str], None], names: Sequence[str] | None = None
) -> list[dict[str, Any]]:
    """The failure library's rows, case by case, each kept with its pictures as it is finished. names: default all."""
    rows: list[dict[str, Any]] = []
    names = library.cases() if names is None else names
    for name in names:
        meter.begin(f"failure library: {name}")
        case = library.load(name)
        key = store.fingerprint(store.code_digest(), case.scene.sha256, renderer.context.device.to_dict())
        path = folder / f"{name}.json"
        kept = store.read(path, key)
        free = kept is not None
        if kept is None:
            found, images = [], {}
            for k, row in enumerate(library.run(renderer, [name], pictures=True)):
                picture_of = row.pop("picture", None)
                if picture_of is not None:
                    images[str(k)] = row["image"] = f"{name}-{k}.png"
                    folder.mkdir(parents=True, exist_ok=True)
                    Frame(picture_of).save(folder / row["image"])
                found.append(row)
            kept = {"rows": found, "images": images, "key": key}
            store.write_json(path, kept)
        for row in kept["rows"]:
            if row["verdict"] == library.SKIPPED:
                note(f"failure {row['case']}: {row['because']}")
            else:
                rows.append(row)
        meter.end(FAILURE_CELLS / len(names), free=free)
    return rows
