"""The documentation site is built from the pages of the repository, and no link in it is broken."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.docs
def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="pip install 'bilateral-teleop[docs]'")
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "-f", str(ROOT / ".docs/mkdocs.yml")]
    done = subprocess.run([*build, "-d", str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "x<" in (tmp_path / "reference/teleop/index.html").read_text()  # names of the reference
    assert "<math" in (tmp_path / "laws/index.html").read_text()
    assert "$" not in (tmp_path / "laws/index.html").read_text().partition("<article")[2].partition("</article>")[0]
    laws = {path.stem for path in (ROOT / "teleop/laws").glob("*.py")} - {"__init__"}
    formulas = (ROOT / ".docs/pages/laws.md").read_text()
    assert [law for law in sorted(laws) if f"| `{law}` |" not in formulas] == []
