"""The failure library in one picture: `make failures`, or `failure_sheet.py -o failures.png [CASE...]`.

For each case what must fail beside what holds, with the figures; what counts against a technique is marked in red.
Exit status 1 if anything is unexpected.
"""

import argparse
import sys
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

import glhybrid as gh
from glhybrid import console
from glhybrid.study import failures

TILE, LINE, ACROSS = (320, 240), 14, 3  # pixels, pixels, cases in a row


def pair(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The first that must fail, and the last that must hold, of those that have a picture; one stands for both."""
    shown = [row for row in rows if "picture" in row]
    fails, holds = ([row for row in shown if row["fails"] == kind] for kind in (True, False))
    return [*fails[:1], *holds[-1:]] if fails else holds[:1] + holds[-1:]


def card(rows: list[dict[str, Any]]) -> Image.Image:
    """A case: its title and reason, two pictures, their techniques and figures."""
    image = Image.new("RGB", (2 * TILE[0] + 4, TILE[1] + 5 * LINE), (24, 24, 28))
    draw = ImageDraw.Draw(image)
    draw.text((4, 2), rows[0]["title"], fill=(255, 255, 255))
    draw.text((4, 2 + LINE), textwrap.fill(rows[0]["why"], 108), fill=(160, 160, 170), spacing=2)
    for k, row in enumerate(pair(rows)):
        picture = Image.fromarray(row["picture"])
        scale = min(TILE[0] / picture.width, TILE[1] / picture.height)
        size = (round(picture.width * scale), round(picture.height * scale))
        image.paste(picture.resize(size, Image.Resampling.NEAREST), (k * (TILE[0] + 4), 3 * LINE + 4))
        color = {failures.HOLDS: (120, 220, 120), failures.FAILS: (240, 200, 90)}.get(row["verdict"], (255, 80, 80))
        place = (k * (TILE[0] + 4) + 4, TILE[1] + 3 * LINE + 6)
        draw.text(place, f"{row['technique']}: {row['value']:.3g} {row['unit']}"[:52], fill=color)
    return image


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*")
    parser.add_argument("-o", "--output", type=Path, default=Path("failures.png"))
    parser.add_argument("--device", default="auto")
    options = parser.parse_args()
    with gh.Renderer(options.device) as renderer, console.progress(True) as progress:
        rows = failures.run(renderer, options.cases or None, progress, pictures=True)
    names = list(dict.fromkeys(row["case"] for row in rows))
    cards = [card([row for row in rows if row["case"] == name]) for name in names]
    width, height = cards[0].size
    sheet = Image.new("RGB", (min(ACROSS, len(cards)) * (width + 8), -(-len(cards) // ACROSS) * (height + 8)))
    for i, image in enumerate(cards):
        sheet.paste(image, (i % ACROSS * (width + 8), i // ACROSS * (height + 8)))
    sheet.save(options.output)
    for row in rows:
        value = "" if row["value"] is None else f"{row['value']:.4g} {row['unit']}"
        print(f"{row['case']:18} {row['technique']:46} {value:28} {row['verdict']}")
    unexpected = int(np.sum([row["verdict"] == failures.UNEXPECTED for row in rows]))
    print(f"{options.output}: {len(names)} cases, {len(rows)} techniques, {unexpected} unexpected")
    return int(unexpected > 0)


if __name__ == "__main__":
    sys.exit(main())
