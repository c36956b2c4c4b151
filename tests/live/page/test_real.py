"""`teleop demo --page` and `teleop study run` as they are typed, with real ends; what a person did runs again."""

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
from threading import Thread
from types import TracebackType
from typing import Any

import numpy as np
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection
from websockets.sync.client import connect as connect_sync
from websockets.typing import Origin

from master.hand_record import HandRecording
from teleop import load_result, load_scene, run
from teleop.__main__ import main
from teleop.law import known_laws
from teleop.live.page.rows import RecordTail
from teleop.live.records.merge import scene_of
from teleop.people.journal import read_journal
from teleop.physics.plant import grip_force
from teleop.simulation.bodies import master_coefficients
from tests.live.conftest import OWN, running
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
    again = grip_force(c, x[follows], v[follows], f[follows - 1], r[at], (r[at] - r[at - 1]) / 1e-3)  # rows at once
    np.testing.assert_allclose(again, felt[follows], rtol=0.0, atol=1e-12)  # N, of up to 10; the rest is rounding


@pytest.mark.full
def test_the_browser_is_opened_if_it_is_asked_for_and_an_end_before_that_leaves_what_was_recorded(
    tmp_path: Path
) -> None:
    browser, record = tmp_path / "browser", tmp_path / "page" / "01" / "master" / "record.bin"
    browser.write_text('#!/bin/sh\ncat "${1#file://}" > opened.part && mv opened.part opened\n')
    browser.chmod(0o755)
    own = environment(BROWSER=f"{browser} %s")
    process = subprocess.Popen([*TYPED, "--open"], cwd=tmp_path, env=own, text=True,
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
    again = subprocess.Popen(TYPED, cwd=tmp_path / "page", env=own, text=True, stderr=subprocess.PIPE)
    try:
        assert again.stderr is not None
        assert again.stderr.readline() == line, "a browser that showed the page comes back to it by itself"
    finally:
        again.send_signal(signal.SIGTERM)
        again.communicate(timeout=PATIENCE)


PLAN = '''
name = "try"
scene = "hard_wall"
set = {{delay = 0.02}}
turn = 1.0
[participants]
least = 2
most = 4
multiple_of = 2
[[condition]]
name = "first condition"
set = {{law = "wave"}}
[[condition]]
name = "other condition"
set = {{law = "tdpa"}}
[task]
{task}
[analysis]
primary = "{primary}"
contrasts = [["first condition", "other condition"]]
'''
NAMES = re.compile(r"\b(" + "|".join(sorted({*known_laws()} - {"direct"})) + r")\b|(first|other) condition|law\.|E_in_")
"""Names of conditions; `direct` is a word of style sheets too."""


class StudySession:
    """The process of a session; `url` is its address. `lines`: what it has printed on its standard error."""

    def __init__(self, folder: Path, *words: str, participant: int = 1) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "teleop", "study", "run", "plan.toml", "--participant", str(participant), "--out",
             "study", *words], cwd=folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            env={**OWN, "XDG_RUNTIME_DIR": mkdtemp()})
        self.lines: list[str] = []
        self._reader = Thread(target=self._read, daemon=True)
        self._reader.start()
        until(lambda: self.url or self.process.poll() is not None)
        assert self.url, self.lines

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append(line)

    @property
    def url(self) -> str:
        found = re.search(r"http://\S+", "".join(self.lines))
        return found[0] if found else ""

    def command_lines(self) -> list[str]:
        """The command lines of the processes that it has started."""
        return list(running(self.process.pid).values())

    def interrupt(self) -> str:
        """End it as by Ctrl-C; what it prints in the end."""
        self.process.send_signal(signal.SIGINT)
        return self.wait()

    def wait(self) -> str:
        """What it prints in the end."""
        assert self.process.stdout is not None
        out = self.process.stdout.read()
        assert self.process.wait(PATIENCE) == 0, (out, self.lines)
        self._reader.join(PATIENCE)
        return out

    def __enter__(self) -> StudySession:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()


def readable(folder: Path) -> str:
    """The names of all files of a study, and what stands in those that any user may read, but for the plan."""
    paths = [path for path in folder.rglob("*") if path.is_file()]
    texts = [path.read_bytes().decode(errors="replace") for path in paths
             if path.stat().st_mode & 0o004 and path.name != "plan.toml"]
    return "\n".join([*(str(path.relative_to(folder)) for path in paths), *texts])


def screen_of(session: StudySession) -> ClientConnection:
    """The socket of a screen."""
    host, _, token = session.url.removeprefix("http://").partition("/?token=")
    return connect_sync(f"ws://{host}/ws?token={token}", origin=Origin(f"http://{host}"), proxy=None,
                        open_timeout=PATIENCE)


