"""A browser, a server that speaks as the page's own does, and a tab that shows it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

pytest.importorskip("websockets", reason="the extra `page` is not installed")

from tests.browser import Browser, Page
from tests.live.page.browser.mock import Mock


@pytest.fixture(scope="package")
def browser() -> Iterator[Browser]:
    """One Chromium for all tests here, gone before any other test: what it draws takes most of a core."""
    one = Browser()
    yield one
    one.close()


@pytest.fixture
def server() -> Iterator[Callable[..., Mock]]:
    """`server(axes=1, port=0, ran=3.1)`: a mock, stopped when the test is over."""
    started: list[Mock] = []

    def start(**given: Any) -> Mock:
        started.append(Mock(**given))
        return started[-1]

    yield start
    for one in started:
        one.stop()


@pytest.fixture
def mock(server: Callable[..., Mock]) -> Mock:
    return server()


@pytest.fixture
def tab(browser: Browser) -> Iterator[Callable[..., Page]]:
    """`tab(url, width=1280, height=900, ...)`: a new tab that shows rows, closed when the test is over."""
    started: list[Page] = []

    def start(url: str, *, media: dict[str, str] | None = None, width: int = 1280, height: int = 1400,
              **size: Any) -> Page:
        page = browser.page(width=width, height=height, **size)
        started.append(page)
        page.media(**(media or {}))
        page.go(url)
        page.until("row !== null && hello !== null")
        return page

    yield start
    for page in started:
        page.close()


@pytest.fixture(scope="package")
def desktop(browser: Browser) -> Iterator[Page]:
    """A tab that shows one page after the other."""
    one = browser.page(width=1280, height=1400)
    yield one
    one.close()


@pytest.fixture
def page(mock: Mock, desktop: Page) -> Iterator[Page]:
    """A tab of a desktop that shows the mock, and nothing when the test is over."""
    desktop.console.clear()  # what the page before had to say
    desktop.go(mock.url)
    desktop.until("row !== null && hello !== null")
    yield desktop
    desktop.call("Page.navigate", url="about:blank")
