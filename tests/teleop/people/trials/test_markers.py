"""Markers by Lab Streaming Layer, with a stand-in of pylsl."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import pytest

from teleop.errors import Refused
from teleop.people.trials.markers import lsl_markers


def test_markers_go_out_as_a_stream_of_texts_and_without_pylsl_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[Any] = []

    class Outlet:
        def __init__(self, about: tuple[Any, ...]) -> None:
            sent.append(about)

        def push_sample(self, texts: list[str]) -> None:
            sent.append(texts)

    monkeypatch.setitem(sys.modules, "pylsl", SimpleNamespace(StreamInfo=lambda *about: about, StreamOutlet=Outlet))
    mark = lsl_markers("try", 3)
    mark("trial 1 interval 1")
    assert sent == [("teleop-try", "Markers", 1, 0.0, "string", "try-sub-03"), ["trial 1 interval 1"]]
    monkeypatch.setitem(sys.modules, "pylsl", None)
    with pytest.raises(Refused, match=r"bilateral-teleop\[lsl\]"):
        lsl_markers("try", 3)
