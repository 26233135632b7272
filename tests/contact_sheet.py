"""Every model of some folders in one picture: `make sheet`, or `contact_sheet.py FOLDER -o sheet.png`.

Files that cannot be drawn are listed with their error; exit status 1 if anything but a clear refusal happened, or if a
picture has a pixel that is not finite.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from rich.progress import track

import glhybrid as gh

SUFFIXES = {".glb", ".gltf", ".obj", ".ply", ".stl", ".off"}
TILE = (320, 240)


def tile(renderer: gh.Renderer, path: Path) -> tuple[Image.Image, str]:
    """A labelled picture of one file, and what went wrong ("" if nothing)."""
    problem = ""
    picture = Image.new("RGB", TILE, (40, 0, 40))
    try:
        frame = renderer.render(gh.load(path), size=TILE)
        picture = Image.fromarray(frame.rgb)
        if not np.isfinite(frame["radiance"]).all():
            problem = "a pixel is not finite"
    except gh.GlhybridError as error:
        problem = str(error).splitlines()[0]
    ImageDraw.Draw(picture).text((4, 3), path.stem, fill=(255, 255, 255), stroke_width=2, stroke_fill=(0, 0, 0))
    return picture, problem


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--skip", nargs="*", default=[], help="names of folders to leave out")
    parser.add_argument("-o", "--output", type=Path, default=Path("sheet.png"))
    parser.add_argument("--device", default="auto")
    options = parser.parse_args()
    found = {p for folder in options.folders for p in folder.rglob("*") if p.suffix.lower() in SUFFIXES}
    files = sorted(p for p in found if not set(p.parts) & set(options.skip))
    tiles, problems = [], []
    with gh.Renderer(options.device) as renderer:
        for path in track(files, description="models"):
            picture, problem = tile(renderer, path)
            tiles.append(picture)
            if problem:
                problems.append(f"{path}: {problem}")
    columns = max(1, int(np.ceil(np.sqrt(len(tiles)))))
    sheet = Image.new("RGB", (columns * TILE[0], -(-len(tiles) // columns) * TILE[1]))
    for i, picture in enumerate(tiles):
        sheet.paste(picture, (i % columns * TILE[0], i // columns * TILE[1]))
    sheet.save(options.output)
    print(f"{options.output}: {len(files)} files, {len(problems)} not drawn", *problems, sep="\n  ")
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main())
