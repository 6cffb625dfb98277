"""The page on the engine: its code runs as it stands."""

import re
from pathlib import Path

PAGE = Path(__file__).parents[3] / "docs" / "engine.md"


def test_the_code_of_the_page_runs(tmp_path: Path):
    blocks = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S)
    assert len(blocks) >= 3
    names = {"__name__": "page"}
    for block in blocks:
        exec(compile(block, "docs/engine.md", "exec"), names)
