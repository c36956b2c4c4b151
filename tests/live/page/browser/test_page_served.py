"""The page as the server of `teleop demo --page` serves it, under its own policy; its children are fakes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from teleop.live.page.command import page_bytes
from tests.browser import Page
from tests.live.page.conftest import TOKEN, Served

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
