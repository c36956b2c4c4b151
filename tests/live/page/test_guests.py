"""Strangers, floods, garbage and slow readers: a sentence each, and those who behave are not disturbed."""

from __future__ import annotations

import asyncio
import errno
import hmac
import json
import os
import subprocess
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from socket import socket as stream_socket

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from teleop.__main__ import main
from teleop.live.page import server
from teleop.live.page.server import STRANGERS, Requests
from tests.live.page.conftest import HTML, TOKEN, Browser, Served
from tests.waiting import PATIENCE

pytestmark = pytest.mark.live
Serve = Callable[..., Served]
HOST = "127.0.0.1:4000"


def status(target: str, **headers: str) -> int | None:
    answer = Requests(HTML, TOKEN).answer(target, {"Host": HOST, **headers})
    return None if answer is None else int(answer.status)


def socket(**headers: str) -> int | None:
    return status(f"/ws?token={TOKEN}", **{"Origin": f"http://{HOST}", "Upgrade": "websocket", **headers})


def test_the_page_is_served_to_who_has_its_address_with_a_policy_for_its_own_lines() -> None:
    answer = Requests(HTML, TOKEN).answer(f"/?token={TOKEN}", {"Host": HOST})
    assert answer is not None
    assert (answer.status, answer.body) == (200, HTML)
    policy = answer.headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "script-src 'sha256-" in policy
    assert f"ws://{HOST}" in policy
    assert "unsafe" not in policy
    assert answer.headers["Referrer-Policy"] == "no-referrer"
    assert answer.headers["Cache-Control"] == "no-store"
    assert answer.headers["X-Content-Type-Options"] == "nosniff"


def test_a_host_of_this_machine_may_have_any_port_and_another_host_is_forbidden() -> None:
    for host in ("127.0.0.1:4000", "localhost:1", "[::1]:4000", "LOCALHOST", "127.0.0.1"):
        assert status(f"/?token={TOKEN}", Host=host) == 200, host
        assert socket(Host=host, Origin=f"http://{host}") is None, host
    for host in ("evil.example:4000", "127.0.0.1.evil.example", "", "127.0.0.1:4000@evil", "0.0.0.0",
                 "localhost:123456", "127.0.0.1:4000 "):
        assert status(f"/?token={TOKEN}", Host=host) == 403, host
        assert socket(Host=host) == 403, host


def test_without_the_token_it_is_forbidden() -> None:
    for target in ("/", "/?token=", "/?token=b-token", "/?other=a-token", "/?token=%ff", f"/?token={TOKEN}x"):
        assert status(target) == 403, target
        assert status(target.replace("/", "/ws", 1), Origin=f"http://{HOST}", Upgrade="websocket") == 403, target


def test_a_server_proves_that_it_knows_the_token_and_does_not_show_it() -> None:
    def proof(nonce: str, token: str = TOKEN) -> tuple[int, bytes]:
        answer = Requests(HTML, token).answer(f"/proof?nonce={nonce}", {"Host": HOST})
        assert answer is not None
        return int(answer.status), answer.body

    for nonce in ("0" * 32, "0123456789abcdef" * 2):
        assert proof(nonce) == (200, hmac.digest(TOKEN.encode(), f"proof {nonce}".encode(), "sha256").hex().encode())
        assert proof(nonce) != proof(nonce, "b-token")
    for wrong in ("", "0" * 31, "0" * 33, "G" * 32, "\u0660" * 32):
        assert proof(wrong)[0] == 404, wrong
    assert status(f"/proof?nonce={'0' * 32}", Host="evil.example") == 403


def test_there_is_no_other_file_and_a_socket_is_for_the_page_itself_alone() -> None:
    for target in ("/favicon.ico", "/page.html", "/../page.py", "/ws/", "//", "/etc/passwd"):
        assert status(f"{target}?token={TOKEN}") == 404, target
    assert socket() is None
    assert status(f"/ws?token={TOKEN}", Upgrade="websocket") == 403
    for origin in ("http://evil.example", "null", "", "https://127.0.0.1:4000", "http://127.0.0.1:4001",
                   "http://127.0.0.1"):
        assert socket(Origin=origin) == 403, origin


