"""The page as the server of `teleop demo --page` serves it, under its own policy; its children are fakes."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from teleop.live.page.command import page_bytes
from teleop.scene.library import ROOT
from tests.browser import Page
from tests.live.page.conftest import TOKEN, Served
from tests.waiting import PATIENCE

pytestmark = pytest.mark.live


def test_a_drag_reaches_the_master_and_a_law_is_switched_while_it_is_held(
    served: Callable[..., Served], tab: Callable[..., Page]
) -> None:
    def look(served: Served) -> None:
        page = tab(f"http://{served.host}/?token={TOKEN}")
        page.drag(page.place("#stage"), (page.evaluate("(.058 - base()[0]) * place().scale"), 0.0))
        page.until("Math.abs(row.xm[0] - .058) < 1e-3 && row.fm[0] > 1 && row.fe[0] > .3")
        page.evaluate("document.getElementById('law').focus()")
        page.key("ArrowDown")  # the one below wave
        page.until("hello.law === 'wave_filter' && document.getElementById('law').value === 'wave_filter'")
        page.until("status.parts === 2")
        page.until("row.gain[0] === 1 && row.gain[1] === 1 && Math.abs(row.xm[0] - .058) < 1e-3")
        page.key("Escape")
        page.until("target === null")
        assert page.console == []

    async def scenario(page: Served) -> None:
        await asyncio.to_thread(look, page)
        await page.until(lambda: page.orders("master")[-1] == {"order": "hand", "to": None})

    index = served(scenario, html=page_bytes()).index()
    assert [part["knobs"].get("law", "wave") for part in index["parts"]] == ["wave", "wave_filter"]


@pytest.mark.full
def test_a_page_whose_demo_was_started_again_comes_back_by_itself(tmp_path: Path, tab: Callable[..., Page]) -> None:
    """It had another port and another token, and the browser was shown the old ones for ever."""
    tmp_path.chmod(0o700)
    own = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_RUNTIME_DIR": str(tmp_path)}

    def start(out: str) -> tuple[subprocess.Popen[str], str]:
        demo = subprocess.Popen([sys.executable, "-m", "teleop", "demo", "--page", "--out", out], cwd=tmp_path, env=own,
                                stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        assert demo.stderr is not None
        line = demo.stderr.readline()
        assert "http" in line, line
        return demo, line.split()[-1]

    demo, address = start("first")
    try:
        page = tab(address)
        page.evaluate("window.same = true")
        demo.send_signal(signal.SIGINT)
        demo.communicate(timeout=PATIENCE)
        page.until("$('conn').className === 'lost'")
        demo, again = start("second")
        assert again == address
        page.until("$('conn').textContent === 'connected' && same && row.part === '01'")
        assert page.text("#said") == "The demo runs again, and this page shows it."
        t = page.evaluate("row.t")
        page.until(f"row.t > {t}")
    finally:
        demo.send_signal(signal.SIGINT)
        demo.communicate(timeout=PATIENCE)
