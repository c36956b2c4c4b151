"""What goes out over UDP: datagrams as PlotJuggler reads them, each row once."""

from __future__ import annotations

import json
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from teleop import Refused, load_result
from teleop.__main__ import main
from teleop.export import stream as module
from teleop.export.stream import LARGEST, GrowingRun, RowEncoder, stream
from teleop.storage.folder import claim
from tests.teleop.export.conftest import LiveEnd
from tests.waiting import PATIENCE, until

pytestmark = pytest.mark.live


class Receiver:
    """What PlotJuggler's UDP Server would get: the objects of all datagrams, in order."""

    def __init__(self) -> None:
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        self.sock.bind(("127.0.0.1", 0))
        self.sock.settimeout(PATIENCE)
        self.at = self.sock.getsockname()
        self.datagrams: list[bytes] = []
        self._thread = threading.Thread(target=self._receive)
        self._thread.start()

    def _receive(self) -> None:
        while (data := self.sock.recv(1 << 16)) != b"end":
            self.datagrams.append(data)

    def close(self) -> list[Any]:
        """Stop, after all that is on its way has come; what came."""
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.sendto(b"end", self.at)
        self._thread.join()
        self.sock.close()
        return [json.loads(data) for data in self.datagrams]


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    made = Receiver()
    yield made
    if made.sock.fileno() >= 0:
        made.close()


def send(run: GrowingRun, to: tuple[str, int], rows: int = 16, **other: Any) -> module.Sent:
    return stream(run, to, rows=rows, **{"stopped": lambda: False, "warn": pytest.fail, **other})


def test_a_run_that_is_over_comes_as_a_whole_to_the_bit(demo: Path, receiver: Receiver) -> None:
    sent = send(GrowingRun(demo), receiver.at)
    got = receiver.close()
    assert (sent.rows, sent.datagrams, sent.unheard) == (790, len(got), 0)
    assert [len(rows) for rows in got[:4]] == [16] * 4
    assert all(next(iter(row)) == "timestamp" for rows in got for row in rows)
    for e, name in (("m", "master"), ("s", "slave")):
        rows = [row for rows in got for row in rows if name in row]
        trace = load_result(demo / name).trace
        assert [row["timestamp"] for row in rows] == trace["t"].tolist()
        assert [row[name][f"late_{e}"] for row in rows] == trace[f"late_{e}"].tolist()
        assert [row["link"][f"seq_{e}"] for row in rows] == trace[f"seq_{e}"].tolist()
        for column in ("x", "v", "f"):
            assert [row[name][f"{column}_{e}"] for row in rows] == [{"x": value} for value in trace[f"{column}_{e}"]]
        assert [row["energy"][f"E_port_{e}"] for row in rows] == trace[f"E_port_{e}"].tolist()
        assert [row["link"][f"queue_{e}"]["x"] for row in rows] == trace[f"queue_{e}"].tolist()


def test_one_row_a_datagram_is_an_object_as_older_plotjugglers_take_it(demo: Path, receiver: Receiver) -> None:
    sent = send(GrowingRun(demo / "master"), receiver.at, rows=1)
    got = receiver.close()
    assert (sent.rows, sent.datagrams) == (400, 400)
    assert [round(1e3 * row["timestamp"]) for row in got] == [*range(400)]


def test_what_is_not_finite_is_left_out_or_it_would_end_plotjuggler(tmp_path: Path, receiver: Receiver) -> None:
    end = LiveEnd(tmp_path / "end", "m", range(3))
    end.writer.add(3, 0, -1, (float("nan"), float("inf"), *[0.5] * 5))
    end.close()
    send(GrowingRun(tmp_path / "end"), receiver.at)
    (rows,) = receiver.close()
    assert b"NaN" not in receiver.datagrams[0]
    assert rows[3]["master"] == {"late_m": 0.0, "f_m": {"x": 0.5}}


def test_a_record_that_grows_comes_without_gap_or_double(tmp_path: Path, receiver: Receiver) -> None:
    claimed = claim(tmp_path / "run")
    end = LiveEnd(tmp_path / "run" / "master", "m", range(10))
    run, told = GrowingRun(tmp_path / "run"), list[module.Sent]()
    thread = threading.Thread(target=lambda: told.append(send(run, receiver.at)))
    thread.start()
    try:
        for start in range(10, 200, 38):
            until(lambda: len(receiver.datagrams) > 0)
            seen = len(receiver.datagrams)
            end.add(range(start, start + 38))
            until(lambda seen=seen: len(receiver.datagrams) > seen)
    finally:
        end.close()
        claimed.close()
        thread.join()
    got = receiver.close()
    assert [round(1e3 * row["timestamp"]) for rows in got for row in rows] == [*range(200)]
    assert max(len(rows) for rows in got) == 16
    assert told[0].rows == 200