async def get(page: Served, text: str) -> str:
    reader, writer = await asyncio.open_connection("127.0.0.1", page.port)
    writer.write(text.encode("latin-1"))
    async with asyncio.timeout(PATIENCE):
        answer = await reader.read()
    writer.close()
    return answer.decode("latin-1")


def test_over_a_socket_too_strangers_get_a_sentence_and_the_page_goes_on(served: Serve) -> None:
    """A HEAD is answered as a GET without its body; another method was closed without an answer."""
    async def scenario(page: Served) -> None:
        async with page.open() as browser:
            whole = await get(page, f"GET /?token={TOKEN} HTTP/1.1\r\nHost: {page.host}\r\n\r\n")
            assert whole.startswith("HTTP/1.1 200")
            assert whole.endswith(HTML.decode())
            head = await get(page, f"HEAD /?token={TOKEN} HTTP/1.1\r\nHost: {page.host}\r\n\r\n")
            assert f"{head}{HTML.decode()}" == whole
            for lines, code in (
                (f"GET /?token={TOKEN} HTTP/1.1\r\nHost: evil.example", "403"),
                (f"GET /x HTTP/1.1\r\nHost: {page.host}", "404"),
                (f"GET /?token={TOKEN} HTTP/1.1\r\nHost: {page.host}\r\nHost: {page.host}", "403"),
                (f"GET /ws?token={TOKEN} HTTP/1.1\r\nHost: {page.host}\r\nOrigin: http://{page.host}", "426"),
                (f"HEAD /ws?token={TOKEN} HTTP/1.1\r\nHost: {page.host}\r\nUpgrade: websocket\r\n"
                 f"Origin: http://{page.host}", "426"),
            ):
                assert (await get(page, f"{lines}\r\n\r\n")).split()[1] == code, lines
            for method in ("POST", "PUT", "OPTIONS", "DELETE", "BREW", "M-SEARCH", "VERSION-CONTROL"):
                answer = await get(page, f"{method} /?token={TOKEN} HTTP/1.1\r\nHost: {page.host}\r\n"
                                   "Content-Length: 3\r\n\r\nabc")
                head, _, body = answer.partition("\r\n\r\n")
                assert head.startswith("HTTP/1.1 405 "), method
                assert "Allow: GET, HEAD" in head.split("\r\n"), method
                assert "take GET or HEAD" in body, method
            for garbage in ("POST / HTTP/1.1\r\n\r\n", "\x16\x03\x01\x02", "GET " + "a" * 100_000 + "\r\n\r\n"):
                await get(page, garbage + "\r\n\r\n")
            with pytest.raises(InvalidStatus):
                async with page.open(additional_headers={"Origin": "http://evil.example"}):
                    pass
            await browser.until("rows")

    served(scenario)


