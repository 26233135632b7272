"""The README's examples in Python run as they stand, but for their sizes."""

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BUILT = """
with gh.Renderer() as renderer:
    frame = renderer.render(scene, size=(32, 18), aovs=("instance_id",))
assert set(frame["instance_id"].ravel().tolist()) >= {0, 1} and len(frame.receipt["scene"]["warnings"]) == 2
"""


def test_the_examples_run(tmp_path: Path) -> None:
    examples = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
    assert len(examples) == 2
    example = "\n".join(examples) + BUILT
    smaller = {"model.glb": "grey", "(1920, 1080)": "(32, 18)", "range(48)": "range(2)"}
    for text, instead in smaller.items():
        assert text in example, text
        example = example.replace(text, instead)
    path = os.pathsep.join(p for p in (str(ROOT), os.environ.get("PYTHONPATH", "")) if p)
    run = subprocess.run(
        [sys.executable, "-c", example],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": path},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0 and (tmp_path / "picture.png").stat().st_size > 0, run.stderr
