"""The README's example in Python runs as it stands, but for its sizes."""

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_the_example_runs(tmp_path: Path) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.S)
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