def sit(session: StudySession, over: Callable[[dict[str, Any]], bool]) -> list[str]:
    """Take part until a message shows that it is over; what the screen was sent."""
    sent: list[str] = []
    with screen_of(session) as socket:
        while True:
            sent.append(str(socket.recv(PATIENCE)))
            message = json.loads(sent[-1])
            if over(message):
                return sent
            answer: dict[str, Any] | None = None
            if message["type"] == "rows":
                answer = {"type": "hand", "to": [0.05]}
            elif message["type"] == "screen":
                answer = {"consent": {"type": "consent", "code": "P1"}, "instructions": {"type": "next"},
                          "stopped": {"type": "next"}}.get(message["screen"])
            if answer is not None:
                socket.send(json.dumps(answer))


def test_nothing_that_anybody_can_see_names_a_condition_and_a_cut_trial_runs_again(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN.format(task='kind = "free"\nseconds = 0.5\nrepeats = 2',
                                                    primary="peak_force"))
    with StudySession(tmp_path) as session:
        sent = sit(session, lambda message: message.get("screen") == "trial" and message["done"] == 1)
        lines = session.command_lines()
        assert len(lines) == 3, lines
        printed = session.interrupt()
    assert "1 of 4 trials" in printed
    with StudySession(tmp_path, "--resume") as again:
        sent += sit(again, lambda message: message.get("screen") == "end")
        printed += again.wait()
    study = tmp_path / "study"
    rows = [row for row in read_journal(study / "sub-01" / "journal.jsonl") if row["kind"] == "trial"]
    assert [(row["number"], row["again"]) for row in rows] == [(1, 0), (2, 1), (3, 0), (4, 0)]
    assert {row["letter"] for row in rows} == {"A", "B"}
    assert all(row["peak_force"] > 1.0 and 0.03 < row["delay"] < 1.0 for row in rows)
    for seen in (*sent, *lines, printed, *session.lines, *again.lines, readable(study)):
        found = NAMES.search(seen)
        assert found is None, seen[max(0, found.start() - 80):found.end() + 80]
    assert {path.name for path in (study / "sub-01" / "trial-003").rglob("*") if path.is_file()} == {
        "hand.bin", "ends.bin"}
    assert not (study / ".live-01").exists()
    rerun = ["study", "rerun", str(study), "--trial", "sub-01/3", "--out"]
    assert main([*rerun, str(tmp_path / "blind")]) == 2
    assert main(["study", "unblind", str(study), "--name", "somebody"]) == 0
    assert main([*rerun, str(tmp_path / "again"), "--law", "direct"]) == 0
    assert json.loads((tmp_path / "again" / "interval-1" / "summary.json").read_text())["status"] == "ok"
    assert main([*rerun, str(tmp_path / "own")]) == 0
    own = load_result(tmp_path / "own" / "interval-1" / "master")
    at_peak = float(abs(own.trace["f_m"]).max())
    assert at_peak >= next(row["peak_force"] for row in rows if row["number"] == 3) > 1.0
    assert main(["replay", str(tmp_path / "own" / "interval-1" / "master")]) == 0, "and runs again to the bit"


def newest_force(study: Path) -> float | None:
    """The master's force of the newest row that it has written while nobody steers, N."""
    files = sorted(study.glob(".live-01/*/master/idle.bin"))
    if not files:
        return None
    tail = RecordTail(files[-1].parent, files[-1].name)
    tail.read()
    tail.close()
    return float(tail.newest[-1][tail.slices["f_m"].start]) if tail.newest else None


def test_stop_takes_the_force_away_and_whoever_withdraws_then_leaves_nothing(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(PLAN.format(task='kind = "free"\nseconds = 60.0', primary="peak_force"))
    with StudySession(tmp_path) as session:
        with screen_of(session) as socket:
            for message in ({"type": "consent", "code": "P1"}, {"type": "next"}):
                socket.send(json.dumps(message))
            pressing: dict[str, Any] = {}
            while not pressing.get("xm", [0.0])[0] > 0.035:  # beyond the wall's surface
                pressing = json.loads(socket.recv(PATIENCE))
                socket.send(json.dumps({"type": "hand", "to": [0.06]}))
            with screen_of(session) as second, pytest.raises(ConnectionClosed, match="1 page is open already"):
                second.recv(PATIENCE)
            socket.send(json.dumps({"type": "stop"}))
            until(lambda: newest_force(tmp_path / "study") == 0.0, "the force stays")
            rows = read_journal(tmp_path / "study" / "sub-01" / "journal.jsonl")
            assert [row["stopped"] for row in rows[1:]] == [True]
            socket.send(json.dumps({"type": "withdraw"}))
            while json.loads(socket.recv(PATIENCE)).get("screen") != "withdrawn":
                pass
        assert "nothing of the person is left" in session.wait()
    assert not (tmp_path / "study" / "sub-01").exists()
    assert not (tmp_path / "study" / ".live-01").exists()
