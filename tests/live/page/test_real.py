"""`teleop demo --page` as it is typed, with real ends and a real channel."""

from __future__ import annotations

import asyncio
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
from websockets.asyncio.client import connect
from websockets.typing import Origin

from teleop import load_result
from teleop.live.page.command import PAGE
from teleop.scene.library import ROOT
from tests.live.page.conftest import Browser
from tests.waiting import PATIENCE, until

pytestmark = pytest.mark.live

TYPED = [sys.executable, "-m", "teleop", "demo", "hard_wall", "--page", "--json", "--out", "page"]


def environment(**more: str) -> dict[str, str]:
    own = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    return {**own, "PYTHONPATH": str(ROOT), **more}


def shown(folder: Path, look: Callable[[Browser], Awaitable[None]], *words: str) -> dict[str, Any]:
    """Have a browser look at what is typed, then Ctrl-C: the document that is printed."""
    async def beside() -> dict[str, Any]:
        process = await asyncio.create_subprocess_exec(
            *TYPED, *words, cwd=folder, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        try:
            assert process.stderr is not None
            line = (await asyncio.wait_for(process.stderr.readline(), PATIENCE)).decode()
            found = re.search(r"http://(127\.0\.0\.1:\d+)/\?token=(\S+)", line)
            assert found is not None, line
            host = found[1]
            async with connect(f"ws://{host}/ws?token={found[2]}", origin=Origin(f"http://{host}"),
                               proxy=None) as socket:
                await look(Browser(socket))
                process.send_signal(signal.SIGINT)
                out, err = await asyncio.wait_for(process.communicate(), PATIENCE)
            assert process.returncode == 0, err
            document: dict[str, Any] = json.loads(out)
            return document
        finally:
            if process.returncode is None:
                process.kill()

    return asyncio.run(beside())


def test_a_wall_is_pressed_the_law_is_turned_and_both_parts_are_kept(tmp_path: Path) -> None:
    async def look(browser: Browser) -> None:
        async def press(shows: Callable[[dict[str, Any]], Any]) -> dict[str, Any]:
            async def hold() -> None:
                while True:
                    await browser.say("hand", to=[0.06])
                    await asyncio.sleep(0.25)

            holding = asyncio.create_task(hold())
            try:
                return await browser.until("rows", shows)
            finally:
                holding.cancel()

        await browser.until("rows")
        rows = await press(lambda rows: rows["fm"][0] > 2.0)  # the wall, felt over 50 ms each way
        assert rows["xs"][0] < 0.04
        await browser.say("turn", law="pp", delay=0.02)
        hello = await browser.until("hello", lambda hello: hello["law"] == "pp")
        assert hello["link"] == "delay(0.02)"
        await press(lambda rows: rows["fm"][0] > 2.0)  # and still there: the hand is aligned before it goes on

    document = shown(tmp_path, look)
    assert (document["mode"], document["parts"]) == ("page", 2)
    index = json.loads((tmp_path / "page" / "page.json").read_text())
    assert [part["folder"] for part in index["parts"]] == ["01", "02"]
    for part, law in zip(index["parts"], ("wave", "pp"), strict=True):
        result = load_result(tmp_path / "page" / part["folder"])
        assert result.parameters["law"]["name"] == law
        assert result.trace["f_m"].max() > 2.0
    second = load_result(tmp_path / "page" / "02")
    assert round(second.trace["t"][0] / 1e-3) >= index["parts"][1]["k"] > 0  # from where both ends have begun it


def test_ctrl_c_before_a_page_is_opened_leaves_what_was_recorded(tmp_path: Path) -> None:
    process = subprocess.Popen(TYPED, cwd=tmp_path, env=environment(), text=True, stdout=subprocess.PIPE,
                               stderr=subprocess.PIPE)
    record = tmp_path / "page" / "01" / "master" / "record.bin"
    until(lambda: record.is_file() and record.stat().st_size > 50_000, "nothing was recorded")
    process.send_signal(signal.SIGTERM)
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, err
    assert json.loads(out)["parts"] == 1
    assert (tmp_path / "page" / "01" / "summary.json").is_file()


def test_the_browser_is_opened_if_it_is_asked_for(tmp_path: Path) -> None:
    browser = tmp_path / "browser"
    browser.write_text('#!/bin/sh\ncat "${1#file://}" > opened.part && mv opened.part opened\n')
    browser.chmod(0o755)
    process = subprocess.Popen([*TYPED, "--open"], cwd=tmp_path, env=environment(BROWSER=f"{browser} %s"), text=True,
                               stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    try:
        assert process.stderr is not None
        line = process.stderr.readline()
        until((tmp_path / "opened").is_file, "no browser was opened")
        assert line.removeprefix("page: ").strip() in (tmp_path / "opened").read_text()
        assert "ssh -L" in process.stderr.readline()
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=PATIENCE)


def test_the_page_is_small() -> None:
    assert PAGE.stat().st_size < 40_000
