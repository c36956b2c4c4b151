"""The wire as it is written down: the test vectors of `teleop/protocol/vectors.json`, in both directions."""

from __future__ import annotations

import json
from typing import Any

import pytest

from teleop.protocol.packet import Kind, Rejection, decode, encode
from tests.teleop.protocol.vectors import FILE, packet_of, text

VECTORS: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))


def named(part: str) -> list[Any]:
    return [pytest.param(one, id=one["name"]) for one in VECTORS[part]]


def test_the_file_is_what_the_helper_writes() -> None:
    assert FILE.read_text(encoding="utf-8") == text()


@pytest.mark.parametrize("vector", named("accepted"))
def test_the_fields_encode_to_these_bytes_and_the_bytes_decode_to_these_fields(vector: dict[str, Any]) -> None:
    packet = packet_of(vector["packet"])
    assert encode(packet, vector["size"]).hex() == vector["hex"]
    assert repr(decode(bytes.fromhex(vector["hex"]), vector["width"])) == repr(packet)  # -0.0 is not 0.0


@pytest.mark.parametrize("vector", named("accepted_in_other_forms"))
def test_other_forms_of_the_same_numbers_are_taken_too(vector: dict[str, Any]) -> None:
    packet = packet_of(vector["packet"])
    assert decode(bytes.fromhex(vector["hex"]), vector["width"]) == packet
    assert encode(packet).hex() != vector["hex"]


@pytest.mark.parametrize("vector", named("rejected"))
def test_what_is_no_packet_is_rejected_for_this_reason(vector: dict[str, Any]) -> None:
    assert decode(bytes.fromhex(vector["hex"]), vector["width"]) is Rejection(vector["rejection"])


def test_every_kind_and_every_rejection_has_a_vector() -> None:
    assert {one["packet"]["kind"] for one in VECTORS["accepted"]} == {kind.name for kind in Kind}
    assert {one["rejection"] for one in VECTORS["rejected"]} == {why.value for why in Rejection}
