"""`teleop manifest`: what an end in another language has to say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgpack
import pytest

from teleop.__main__ import main
from teleop.protocol.manifest import live_manifest
from teleop.protocol.packet import Kind, Packet, decode
from teleop.scene.loading import live_knobs, load_scene


def said(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    assert main(["manifest", *words, "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


def places(found: list[dict[str, Any]]) -> list[tuple[str, str, str]]:
    assert [one["place"] for one in found] == list(range(len(found)))
    return [(one["axis"], one["name"], one["kind"]) for one in found]


def test_its_manifest_is_the_one_that_the_ends_compare_also_as_bytes(capsys: pytest.CaptureFixture[str],
        tmp_path: Path) -> None:
    file = tmp_path / "manifest"
    found = said(capsys, "hard_wall", "--set", "k_e=2000", "--write", str(file))
    own = live_manifest(load_scene("hard_wall", **live_knobs("hard_wall", {"k_e": "2000"})))
    assert found["manifest"] == own == msgpack.unpackb(file.read_bytes())
    assert found["manifest_hex"] == file.read_bytes().hex()
    assert own["k_e"] == "2000.0"


def test_its_examples_are_packets_of_the_scene(capsys: pytest.CaptureFixture[str]) -> None:
    found = said(capsys, "hard_wall")
    for name in ("forth", "back"):
        data = bytes.fromhex(found["examples"][name])
        packet = decode(data, len(found[name]))
        assert isinstance(packet, Packet)
        assert (packet.kind, packet.payload, len(data)) == (Kind[name.upper()], (0.0, 0.125, 0.25, 0.375), 100)
    hello = decode(bytes.fromhex(found["examples"]["hello"]), 0)
    assert isinstance(hello, Packet)
    assert (hello.kind, hello.payload) == (Kind.HELLO, found["manifest"])


def test_waves_have_their_integrals_behind_all_axes_and_the_time_at_the_end(capsys: pytest.CaptureFixture[str]) -> None:
    found = said(capsys, "recorded_reach", "--set", "law=wave")
    waves = [(axis, "u", "wave") for axis in "xyz"]
    along = [(axis, name, "integral") for axis in "xyz" for name in "UE"]
    assert places(found["forth"]) == [*waves, *along, ("", "T", "integral")]
    assert found["E_in"] is False


def test_a_total_of_an_end_that_couples_its_axes_has_one_place(capsys: pytest.CaptureFixture[str]) -> None:
    found = said(capsys, "recorded_reach", "--set", "law=tdpa")
    moves = [(axis, name, kind) for axis in "xyz" for name, kind in (("x", "position"), ("v", "sample"))]
    assert places(found["forth"]) == [*moves[:2], ("", "E", "total"), *moves[2:]]
    assert found["forth"][1]["says"] == "the master's velocity, m/s"
    assert found["E_in"] is True


def test_of_an_axis_of_rad_the_units_are_those_of_angles(capsys: pytest.CaptureFixture[str]) -> None:
    told = {(one["axis"], one["name"]): one["says"].rpartition(", ")[2] for one in said(capsys, "pose")["forth"]}
    assert (told["z", "x"], told["z", "v"], told["rx", "x"], told["rx", "v"]) == ("m", "m/s", "rad", "rad/s")


def test_a_person_reads_sizes_places_and_the_bytes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["manifest", "hard_wall", "--set", "law=pp"]) == 0
    out = capsys.readouterr().out
    for words in ("100 bytes, exactly", "1000000 ns", "1  x  v  sample    the master's velocity, m/s",
                  "law           pp PositionPosition(K=400.0, B=4.0, rejoin=2.0)", "  4254040000"):
        assert words in out
