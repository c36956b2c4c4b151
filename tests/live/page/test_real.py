"""`teleop demo --page` as it is typed, with real ends and a real channel; what a person did on it runs again."""

from __future__ import annotations

import asyncio
import json
import re
import signal
import subprocess
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest
from websockets.asyncio.client import connect
from websockets.typing import Origin

from master.hand_record import HandRecording
from teleop import load_result, load_scene, run
from teleop.live.records.merge import scene_of
from teleop.physics.plant import grip_force
from teleop.simulation.bodies import master_coefficients
from tests.live.conftest import OWN
from tests.live.page.conftest import Browser
from tests.waiting import PATIENCE, until

pytestmark = pytest.mark.live

TYPED = [sys.executable, "-m", "teleop", "demo", "hard_wall", "--page", "--json", "--out", "page"]


def environment(**more: str) -> dict[str, str]:
    return {**OWN, "XDG_RUNTIME_DIR": mkdtemp(), **more}  # no page's port is another's


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
                               proxy=None, open_timeout=PATIENCE, ping_interval=None) as socket:
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


def test_a_wall_is_pressed_the_law_is_turned_and_both_parts_are_kept_and_run_again(tmp_path: Path) -> None:
    async def look(browser: Browser) -> None:
        async def drag(to: float, shows: Callable[[dict[str, Any]], Any]) -> dict[str, Any]:
            async def hold() -> None:
                while True:
                    await browser.say("hand", to=[to])
                    await asyncio.sleep(0.25)

            holding = asyncio.create_task(hold())
            try:
                return await browser.until("rows", shows)
            finally:
                holding.cancel()

        await drag(-0.02, lambda rows: rows["xm"][0] < -0.018)
        rows = await drag(0.06, lambda rows: rows["fm"][0] > 2.0)  # the wall, felt over 50 ms each way
        assert rows["xs"][0] < 0.04
        await browser.say("turn", law="pp", delay=0.02)
        hello = await browser.until("hello", lambda hello: hello["law"] == "pp")
        assert hello["link"] == "delay(0.02)"
        await drag(0.06, lambda rows: rows["fm"][0] > 2.0)  # and still there: the hand is aligned before it goes on

    document = shown(tmp_path, look)
    folder = tmp_path / "page"
    assert (document["mode"], document["parts"]) == ("page", 2)
    index = json.loads((folder / "page.json").read_text())
    assert [part["folder"] for part in index["parts"]] == ["01", "02"]
    hand = HandRecording(str(folder))
    r = np.array(hand.samples(1, hand.ticks + 1, hand.dt_ns)[0])
    assert r.min() < -0.018
    assert r.max() > 0.035
    for part, law in zip(index["parts"], ("wave", "pp"), strict=True):
        result = load_result(folder / part["folder"])
        assert result.parameters["law"]["name"] == law
        assert result.trace["f_m"].max() > 2.0
        _is_what_the_sensor_felt(folder / part["folder"] / "master", r)
    second = load_result(folder / "02")
    assert round(second.trace["t"][0] / 1e-3) >= index["parts"][1]["k"] > 0  # from where both ends have begun it
    for law in ("wave", "direct"):
        result = run(load_scene("hard_wall", hand=folder, law=law))
        assert (result.status, result.ticks) == ("ok", hand.ticks), law


def _is_what_the_sensor_felt(folder: Path, r: np.ndarray[Any, Any]) -> None:
    """The hand's force, worked out anew from its recorded reference, is the one that was felt."""
    own = load_result(folder).trace
    k = np.rint(np.asarray(own["t"]) * 1e3).astype(int)
    follows = np.flatnonzero((np.diff(k) == 1) & (k[:-1] > 0)) + 1  # the force held over the last tick is known
    assert len(follows) > 200
    x, v, f, felt = (np.asarray(own[name]) for name in ("x_m", "v_m", "f_m", "f_h"))
    c, at = master_coefficients(scene_of(folder))[0], k[follows]
    again = grip_force(c, x[follows], v[follows], f[follows - 1], r[at], (r[at] - r[at - 1]) / 1e-3)  # type: ignore[arg-type]  # rows at once
    np.testing.assert_allclose(again, felt[follows], rtol=0.0, atol=1e-12)  # N, of up to 10; the rest is rounding


@pytest.mark.full
def test_the_browser_is_opened_if_it_is_asked_for_and_an_end_before_that_leaves_what_was_recorded(
    tmp_path: Path
) -> None:
    browser, record = tmp_path / "browser", tmp_path / "page" / "01" / "master" / "record.bin"
    browser.write_text('#!/bin/sh\ncat "${1#file://}" > opened.part && mv opened.part opened\n')
    browser.chmod(0o755)
    process = subprocess.Popen([*TYPED, "--open"], cwd=tmp_path, env=environment(BROWSER=f"{browser} %s"), text=True,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        assert process.stderr is not None
        line = process.stderr.readline()
        until((tmp_path / "opened").is_file, "no browser was opened")
        assert line.removeprefix("page: ").strip() in (tmp_path / "opened").read_text()
        assert "ssh -L" in process.stderr.readline()
        until(lambda: record.is_file() and record.stat().st_size > 50_000, "nothing was recorded")
    finally:
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 0, err
    assert json.loads(out)["parts"] == 1
    assert (tmp_path / "page" / "01" / "summary.json").is_file()