def test_320_connections_without_a_token_took_all_files_of_the_page(
    served: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of those that have shown none 32 are kept, for 5 s; who has the token comes in beside them."""
    assert (STRANGERS, server.STRANGE) == (32, 5.0)
    monkeypatch.setattr(server, "STRANGE", 2.0)

    async def scenario(page: Served) -> None:
        assert page.page.clients is not None
        async with page.open() as browser:
            await browser.until("rows")
            strangers = [await asyncio.open_connection("127.0.0.1", page.port) for _ in range(320)]
            for _, writer in strangers[::2]:
                writer.write(b"GET /ws HTT")
            async with page.open() as another:
                await another.until("rows")
            await page.until(lambda: sum(reader.at_eof() for reader, _ in strangers) >= 320 - STRANGERS)
            await page.until(lambda: all(reader.at_eof() for reader, _ in strangers), "they were never dropped")
            await browser.until("rows")
            for _, writer in strangers:
                writer.close()

    served(scenario)


def test_what_the_system_refuses_in_a_step_ended_the_page(
    served: Serve, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str],
) -> None:
    """With tracebacks, and without its parts put together. It is said once, and the next step goes on."""
    async def scenario(page: Served, browser: Browser) -> None:
        step, refused = page.page._step, []

        def refuses(now: float) -> None:
            if len(refused) < 20:
                refused.append(now)
                raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
            step(now)

        monkeypatch.setattr(page.page, "_step", refuses)
        await browser.told("Too many open files")
        asyncio.get_running_loop().call_exception_handler({
            "message": "socket.accept() out of system resource", "exception": OSError(errno.EMFILE, "Too many")})
        await browser.until("rows")
        assert len(refused) == 20
        assert len([text for text in said(browser) if "Too many open files" in text]) == 1

    served(scenario)
    assert "Traceback" not in capfd.readouterr().err


async def closed(browser: Browser) -> int:
    """The code with which the page is closed; what it was told before is in `got`."""
    async with asyncio.timeout(PATIENCE):
        with suppress(ConnectionClosed):
            while True:
                browser.got.append(json.loads(await browser.socket.recv()))
    assert browser.socket.close_code is not None
    return browser.socket.close_code


def said(browser: Browser) -> list[str]:
    return [message["text"] for message in browser.got if message["type"] == "said"]


@pytest.mark.full
def test_floods_and_garbage_are_told_once_and_the_page_closed_while_another_is_shown_its_rows(served: Serve) -> None:
    """Empty parts without an end, and pings among them, were no messages."""
    async def scenario(page: Served, browser: Browser) -> None:
        for frame in (b"\x00\x80\x00\x00\x00\x00", b"\x89\x80\x00\x00\x00\x00"):
            async with page.open() as parts:
                transport = parts.socket.transport
                transport.write(b"\x01\x80\x00\x00\x00\x00")  # a text begins
                await asyncio.sleep(0)
                for _ in range(10):
                    transport.write(frame * 10_000)
                assert await closed(parts) == 1008, frame
        async with page.open() as garbage:
            await garbage.until("rows")
            for i in range(25):
                await garbage.socket.send("{" if i % 2 else '{"type": "quit"}')
            assert await closed(garbage) == 1008
            assert len(said(garbage)) == 2, "each kind is told once"
        async with page.open() as long:
            await long.until("rows")
            await long.socket.send("x" * 5000)
            assert await closed(long) == 1009
        assert page.orders("master") == [{"order": "hand", "to": None}][:len(page.orders("master"))]
        async with page.open() as flood:
            async def pour() -> None:
                text = json.dumps({"type": "hand", "to": [0.01]})
                while True:
                    await flood.socket.send(text)

            pouring = asyncio.create_task(pour())
            assert await closed(flood) == 1008
            pouring.cancel()
            assert len([text for text in said(flood) if "200 messages a second" in text]) == 1
        assert len(page.orders("master")) < 10
        await browser.until("rows", lambda rows: rows["xm"] == [0.01])

    served(scenario)


def test_eight_pages_may_be_open_and_the_ninth_is_told_so(served: Serve) -> None:
    async def scenario(page: Served) -> None:
        async with asyncio.TaskGroup() as group:
            ready, over = asyncio.Semaphore(0), asyncio.Event()

            async def look() -> None:
                async with page.open() as browser:
                    await browser.until("rows")
                    ready.release()
                    while not over.is_set():
                        await browser.until("rows")

            for _ in range(8):
                group.create_task(look())
            for _ in range(8):
                await ready.acquire()
            async with page.open() as ninth:
                assert await closed(ninth) == 1013
            over.set()

    served(scenario)


def test_a_page_that_reads_nothing_loses_pictures_and_neither_time_nor_memory(served: Serve) -> None:
    async def scenario(page: Served) -> None:
        assert page.page.clients is not None
        async with page.open() as browser, page.open(max_queue=1) as slow:
            await browser.until("rows")
            await slow.until("hello")
            slow.socket.transport.pause_reading()
            clients = page.page.clients
            text = "x" * 60_000
            for _ in range(300):  # 18 MB, more than the system holds for a socket
                clients.show(text)
                await asyncio.sleep(0)
                async with asyncio.timeout(PATIENCE):
                    while (await browser.socket.recv()) != text:
                        pass
            assert clients.waiting <= 200_000
            slow.socket.transport.resume_reading()

    served(scenario)


def test_a_port_in_use_is_refused_before_a_process_is_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(subprocess, "Popen", None)
    with stream_socket() as sock:
        sock.bind(("127.0.0.1", 0))
        sock.listen()
        port = sock.getsockname()[1]
        assert main(["demo", "--page", "--port", str(port)]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert f"127.0.0.1:{port}" in err
    assert "--port" in err
    assert not list(tmp_path.iterdir())