def test_it_stops_when_it_is_told_to(demo: Path, receiver: Receiver) -> None:
    answers = iter([False, False, True])
    sent = send(GrowingRun(demo), receiver.at, stopped=lambda: next(answers))
    assert sent.rows == 64
    assert len(receiver.close()) == 4


@pytest.fixture
def nobody() -> tuple[str, int]:
    """An address on which nobody listens."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        return str(sock.getsockname()[0]), int(sock.getsockname()[1])


def test_a_run_that_is_over_is_not_sent_to_nobody(demo: Path, nobody: tuple[str, int]) -> None:
    with pytest.raises(Refused, match=r"nobody listens on 127\.0\.0\.1:.*start PlotJuggler's UDP Server there"):
        send(GrowingRun(demo), nobody)


def test_of_a_live_run_is_said_once_that_nobody_listens_and_who_listens_later_gets_the_rest(tmp_path: Path) -> None:
    claimed = claim(tmp_path / "run")
    end = LiveEnd(tmp_path / "run" / "master", "m", range(48))
    run, said, told = GrowingRun(tmp_path / "run"), list[str](), list[module.Sent]()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        at = sock.getsockname()
        sock.close()
        thread = threading.Thread(target=lambda: told.append(send(run, at, warn=said.append)))
        thread.start()
        try:
            until(lambda: said)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as later:
                later.settimeout(PATIENCE)
                later.bind(at)
                end.add(range(48, 100))
                end.close()
                claimed.close()
                got = list[int]()
                while not got or got[-1] < 99:
                    got += [round(1e3 * row["timestamp"]) for row in json.loads(later.recv(1 << 16))]
        finally:
            claimed.close()
            thread.join()
    assert got == [*range(48, 100)]
    assert len(said) == 1
    assert told[0].unheard >= 1


def test_rows_that_are_too_long_for_a_datagram_go_in_several(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    LiveEnd(tmp_path / "end", "m", range(16)).close()
    (some,) = GrowingRun(tmp_path / "end").take(16)
    whole, = RowEncoder(some.end).datagrams(some)
    assert len(whole) < LARGEST
    monkeypatch.setattr(module, "LARGEST", len(whole) // 3)
    parts = RowEncoder(some.end).datagrams(some)
    assert len(parts) == 4
    assert [row for part in parts for row in json.loads(part)] == json.loads(whole)


def test_several_axes_are_fields_of_an_object(tmp_path: Path, receiver: Receiver) -> None:
    folder = tmp_path / "end"
    LiveEnd(folder, "s", range(5), scene="recorded_reach").close()
    send(GrowingRun(folder), receiver.at)
    (rows,) = receiver.close()
    table = np.array([[row["slave"]["v_s"][axis] for axis in ("x", "y", "z")] for row in rows])
    raw = (folder / "record.bin").read_bytes()
    header, _, data = raw.partition(b"\n")
    at = json.loads(header)["columns"].index("v_s")
    assert np.array_equal(table, np.frombuffer(data).reshape(5, -1)[:, at : at + 3])


def test_the_command_ends_in_order_on_ctrl_c_and_when_the_run_is_over(
    tmp_path: Path, receiver: Receiver, process: Callable[..., subprocess.Popen[str]],
    capsys: pytest.CaptureFixture[str]
) -> None:
    import signal

    claimed = claim(tmp_path / "run")
    end = LiveEnd(tmp_path / "run" / "master", "m", range(40))
    started = process("-m", "teleop", "stream", str(tmp_path / "run"), "--plotjuggler", f"127.0.0.1:{receiver.at[1]}")
    try:
        until(lambda: len(receiver.datagrams) == 3)
        started.send_signal(signal.SIGINT)
        out, err = started.communicate(timeout=PATIENCE)
    finally:
        started.kill()
        end.close()
        claimed.close()
    assert started.returncode == 0, err
    assert "ended by SIGINT; 40 rows in 3 datagrams" in out
    assert "neither" not in err
    assert "in plain UDP; Ctrl-C ends it" in err
    assert main(["stream", str(tmp_path / "run"), "--plotjuggler", f"127.0.0.1:{receiver.at[1]}", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["rows"], told["unheard"], told["over"]) == (40, 0, True)
