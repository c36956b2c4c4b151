"""Texts never become markup."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teleop.report.markup import LONGEST, Markup, element, empty, path_data, text
from teleop.terminal.table import printable
from tests.teleop.report.read_page import Page


@given(said=st.text(max_size=80))
@settings(max_examples=50)
def test_whatever_is_put_in_is_read_again_as_text_and_as_attribute(said: str) -> None:
    page = Page(element("p", {"title": said}, said).encode())
    assert page.elements == [("p", {"title": printable(said)})]
    assert "".join(page.texts) == printable(said)


def test_markup_is_put_in_as_it_is_and_a_text_is_not_longer_than_is_read() -> None:
    assert element("p", None, element("b", None, "<i>")) == "<p><b>&lt;i&gt;</b></p>"
    assert empty("path", {"d": "M0 0", "class": None}) == '<path d="M0 0"/>'
    assert len(text("x" * 10 * LONGEST)) == LONGEST


def test_only_the_commands_of_a_path_are_taken_for_one() -> None:
    assert isinstance(path_data("M0 0l3-4"), Markup)
    with pytest.raises(ValueError, match="letters and numbers"):
        path_data('M0 0"/><script>')
