"""Headless Chromium for tests of the page: Debian's, driven by Playwright, each page in a fresh profile."""

from __future__ import annotations

import functools
import importlib.resources
import importlib.util
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright

AXE = "axe_playwright_python"
NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking"]
Browse = Callable[..., Page]


@pytest.fixture(scope="session")
def chromium() -> Iterator[Browser]:
    found = next((path for name in NAMES if (path := shutil.which(name))), None)
    if found is None:
        reason = f"there is no Chromium ({', '.join(NAMES)}): apt-get install chromium"
        if os.environ.get("CI") == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    expect.set_options(timeout=60_000)  # ms, on a busy machine
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=FLAGS)
        yield browser
        browser.close()


@pytest.fixture
def browse(chromium: Browser) -> Iterator[Browse]:
    """browse(file or URL, fragment, own, **context) -> the page, opened from the disk or a server.

    Console messages, exceptions and requests outside of `own`, by default the page's folder, fail the test.
    """
    contexts, wrong = [], []

    def open_page(file: Path | str, fragment: str = "", own: Path | None = None, **options: Any) -> Page:
        context = chromium.new_context(**options)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(20_000)
        url = file if isinstance(file, str) else file.as_uri()
        folder = url.rpartition("/")[0] if own is None else own.as_uri()
        page.on("console", lambda message: wrong.append(f"console: {message.text}"))
        page.on("pageerror", lambda error: wrong.append(f"error: {error}"))
        page.on("requestfailed", lambda request: wrong.append(f"not loaded: {request.url}"))
        page.on(
            "request",
            lambda request: (
                None
                if request.url.startswith((folder, "data:", "blob:"))
                else wrong.append(f"asked for {request.url}")
            ),
        )
        page.goto(url + fragment)
        return page

    yield open_page
    found = [*wrong]  # before closing, which aborts what is still loading
    for context in contexts:
        context.close()
    assert not found, "; ".join(found)


def violations(page: Page, *rules: str) -> list[str]:
    """What axe-core finds on the page as it is, by these rules or by all: rule and elements."""
    if not page.evaluate("'axe' in window"):
        page.evaluate(axe_script())
    only = {"runOnly": list(rules)} if rules else {}
    found = page.evaluate("only => axe.run(document, { preload: false, ...only })", only)
    return [
        f"{each['id']}: {[node['html'][:200] for node in each['nodes'][:3]]}" for each in found["violations"]
    ]


@functools.cache
def axe_script() -> str:
    """axe-core, out of a package of which nothing else is used."""
    if importlib.util.find_spec(AXE) is None:
        reason = f"{AXE} is not installed: make venv"
        if os.environ.get("CI") == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    return (importlib.resources.files(AXE) / "axe.min.js").read_text(encoding="utf-8")
